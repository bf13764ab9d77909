"""What every stage of one image shares."""

from __future__ import annotations

import math
from dataclasses import dataclass

from joulebox_render.intersect import Intersector
from joulebox_render.kernels.rng import INDEPENDENT, SOBOL
from joulebox_render.plan import Plan
from joulebox_render.pool import WorkerPool
from joulebox_render.settings import Settings
from joulebox_render.tables import SceneTables


@dataclass(frozen=True)
class Context:
    """Scene, settings, plan and workers of one image."""

    tables: SceneTables
    intersector: Intersector
    settings: Settings
    plan: Plan
    pool: WorkerPool

    @property
    def sobol(self) -> bool:
        """Whether samples come from Sobol sequences."""
        return self.settings.sampler == "sobol"

    def columns(self, count: int) -> int:
        """How `sample_2d` places `count` samples by the sampler that the settings name; see `grid` for stratified."""
        if self.settings.sampler == "stratified":
            return grid(count)
        return SOBOL if self.sobol else INDEPENDENT


def grid(count: int) -> int:
    """Columns of a grid of `count` cells, else -step of a Latin square.

    A grid is used where its cells are no more than four times as long as wide; a Latin square's step is near the
    golden section of the count and shares no factor with it.
    """
    columns = next(c for c in range(int(count**0.5), 0, -1) if count % c == 0)
    if columns * columns * 4 >= count:
        return columns
    return -next(step for step in range(int(count * 0.6180339887498949), count) if math.gcd(step, count) == 1)
