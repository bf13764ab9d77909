"""Glossy lobes: the rays that follow them, and direct light by samples of the lights besides."""

from __future__ import annotations

import numpy as np

from joulebox_render.kernels.gathering import add_weighted
from joulebox_render.kernels.lighting import add_unblocked
from joulebox_render.kernels.lobes import lobe_rays, lobe_shadow_rays
from joulebox_render.kernels.rng import INDEPENDENT, SOBOL
from joulebox_render.records import ENVIRONMENT, F4, F8, POINT_LIGHT, SPOT_LIGHT, Lobes, Rays, ShadowRays
from joulebox_render.stages.context import Context


def follow_lobes(context: Context, lobes: Lobes, fan: int, first: int, rays: Rays, density: F4) -> int:
    """Write `fan` rays from each lobe, and their density (N,) f4, from row `first` on; returns the rows filled.

    The rays before are of no lobe: their density becomes 0.
    """
    density[:first] = 0.0
    return int(lobe_rays(lobes, fan, SOBOL if context.sobol else INDEPENDENT, first, rays, density))


def light_lobes(context: Context, lobes: Lobes, samples: int, fan: int, radiance: F8) -> None:
    """Add what lobes reflect of `samples` of each area light, and of point lights, to their owners.

    radiance (owners, 3) f8. Where rays of the lobe, `fan` from each, may find the light too, only the samples' share
    is added; kernels.lobes.add_emission adds the rays'.
    """
    count = len(lobes.exponent)
    reflected = np.zeros((count, 3))
    # By parts, so that many samples do not need much memory.
    step = max(1, context.pool.chunk_rays // samples)
    for first in range(0, max(count, 1), step):
        last = min(first + step, count)
        for light in np.flatnonzero(context.tables.light_kind != ENVIRONMENT):
            _sample_light(context, int(light), lobes, first, last, samples, fan, reflected[first:last])
    add_weighted(lobes.at, reflected, radiance)


def _sample_light(
    context: Context, light: int, lobes: Lobes, first: int, last: int, samples: int, fan: int, radiance: F8
) -> None:
    """Add one light at lobes [first, last) to radiance (last - first, 3) f8."""
    tables = context.tables
    count = 1 if tables.light_kind[light] in (POINT_LIGHT, SPOT_LIGHT) else samples
    shadow = ShadowRays.empty((last - first) * count)
    written = lobe_shadow_rays(tables, light, count, fan, context.columns(count), lobes, first, last, shadow)
    blocked = context.intersector.occluded(shadow.origin[:written], shadow.direction[:written], shadow.limit[:written])
    add_unblocked(tables, light, lobes.at, first, blocked, shadow, radiance)
