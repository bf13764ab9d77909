"""Paths that follow mirrors and glass until they meet diffuse surfaces."""

from __future__ import annotations

import numpy as np

from joulebox_render.kernels.transport import advance
from joulebox_render.records import F8, Points, Rays, rows
from joulebox_render.stages.context import Context


def follow_to_diffuse(
    context: Context, rays: Rays, radiance: F8, *, split: bool, first_emission: bool, specular_emission: bool
) -> tuple[list[Points], int]:
    """Trace rays through specular surfaces; returns the diffuse points of each depth and the rays traced.

    radiance (owners, 3) f8 is added to: light emitted at the rays' first hits where `first_emission`, behind
    mirrors and glass where `specular_emission`. Entry 0 of the list holds what the rays saw directly. Paths end
    after `max_depth` specular bounces.
    """
    reached: list[Points] = []
    traced = 0
    depth_limit = context.settings.max_depth if context.plan.specular_recursion else 0
    for depth in range(depth_limit + 1):
        count = len(rays.owner)
        if count == 0:
            break
        hits = context.intersector.closest(rays.origin, rays.direction)
        traced += count
        points = Points.empty(count)
        following = Rays.empty((2 if split else 1) * count if context.plan.specular_recursion else 0)
        emission = specular_emission if depth else first_emission
        point_count, ray_count = advance(
            context.tables, split, emission, rays, hits, radiance, points, following
        )
        reached.append(Points(*rows(points, slice(0, point_count))))
        rays = Rays(*rows(following, slice(0, ray_count)))
    return reached, traced


def join(parts: list[Points]) -> Points:
    """One record of several, in order."""
    if len(parts) == 1:
        return parts[0]
    return Points(*(np.concatenate(columns) for columns in zip(*parts, strict=True))) if parts else Points.empty(0)
