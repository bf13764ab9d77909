"""Indirect light and caustics at diffuse points: density estimates, final gathering, and unbiased paths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.gathering import (
    add_weighted,
    estimate_irradiance,
    nearest_irradiance,
    reflect_irradiance,
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


def final_gather(
    context: Context, estimate: DensityEstimate, records: IrradianceRecords | None, points: Points
) -> tuple[F8, int]:
    """Radiance (points, 3) f8 that points reflect of light that comes from other surfaces, and the rays traced.

    Light that surfaces emit towards a point is left out: it is sampled directly, or, where it comes through
    mirrors and glass, shown by the caustic map; without a caustic map gather rays find it.
    """
    count = context.settings.final_gather_rays
    columns = context.columns(count)

    def chunk(first: int, last: int) -> tuple[F8, int]:
        radiance = np.zeros((last - first, 3))
        rays = Rays.empty((last - first) * count)
        gather_rays(points, first, last, count, columns, rays)
        reached, traced = follow_to_diffuse(
            context, rays, radiance, split=False, first_emission=False,
            specular_emission=not context.plan.caustic_map,
        )  # fmt: skip
        for far in reached:
            reflect_irradiance(far, _look_up(estimate, records, far), radiance)
        return radiance, traced

    chunks = list(context.pool.map_chunks(chunk, len(points.owner), count))
    radiance = np.concatenate([part for part, _ in chunks]) if chunks else np.zeros((0, 3))
    return radiance, sum(traced for _, traced in chunks)


def trace_paths(context: Context, points: Points) -> tuple[F8, int]:
    """Radiance (points, 3) f8 of all light that bounced, one unbiased path a point, and the rays traced.

    Next-event estimation at every diffuse point; emission counts where a path found it through specular
    surfaces, which next-event estimation cannot. Russian roulette after two bounces.
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
            going_on = continue_paths(here, bounce, rays)
            if going_on == 0:
                break
            reached, through = follow_to_diffuse(
                context, Rays(*rows(rays, slice(0, going_on))), radiance, split=False,
                first_emission=False, specular_emission=True,
            )  # fmt: skip
            here = join(reached)
            light, shadow = sample_lights(context, here, 0, len(here.owner), 1)
            add_weighted(here, light, radiance)
            traced += through + shadow
        return radiance, traced

    chunks = list(context.pool.map_chunks(chunk, len(points.owner), 8))
    radiance = np.concatenate([part for part, _ in chunks]) if chunks else np.zeros((0, 3))
    return radiance, sum(traced for _, traced in chunks)


def _look_up(estimate: DensityEstimate, records: IrradianceRecords | None, points: Points) -> F4:
    """Irradiance where gather rays ended: the nearest record, or a density estimate where none are kept."""
    if records is None:
        return estimate(points.position, points.normal)
    irradiance = np.empty((len(points.owner), 3), np.float32)
    nearest_irradiance(
        records.tree, records.irradiance, points.position, points.normal,
        records.reach_m, estimate.cos_limit, Scratch.empty(1), irradiance,
    )  # fmt: skip
    return irradiance
