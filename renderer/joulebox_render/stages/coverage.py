"""Boundary bias: density estimates whose disc hangs over the surface's end, and what it takes to put them right."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.coverage import aim_probes, covered_share
from joulebox_render.records import F4, I8, U8, Estimates
from joulebox_render.stages.context import Context

PROBES = 16
# No estimate grows more than fivefold: a disc less covered than this is taken for covered this much.
LEAST_SHARE = 0.2
# Estimates more lopsided than this are probed: nearly all whose disc lacks a tenth, and exp(-1) = 37 % of those that
# lack nothing. What is missed is 0.02 % of the brightness of cornell-boxes, of the 0.7 % that all of the bias takes.
LOPSIDED = 1.0
# How fewer photons lie tells nothing: on half a disc nine are lopsided by 3 in the mean, three by 1, as by chance.
FEW = 9


class Probes(NamedTuple):
    """Rays towards places on discs: origin [m] and direction (N, 3) f4, length (N,) f4 to the disc's plane [m], and
    share2 (N,) f4, the place's squared distance from the disc's middle in radii.
    """

    origin: F4
    direction: F4
    length: F4
    share2: F4

    @classmethod
    def empty(cls, count: int) -> Probes:
        """Room for `count` probes."""
        origin, direction = np.empty((2, count, 3), np.float32)
        length, share2 = np.empty((2, count), np.float32)
        return cls(origin, direction, length, share2)


def correct_boundaries(
    context: Context, cos_limit: float, filter_kind: int, position: F4, normal: F4, key: U8, estimates: Estimates
) -> None:
    """Divide the irradiance of estimates by the share of their discs that the surface fills."""
    few = (estimates.found > 0) & (estimates.found < FEW)
    chosen: I8 = np.flatnonzero(few | (estimates.lopsided > LOPSIDED))
    probes = Probes.empty(len(chosen) * (1 + PROBES))
    aim_probes(context.tables, position, normal, key, estimates.radius, chosen, PROBES, probes)
    hits = context.intersector.closest(probes.origin, probes.direction)
    share = np.empty(len(chosen))
    covered_share(context.tables, normal, chosen, PROBES, cos_limit, filter_kind, probes, hits, share)
    estimates.irradiance[chosen] /= np.maximum(share, LEAST_SHARE)[:, None].astype(np.float32)
