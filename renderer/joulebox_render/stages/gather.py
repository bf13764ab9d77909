"""Indirect light at diffuse points: final gathering, and unbiased paths."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from joulebox_render.kernels.gathering import add_weighted, reflect_mean, take_unsure
from joulebox_render.kernels.importance import CELL_COLUMNS, CELL_ROWS, incoming_chances
from joulebox_render.kernels.transport import continue_paths, gather_rays
from joulebox_render.records import F4, F8, Hits, Points, Rays, Scratch, rows
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
# Chunks of gathers that go together, so that the few second gathers they leave are traced in batches that are worth
# their arrays.
MOST_TOGETHER = 4


def final_gather(context: Context, light: Illumination, points: Points, count: int) -> F8:
    """Radiance (points, 3) f8 that points reflect of light from other surfaces, by `count` rays each."""

    def chunk(first: int, last: int) -> F8:
        chance = incoming(context, light, points, first, last)
        rays = aim_gather(points, first, last, count, context.columns(count), chance)
        incident, _ = incident_radiance(context, light, rays)
        radiance = np.empty((last - first, 3))
        reflect_mean(points, first, last, count, incident, radiance)
        return radiance

    return collect(context.pool.map_chunks(chunk, len(points.owner), count, MOST_TOGETHER))


def aim_gather(
    points: Points, first: int, last: int, count: int, columns: int, chance: F4, lattice: bool = False
) -> Rays:
    """`count` gather rays from each of points [first, last); see kernels.transport.gather_rays."""
    rays = Rays.empty((last - first) * count)
    u, v = np.empty((2, len(rays.owner)), np.float32)
    gather_rays(points, first, last, count, columns, lattice, chance, u, v, rays)
    return rays


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


def incident_radiance(context: Context, light: Illumination, rays: Rays) -> tuple[F8, F4]:
    """Radiance that comes in along gather rays, (N, 3) f8, and the distance it comes from (N,) f4 [m].

    Light that surfaces emit towards the rays' origins is left out: it is sampled directly, or, where it comes through
    mirrors and glass, shown by the caustic map; without a caustic map gather rays find it. Where a ray ends
    nearer than the photon map can tell apart (corners, contacts), or where what the map knows may belong behind a
    wall, the map is not asked about that place but about what lights it: a second gather of one ray, with direct light
    sampled (LuxCore's remedy); after MOST_SHORT such stretches it is asked all the same.
    """
    radiance = np.zeros((len(rays.owner), 3))
    distance = np.zeros(0, np.float32)
    for stretch in range(MOST_SHORT + 1):
        hits = context.intersector.closest(rays.origin, rays.direction)
        if stretch == 0:
            distance = hits.distance
        near = ask_map(context, light, rays, hits, stretch, radiance)
        if not len(near.owner):
            break
        lit = sample_lights(context, near, 0, len(near.owner), 1)
        add_weighted(near, lit, radiance)
        if light.caustics is not None:
            add_reflected(near, light.caustics(near.position, near.normal, near.key).irradiance, radiance)
        if stretch == context.settings.max_photon_bounces:
            break
        onward = Rays.empty(len(near.owner))
        count = continue_paths(near, context.sobol, stretch, onward)
        rays = Rays(*rows(onward, slice(0, count)))
    return radiance, distance


def ask_map(context: Context, light: Illumination, rays: Rays, hits: Hits, stretch: int, radiance: F8) -> Points:
    """Add what the map knows of the light at the ends of rays to radiance (owners, 3) f8; the points it knows not of.

    The map knows of as many bounces as photons make. Where that is fewer than stretches may follow each other, it
    would add bounces to those of the stretches before: then only the first asks it, and what it does not know is
    a path that ends by itself.
    """
    asks = stretch == 0 or context.settings.max_photon_bounces > MOST_SHORT
    last = stretch == MOST_SHORT
    unknown: list[Points] = []
    if asks and not last and light.has_table:
        near, rest = light.answer(context, rays, hits, radiance)
        if not len(rest):
            return near
        unknown.append(near)
        rays, hits = Rays(*rows(rays, rest)), Hits(*rows(hits, rest))
    reached = follow_to_diffuse(
        context, rays, radiance,
        split=False, first_emission=False, specular_emission=not context.plan.caustic_map, hits=hits,
    )  # fmt: skip
    if not asks:
        return join(reached)
    for depth, far in enumerate(reached):
        irradiance, unsure = light.look_up(far)
        if not last:
            near = Points.empty(len(far.owner))
            # Past a mirror or glass the last stretch says nothing about how near the gathering point is.
            count = take_unsure(far, unsure, 0.0 if depth else light.resolution_m, near)
            unknown.append(Points(*rows(near, slice(0, count))))
        add_reflected(far, irradiance, radiance)
    return join(unknown)


def add_to_owners(context: Context, points: Points, value: F8, radiance: F8) -> None:
    """Add weight x value (points, 3) of each point to its owner's radiance (owners, 3) f8, in the points' order.

    Each thread adds to owners of its own. Behind mirrors and glass points do not come in the order of their owners:
    there one thread adds them all.
    """
    owner = points.owner
    if (owner[1:] < owner[:-1]).any():
        add_weighted(points, value, radiance)
        return

    def chunk(first: int, last: int) -> None:
        own = slice(*np.searchsorted(owner, (first, last)))
        add_weighted(Points(*rows(points, own)), value[own], radiance)

    context.pool.map_chunks(chunk, len(radiance), -(-len(owner) // len(radiance)))


def add_reflected(points: Points, irradiance: F4, radiance: F8) -> None:
    """Add what points reflect of irradiance (N, 3) to their owners' radiance (owners, 3) f8."""
    add_weighted(points, points.albedo * irradiance.astype(np.float64) / math.pi, radiance)


def trace_paths(context: Context, points: Points) -> F8:
    """Radiance (points, 3) f8 of all light that bounced, one unbiased path a point.

    Next-event estimation at every diffuse point; emission counts where a path found it through specular and
    glossy surfaces, which next-event estimation cannot. Russian roulette after two bounces.
    """

    def chunk(first: int, last: int) -> F8:
        count = last - first
        radiance = np.zeros((count, 3))
        here = Points(*rows(points, slice(first, last)))._replace(
            weight=np.ones((count, 3), np.float32), owner=np.arange(count, dtype=np.int64)
        )
        for bounce in range(MAX_PATH_BOUNCES):
            rays = Rays.empty(len(here.owner))
            going_on = continue_paths(here, context.sobol, bounce, rays)
            if going_on == 0:
                break
            here = join(
                follow_to_diffuse(
                    context, Rays(*rows(rays, slice(0, going_on))), radiance, split=False,
                    first_emission=False, specular_emission=True,
                )
            )  # fmt: skip
            light = sample_lights(context, here, 0, len(here.owner), 1)
            add_weighted(here, light, radiance)
        return radiance

    return collect(context.pool.map_chunks(chunk, len(points.owner), 8))


def collect(chunks: Sequence[F8]) -> F8:
    """Radiance of all chunks in order."""
    return np.concatenate([np.zeros((0, 3)), *chunks])
