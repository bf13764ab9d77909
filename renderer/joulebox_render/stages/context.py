"""What every stage of one image shares."""

from __future__ import annotations

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
        """How `sample_2d` places `count` samples: columns of a grid, 0 a Latin square, -1 independent.

        A grid is used where its cells are no more than four times as long as wide.
        """
        if self.settings.sampler == "independent":
            return -1
        columns = next(c for c in range(int(count**0.5), 0, -1) if count % c == 0)
        return columns if columns * columns * 4 >= count else 0
