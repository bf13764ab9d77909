"""Paths that follow mirrors and glass until they meet diffuse surfaces."""

from __future__ import annotations

import numpy as np

from joulebox_render.kernels.lobes import add_emission
from joulebox_render.kernels.transport import advance
from joulebox_render.records import F4, F8, Hits, Lobes, Points, Rays, rows
from joulebox_render.stages.context import Context
from joulebox_render.stages.lobes import follow_lobes, light_lobes

# Rays of the glossy lobe that an eye ray meets first: one would show the lamp in it as noise.
LOBE_RAYS = 8
NO_LOBES: F4 = np.empty(0, np.float32)


def follow_to_diffuse(
    context: Context, rays: Rays, radiance: F8, *, split: bool, first_emission: bool, specular_emission: bool,
    hits: Hits | None = None,
) -> list[Points]:  # fmt: skip
    """The diffuse points of each depth that rays lead to through specular and glossy surfaces; first those met at once.

    radiance (owners, 3) f8 is added to: light emitted at the rays' first hits where `first_emission`, behind
    mirrors, glass and glossy surfaces where `specular_emission`; lobes then sample the lights, too. Paths end after
    `max_depth` bounces. `hits` are the rays' own, where they have been traced before.
    """
    reached: list[Points] = []
    samples = 0
    density = NO_LOBES
    depth_limit = context.settings.max_depth if context.plan.specular_recursion else 0
    for depth in range(depth_limit + 1):
        count = len(rays.owner)
        if count == 0:
            break
        if hits is None or depth:
            hits = context.intersector.closest(rays.origin, rays.direction)
        if specular_emission if depth else first_emission:
            add_emission(context.tables, samples, rays, density, hits, radiance)
        fan = LOBE_RAYS if split and depth == 0 and context.plan.glossy else 1
        points, lobes = Points.empty(count), Lobes.empty(count if context.plan.glossy else 0)
        following = Rays.empty(max(1 + split, fan) * count if context.plan.specular_recursion else 0)
        point_count, lobe_count, ray_count = advance(
            context.tables, split, context.sobol, rays, hits, points, lobes, following
        )
        reached.append(Points(*rows(points, slice(0, point_count))))
        if context.plan.glossy and depth < depth_limit:
            lobes = lobes.first(lobe_count)
            # As the diffuse part, lobes that eye rays meet at once take the samples that the settings ask for.
            samples = context.settings.shadow_rays if fan > 1 else 1
            if specular_emission:
                light_lobes(context, lobes, samples, fan, radiance)
            density = np.empty(len(following.owner), np.float32)
            ray_count = follow_lobes(context, lobes, fan, ray_count, following, density)
        rays = Rays(*rows(following, slice(0, ray_count)))
    return reached


def join(parts: list[Points]) -> Points:
    """One record of several, in order; the only one that holds any is taken as it is."""
    filled = [part for part in parts if len(part.owner)]
    if len(filled) > 1:
        return Points(*map(np.concatenate, zip(*filled, strict=True)))
    return filled[0] if filled else Points.empty(0)
