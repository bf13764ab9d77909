"""Time, CPU time and rays of each stage, taken where the stage runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

STAGES = ("photon_map", "precomputed_irradiance", "direct", "indirect", "caustics")


@dataclass
class Interval:
    """One stretch of one stage: perf_counter_ns times, the process's CPU time in it [s], rays traced.

    rays_saved counts those that shadow photons made needless.

    part names a piece of a stage ("emission", "construction"); through_specular marks work on what is seen
    through mirrors and glass, which the thesis books under direct lighting.
    """

    name: str
    part: str
    through_specular: bool
    start_ns: int
    end_ns: int = 0
    cpu_s: float = 0.0
    rays: int = 0
    rays_saved: int = 0

    @property
    def time_s(self) -> float:
        """Length of the interval."""
        return (self.end_ns - self.start_ns) * 1e-9


@dataclass
class StageClock:
    """Collects the disjoint intervals of one image; `listener` hears of each as it ends.

    count_rays tells how many rays have been traced so far, by whatever stage.
    """

    listener: Callable[[Interval], None] | None = None
    count_rays: Callable[[], int] = lambda: 0
    intervals: list[Interval] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str, part: str = "", through_specular: bool = False) -> Iterator[Interval]:
        """Time a block as (a stretch of) a stage, and count its rays."""
        interval = Interval(name, part, through_specular, time.perf_counter_ns())
        cpu_start, rays_before = time.process_time(), self.count_rays()
        yield interval
        interval.rays = self.count_rays() - rays_before
        interval.cpu_s = time.process_time() - cpu_start
        interval.end_ns = time.perf_counter_ns()
        self.intervals.append(interval)
        if self.listener:
            self.listener(interval)

    def totals(self) -> dict[str, dict[str, float | int]]:
        """Sums of each stage that ran: time_s, cpu_s, rays, and <part>_s of its named parts."""
        sums: dict[str, dict[str, float | int]] = {}
        for interval in self.intervals:
            row = sums.setdefault(interval.name, {"time_s": 0.0, "cpu_s": 0.0, "rays": 0})
            _add(row, interval)
            if interval.part:
                row[f"{interval.part}_s"] = row.get(f"{interval.part}_s", 0.0) + interval.time_s
        return {name: sums[name] for name in STAGES if name in sums}

    def thesis_totals(self) -> dict[str, dict[str, float | int]]:
        """The thesis' booking: precomputation under map creation, all seen through specular under direct."""
        sums: dict[str, dict[str, float | int]] = {}
        for interval in self.intervals:
            name = "photon_map" if interval.name == "precomputed_irradiance" else interval.name
            name = "direct" if interval.through_specular else name
            _add(sums.setdefault(name, {"time_s": 0.0, "cpu_s": 0.0, "rays": 0}), interval)
        return {name: sums[name] for name in STAGES if name in sums}


def _add(row: dict[str, float | int], interval: Interval) -> None:
    row["time_s"] += interval.time_s
    row["cpu_s"] += interval.cpu_s
    row["rays"] += interval.rays
