"""Direct lighting: shadow rays from points to stratified samples of every light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.close_lights import add_close, close_points, cosine_rays
from joulebox_render.kernels.lighting import add_unblocked, shadow_rays
from joulebox_render.kernels.shadow_photons import HIDDEN, LIT, find_cells
from joulebox_render.records import F8, POINT_LIGHT, SPOT_LIGHT, U1, Points, Rays, ShadowRays, rows
from joulebox_render.stages.context import Context
from joulebox_render.stages.shadow_photons import ShadowCells


class DirectLight(NamedTuple):
    """Reflected radiance (points, 3) f8, and the shadow rays that shadow photons saved."""

    radiance: F8
    rays_saved: int


def light_directly(context: Context, points: Points, cells: ShadowCells | None = None) -> DirectLight:
    """Reflected radiance of light that arrives unscattered; `cells` tell where no shadow rays are needed."""
    samples = context.settings.shadow_rays
    radiance = np.empty((len(points.owner), 3))

    def chunk(first: int, last: int) -> int:
        if cells is None:
            radiance[first:last] = sample_lights(context, points, first, last, samples)
            return 0
        radiance[first:last], saved = _sample_unknown(context, cells, points, first, last, samples)
        return saved

    # A chunk holds the rays to one light at a time.
    return DirectLight(radiance, sum(context.pool.map_chunks(chunk, len(points.owner), samples)))


def sample_lights(context: Context, points: Points, first: int, last: int, samples: int) -> F8:
    """Reflected radiance (last - first, 3) f8 of direct light at points [first, last).

    `samples` shadow rays go to each area light, one to each point light.
    """
    radiance = np.zeros((last - first, 3))
    for light in range(len(context.tables.light_kind)):
        _sample_light(context, light, points, first, last, samples, radiance)
    return radiance


def _sample_light(
    context: Context, light: int, points: Points, first: int, last: int, samples: int, radiance: F8, seen: bool = False
) -> int:
    """Add one light at points [first, last) to radiance (last - first, 3) f8; returns the samples taken.

    Where the light is known to be `seen`, none of them is traced.
    """
    tables = context.tables
    count = 1 if tables.light_kind[light] in (POINT_LIGHT, SPOT_LIGHT) else samples
    shadow = ShadowRays.empty((last - first) * count)
    written = shadow_rays(tables, light, count, context.columns(count), points, first, last, shadow)
    if seen:
        blocked: U1 = np.zeros(written, np.uint8)
    else:
        blocked = context.intersector.occluded(
            shadow.origin[:written], shadow.direction[:written], shadow.limit[:written]
        )
    add_unblocked(tables, light, points, first, blocked, shadow, radiance)
    return int(written) + _sample_close(context, light, points, first, last, count, radiance)


def _sample_close(context: Context, light: int, points: Points, first: int, last: int, count: int, radiance: F8) -> int:
    """Add the parts of a light that points are so close to that its own samples leave them out; returns the rays."""
    tables = context.tables
    if tables.light_close[light] == 0.0:
        return 0
    row = np.empty(last - first, np.int32)
    row = row[: close_points(tables, light, points, first, last, row)]
    if not len(row):
        return 0
    rays = Rays.empty(len(row) * count)
    u, v = np.empty((2, len(row) * count), np.float32)
    cosine_rays(points, row, light, count, context.columns(count), u, v, rays)
    hits = context.intersector.closest(rays.origin, rays.direction)
    add_close(tables, light, points, first, count, rays, hits, radiance)
    return len(rays.owner)


def _sample_unknown(
    context: Context, cells: ShadowCells, points: Points, first: int, last: int, samples: int
) -> DirectLight:
    """As sample_lights, but rays are traced only where the cells do not know what a light's samples would meet."""
    radiance = np.zeros((last - first, 3))
    saved = 0
    cell = np.empty(last - first, np.int32)
    find_cells(cells, points, first, last, cell)
    for light in range(len(context.tables.light_kind)):
        verdict = cells.verdict[light, cell]
        order = np.argsort(verdict, kind="stable")
        lit, hidden = np.searchsorted(verdict[order], (LIT, HIDDEN))
        ordered, sums = Points(*rows(points, first + order)), np.ascontiguousarray(radiance[order])
        _sample_light(context, light, ordered, 0, lit, samples, sums[:lit])
        saved += _sample_light(context, light, ordered, lit, hidden, samples, sums[lit:hidden], seen=True)
        # Where the light is hidden, one sample a point tells how many would have been above the horizon.
        unseen = np.zeros((len(order) - hidden, 3))
        saved += samples * _sample_light(context, light, ordered, hidden, len(order), 1, unseen, seen=True)
        radiance[order] = sums
    return DirectLight(radiance, saved)
