"""Indirect light and caustics at diffuse points: density estimates, final gathering, and unbiased paths."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.gathering import (
    add_weighted,
    estimate_irradiance,
    mark_short,
    nearest_irradiance,
    reflect_irradiance,
    reflect_mean,
)
from joulebox_render.kernels.transport import continue_paths, gather_rays
from joulebox_render.records import F4, F8, Points, Rays, Scratch, Tree, rows
from joulebox_render.stages.context import Context
from joulebox_render.stages.direct import sample_lights
from joulebox_render.stages.paths import follow_to_diffuse, join
from joulebox_render.stages.photon_map import PhotonMap, grow_tree

FILTERS = {"constant": 0, "cone": 1, "epanechnikov": 2}
# A density estimate visits about as much memory as this many rays.
RAYS_PER_ESTIMATE = 16
# No path is followed through more diffuse bounces; Russian roulette ends nearly all long before.
MAX_PATH_BOUNCES = 1000
# A gather ray's stretches shorter than the photon map's resolution that are gathered again before it is asked.
MOST_SHORT = 3


class IrradianceRecords(NamedTuple):
    """Irradiance computed ahead at some photons' positions: tree, irradiance (R, 3) f4 in its order [W m^-2].

    reach_m is how far a look-up may go: records of every nth photon lie sqrt(n) times as far apart as photons.
    """

    tree: Tree
    irradiance: F4
    reach_m: float


@dataclass(frozen=True)
class DensityEstimate:
    """How photons around a point become irradiance."""

    photons: PhotonMap
    count: int
    reach_m: float
    cos_limit: float
    filter_kind: int

    def __call__(self, position: F4, normal: F4) -> F4:
        """Irradiance (N, 3) f4 at points [W m^-2]."""
        irradiance = np.empty((len(position), 3), np.float32)
        estimate_irradiance(
            self.photons.tree, self.photons.flux, position, normal, self.count, self.reach_m,
            self.cos_limit, self.filter_kind, Scratch.empty(self.count), irradiance,
        )  # fmt: skip
        return irradiance


def global_estimate(context: Context, photons: PhotonMap) -> DensityEstimate:
    """The estimate that the settings ask for in the global map."""
    settings = context.settings
    return DensityEstimate(
        photons, settings.gather_count, settings.gather_distance_m,
        math.cos(math.radians(settings.normal_angle_deg)), FILTERS[settings.gather_filter],
    )  # fmt: skip


def caustic_estimate(context: Context, photons: PhotonMap) -> DensityEstimate:
    """The estimate that the settings ask for in the caustic map, with its own count and distance."""
    settings = context.settings
    return DensityEstimate(
        photons, settings.caustic_gather_count, settings.caustic_gather_distance_m,
        math.cos(math.radians(settings.normal_angle_deg)), FILTERS[settings.gather_filter],
    )  # fmt: skip


@dataclass(frozen=True)
class Illumination:
    """What a gather ray asks where it ends.

    resolution_m is the distance below which the photon map cannot tell places apart [m].
    """

    estimate: DensityEstimate
    records: IrradianceRecords | None
    caustics: DensityEstimate | None

    @property
    def resolution_m(self) -> float:
        return self.estimate.reach_m

    def look_up(self, points: Points) -> F4:
        """Irradiance (N, 3) f4: the nearest record, or a density estimate where none are kept."""
        if self.records is None:
            return self.estimate(points.position, points.normal)
        irradiance = np.empty((len(points.owner), 3), np.float32)
        nearest_irradiance(
            self.records.tree, self.records.irradiance, points.position, points.normal,
            self.records.reach_m, self.estimate.cos_limit, Scratch.empty(1), irradiance,
        )  # fmt: skip
        return irradiance


def precompute_irradiance(context: Context, photons: PhotonMap) -> IrradianceRecords:
    """Irradiance at every nth photon of the global map, n = photon_spacing (Christensen 1999)."""
    step = context.settings.photon_spacing
    position = np.ascontiguousarray(photons.tree.position[::step])
    normal = np.ascontiguousarray(photons.tree.normal[::step])
    estimate = global_estimate(context, photons)

    def chunk(first: int, last: int) -> F4:
        return estimate(position[first:last], normal[first:last])

    parts = list(context.pool.map_chunks(chunk, len(position), RAYS_PER_ESTIMATE))
    irradiance = np.concatenate(parts) if parts else np.zeros((0, 3), np.float32)
    tree, order = grow_tree(position, normal)
    return IrradianceRecords(tree, np.ascontiguousarray(irradiance[order]), estimate.reach_m * math.sqrt(step))


def show_photons(context: Context, estimate: DensityEstimate, points: Points) -> F8:
    """Radiance (points, 3) f8 that points reflect of the photons around them (direct visualisation)."""

    def chunk(first: int, last: int) -> F8:
        irradiance = estimate(points.position[first:last], points.normal[first:last])
        return points.albedo[first:last].astype(np.float64) / math.pi * irradiance

    parts = list(context.pool.map_chunks(chunk, len(points.owner), RAYS_PER_ESTIMATE))
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def final_gather(context: Context, light: Illumination, points: Points) -> tuple[F8, int]:
    """Radiance (points, 3) f8 that points reflect of light that comes from other surfaces, and the rays traced."""
    count = context.settings.final_gather_rays

    def chunk(first: int, last: int) -> tuple[F8, int]:
        rays = Rays.empty((last - first) * count)
        gather_rays(points, first, last, count, context.columns(count), rays)
        incident, _, traced = incident_radiance(context, light, rays)
        radiance = np.empty((last - first, 3))
        reflect_mean(points, first, last, count, incident, radiance)
        return radiance, traced

    return collect(context.pool.map_chunks(chunk, len(points.owner), count))


def incident_radiance(context: Context, light: Illumination, rays: Rays) -> tuple[F8, F4, int]:
    """Radiance that comes in along gather rays, (N, 3) f8, the distance it comes from (N,) f4 [m], and rays traced.

    Light that surfaces emit towards the rays' origins is left out: it is sampled directly, or, where it comes through
    mirrors and glass, shown by the caustic map; without a caustic map gather rays find it. Where a ray ends
    nearer than the photon map can tell apart (corners, contacts) the map is not asked about that place but about
    what lights it: a second gather of one ray, with direct light sampled (LuxCore's and Jensen's remedy, 2001,
    section 8.4); after MOST_SHORT such stretches it is asked all the same.
    """
    radiance = np.zeros((len(rays.owner), 3))
    emission = not context.plan.caustic_map
    reached, distance, traced = follow_to_diffuse(
        context, rays, radiance, split=False, first_emission=False, specular_emission=emission
    )
    for _ in range(MOST_SHORT):
        if not reached:
            break
        is_near = np.empty(len(reached[0].owner), np.bool_)
        mark_short(reached[0], light.resolution_m, is_near)
        near = Points(*rows(reached[0], is_near))
        if not len(near.owner):
            break
        for far in (Points(*rows(reached[0], ~is_near)), *reached[1:]):
            reflect_irradiance(far, light.look_up(far), radiance)
        lit, shadow = sample_lights(context, near, 0, len(near.owner), 1)
        add_weighted(near, lit, radiance)
        if light.caustics is not None:
            reflect_irradiance(near, light.caustics(near.position, near.normal), radiance)
        onward = Rays.empty(len(near.owner))
        count = continue_paths(near, context.sobol, 0, onward)
        reached, _, through = follow_to_diffuse(
            context, Rays(*rows(onward, slice(0, count))), radiance,
            split=False, first_emission=False, specular_emission=emission,
        )  # fmt: skip
        traced += shadow + through
    for far in reached:
        reflect_irradiance(far, light.look_up(far), radiance)
    return radiance, distance, traced


def trace_paths(context: Context, points: Points) -> tuple[F8, int]:
    """Radiance (points, 3) f8 of all light that bounced, one unbiased path a point, and the rays traced.

    Next-event estimation at every diffuse point; emission counts where a path found it through specular and
    glossy surfaces, which next-event estimation cannot. Russian roulette after two bounces.
    """

    def chunk(first: int, last: int) -> tuple[F8, int]:
        count = last - first
        radiance = np.zeros((count, 3))
        here = Points(*rows(points, slice(first, last)))._replace(
            weight=np.ones((count, 3), np.float32), owner=np.arange(count, dtype=np.int64)
        )
        traced = 0
        for bounce in range(MAX_PATH_BOUNCES):
            rays = Rays.empty(len(here.owner))
            going_on = continue_paths(here, context.sobol, bounce, rays)
            if going_on == 0:
                break
            reached, _, through = follow_to_diffuse(
                context, Rays(*rows(rays, slice(0, going_on))), radiance, split=False,
                first_emission=False, specular_emission=True,
            )  # fmt: skip
            here = join(reached)
            light, shadow = sample_lights(context, here, 0, len(here.owner), 1)
            add_weighted(here, light, radiance)
            traced += through + shadow
        return radiance, traced

    return collect(context.pool.map_chunks(chunk, len(points.owner), 8))


def collect(chunks: Iterable[tuple[F8, int]]) -> tuple[F8, int]:
    """Radiance of all chunks in order, and the sum of their rays."""
    parts = list(chunks)
    return np.concatenate([np.zeros((0, 3)), *(part for part, _ in parts)]), sum(traced for _, traced in parts)
