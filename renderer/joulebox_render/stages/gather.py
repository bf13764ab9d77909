"""Indirect light at diffuse points: final gathering, and unbiased paths."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from joulebox_render.kernels.gathering import add_weighted, reflect_irradiance, reflect_mean, take_unsure
from joulebox_render.kernels.importance import CELL_COLUMNS, CELL_ROWS, incoming_chances
from joulebox_render.kernels.transport import continue_paths, gather_rays
from joulebox_render.records import F4, F8, Points, Rays, Scratch, rows
from joulebox_render.stages.context import Context
from joulebox_render.stages.direct import sample_lights
from joulebox_render.stages.paths import follow_to_diffuse, join
from joulebox_render.stages.photon_map import BOUNCED, CAUSTIC
from joulebox_render.stages.precomputed import Illumination

# Where light comes from changes more slowly over a surface than how much: photons from so many times as far tell.
IMPORTANCE_REACH = 4.0
NOT_BENT: F4 = np.empty((0, CELL_ROWS * CELL_COLUMNS), np.float32)

# No path is followed through more diffuse bounces; Russian roulette ends nearly all long before.
MAX_PATH_BOUNCES = 1000
# A gather ray's stretches shorter than the photon map's resolution that are gathered again before it is asked.
MOST_SHORT = 8


def final_gather(context: Context, light: Illumination, points: Points, count: int) -> tuple[F8, int]:
    """Radiance (points, 3) f8 that points reflect of light from other surfaces, by `count` rays each; rays traced."""

    def chunk(first: int, last: int) -> tuple[F8, int]:
        rays = Rays.empty((last - first) * count)
        chance = incoming(context, light, points, first, last)
        gather_rays(points, first, last, count, context.columns(count), chance, rays)
        incident, _, traced = incident_radiance(context, light, rays)
        radiance = np.empty((last - first, 3))
        reflect_mean(points, first, last, count, incident, radiance)
        return radiance, traced

    return collect(context.pool.map_chunks(chunk, len(points.owner), count))


def incoming(context: Context, light: Illumination, points: Points, first: int, last: int) -> F4:
    """Chances (last - first, cells) f4 of the directions of gather rays; no rows where they are not bent."""
    if not context.plan.importance_sampling:
        return NOT_BENT
    estimate, photons = light.estimate, light.estimate.photons
    chance = np.empty((last - first, CELL_ROWS * CELL_COLUMNS), np.float32)
    incoming_chances(
        photons.tree, photons.wi, photons.flux, photons.history, BOUNCED if light.caustics else CAUSTIC, points, first,
        estimate.count, IMPORTANCE_REACH * estimate.reach_m, estimate.cos_limit, Scratch.empty(estimate.count), chance,
    )  # fmt: skip
    return chance


def incident_radiance(context: Context, light: Illumination, rays: Rays) -> tuple[F8, F4, int]:
    """Radiance that comes in along gather rays, (N, 3) f8, the distance it comes from (N,) f4 [m], and rays traced.

    Light that surfaces emit towards the rays' origins is left out: it is sampled directly, or, where it comes through
    mirrors and glass, shown by the caustic map; without a caustic map gather rays find it. Where a ray ends
    nearer than the photon map can tell apart (corners, contacts), or where what the map knows may belong behind a
    wall, the map is not asked about that place but about what lights it: a second gather of one ray, with direct light
    sampled (LuxCore's remedy); after MOST_SHORT such stretches it is asked all the same.
    """
    radiance = np.zeros((len(rays.owner), 3))
    emission = not context.plan.caustic_map
    reached, distance, traced = follow_to_diffuse(
        context, rays, radiance, split=False, first_emission=False, specular_emission=emission
    )
    for stretch in range(MOST_SHORT + 1):
        again: list[Points] = []
        for depth, far in enumerate(reached):
            irradiance, unsure = light.look_up(far)
            if stretch < MOST_SHORT:
                near = Points.empty(len(far.owner))
                # Past a mirror or glass the last stretch says nothing about how near the gathering point is.
                count = take_unsure(far, unsure, 0.0 if depth else light.resolution_m, near)
                again.append(Points(*rows(near, slice(0, count))))
            reflect_irradiance(far, irradiance, radiance)
        near = join(again)
        if not len(near.owner):
            break
        lit, shadow = sample_lights(context, near, 0, len(near.owner), 1)
        add_weighted(near, lit, radiance)
        if light.caustics is not None:
            reflect_irradiance(near, light.caustics(near.position, near.normal, near.key).irradiance, radiance)
        onward = Rays.empty(len(near.owner))
        count = continue_paths(near, context.sobol, stretch, onward)
        reached, _, through = follow_to_diffuse(
            context, Rays(*rows(onward, slice(0, count))), radiance,
            split=False, first_emission=False, specular_emission=emission,
        )  # fmt: skip
        traced += shadow + through
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
