"""What every stage of one image shares."""

from __future__ import annotations

import math
from dataclasses import dataclass

from joulebox_render.intersect import Intersector
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

    def columns(self, count: int) -> int:
        """How `sample_2d` places `count` samples: columns of a grid, -1 independent, else -step of a Latin square.

        A grid is used where its cells are no more than four times as long as wide; a Latin square's step is near
        the golden section of the count and shares no factor with it.
        """
        if self.settings.sampler == "independent":
            return -1
        columns = next(c for c in range(int(count**0.5), 0, -1) if count % c == 0)
        if columns * columns * 4 >= count:
            return columns
        return -next(step for step in range(int(count * 0.6180339887498949), count) if math.gcd(step, count) == 1)
