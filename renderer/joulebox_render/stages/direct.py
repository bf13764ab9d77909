"""Direct lighting: shadow rays from points to stratified samples of every light."""

from __future__ import annotations

import numpy as np

from joulebox_render.kernels.lighting import add_unblocked, shadow_rays
from joulebox_render.records import F8, POINT_LIGHT, SPOT_LIGHT, Points
from joulebox_render.stages.context import Context


def light_directly(context: Context, points: Points) -> tuple[F8, int]:
    """Reflected radiance of light that arrives unscattered, (points, 3) f8, and the shadow rays traced."""
    lights = len(context.tables.light_kind)
    rays_per_point = context.settings.shadow_rays * max(1, lights)

    def chunk(first: int, last: int) -> tuple[F8, int]:
        return sample_lights(context, points, first, last, context.settings.shadow_rays)

    chunks = list(context.pool.map_chunks(chunk, len(points.owner), rays_per_point))
    radiance = np.concatenate([part for part, _ in chunks]) if chunks else np.zeros((0, 3))
    return radiance, sum(traced for _, traced in chunks)


def sample_lights(context: Context, points: Points, first: int, last: int, samples: int) -> tuple[F8, int]:
    """Direct light at points [first, last) with `samples` shadow rays to each area light, one to each point light.

    Returns reflected radiance (last - first, 3) f8 and the rays traced.
    """
    tables = context.tables
    radiance = np.zeros((last - first, 3))
    traced = 0
    for light, kind in enumerate(tables.light_kind):
        count = 1 if kind in (POINT_LIGHT, SPOT_LIGHT) else samples
        room = (last - first) * count
        origin, direction = np.empty((2, room, 3), np.float32)
        limit, weight = np.empty((2, room), np.float32)
        owner = np.empty(room, np.int32)
        written = shadow_rays(
            tables, light, count, context.columns(count), points, first, last,
            origin, direction, limit, weight, owner,
        )  # fmt: skip
        blocked = context.intersector.occluded(origin[:written], direction[:written], limit[:written])
        add_unblocked(tables, light, points, first, blocked, weight, owner, radiance)
        traced += written
    return radiance, traced
