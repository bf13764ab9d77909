"""How often the 95 % interval holds the truth, over many scripted discharges of every case."""

from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from .discharge import Gauge, Machine
from .reading import Rule, measure


@dataclass(frozen=True)
class Case:
    """A machine, a gauge and how it is measured; group: what is asked of its intervals."""

    name: str
    group: str
    machine: Machine = field(default_factory=Machine)
    gauge: Gauge = field(default_factory=Gauge)
    rule: Rule = field(default_factory=Rule)


LAPTOP, HANDHELD = Machine(), Machine(stages=(("photon_map", 9.0, 0.8), ("direct", 4.0, 1.5), ("indirect", 6.5, 2.1)),
                                      idle_w=2.5, setup_w=5.0, between_w=3.0)  # fmt: skip
LONG_IMAGES = replace(LAPTOP, stages=(("photon_map", 24.0, 4.0), ("direct", 17.0, 9.0), ("indirect", 14.0, 6.0)))
DRIFTING = replace(LAPTOP, drift_share=0.02, drift_time_s=120.0)
STEADY = "without drift"
DRIFT = "with drift"
COUNTER = "from the counter"
COARSE = "beyond the gauge"
# (lowest, highest) share of runs whose interval holds the long-run joules per image
BOUNDS = {STEADY: (0.935, 0.965), DRIFT: (0.92, 1.0), COUNTER: (0.935, 1.0)}
CASES = (
    Case("refresh 1 s", STEADY, gauge=Gauge(1.0, 1.0)),
    Case("refresh 4 s", STEADY, gauge=Gauge(4.0, 4.0)),
    Case("refresh 15 s, windows of 240 s", STEADY, gauge=Gauge(15.0, 15.0), rule=Rule(window_s=240.0)),
    Case("refresh 30 s, windows of 450 s", STEADY, gauge=Gauge(30.0, 30.0), rule=Rule(window_s=450.0)),
    Case("refresh 2 s, mean of 10 s", STEADY, gauge=Gauge(2.0, 10.0)),
    Case("refresh 4 s, mean of 30 s", STEADY, gauge=Gauge(4.0, 30.0)),
    Case("refresh 4 s, power in steps of 0.5 W", STEADY, gauge=Gauge(4.0, 4.0, step_w=0.5)),
    Case("refresh 4 s, images of 19 s", STEADY, LONG_IMAGES, Gauge(4.0, 4.0), Rule(window_s=75.0)),
    Case("refresh 2 s, 9/4/6.5 W, noise 0.1 W", STEADY, HANDHELD, Gauge(2.0, 2.0, noise_w=0.1)),
    Case("refresh 4 s, second stage up to 20 windows", STEADY, gauge=Gauge(4.0, 4.0),
         rule=Rule(most=20, half_width=0.005)),
    Case("refresh 4 s, net of idle", STEADY, gauge=Gauge(4.0, 4.0), rule=Rule(idle=True)),
    Case("in blocks, refresh 4 s", STEADY, gauge=Gauge(4.0, 4.0), rule=Rule(blocks=True)),
    Case("in blocks, refresh 2 s, mean of 10 s", STEADY, gauge=Gauge(2.0, 10.0), rule=Rule(blocks=True)),
    Case("in blocks, refresh 4 s, mean of 30 s", STEADY, gauge=Gauge(4.0, 30.0), rule=Rule(blocks=True)),
    Case("1 % over 60 s, refresh 4 s, 10 windows", DRIFT, replace(LAPTOP, drift_share=0.01, drift_time_s=60.0),
         Gauge(4.0, 4.0), Rule(pilot=10, most=10)),
    Case("2 % over 120 s, refresh 4 s, 5 to 20 windows", DRIFT, DRIFTING, Gauge(4.0, 4.0), Rule(most=20)),
    Case("2 % over 120 s, refresh 2 s, 10 windows", DRIFT, DRIFTING, Gauge(2.0, 2.0), Rule(pilot=10, most=10)),
    Case("3 % over 180 s, refresh 4 s, 20 windows", DRIFT, replace(LAPTOP, drift_share=0.03, drift_time_s=180.0),
         Gauge(4.0, 4.0), Rule(pilot=20, most=20)),
    Case("2 % over 120 s, refresh 30 s, windows of 450 s", DRIFT, DRIFTING, Gauge(30.0, 30.0), Rule(window_s=450.0)),
    Case("in blocks, 2 % over 120 s, refresh 4 s", DRIFT, DRIFTING, Gauge(4.0, 4.0), Rule(blocks=True)),
    Case("in blocks, 2 % over 120 s, counter in steps of 36 J", DRIFT, DRIFTING, Gauge(4.0, 4.0, counter_step_j=36.0),
         Rule("battery_counter", blocks=True)),
    Case("steps of 3.6 J", COUNTER, gauge=Gauge(4.0, 4.0), rule=Rule("battery_counter")),
    Case("in blocks, steps of 3.6 J", STEADY, gauge=Gauge(4.0, 4.0), rule=Rule("battery_counter", blocks=True)),
    Case("in blocks, steps of 36 J", STEADY, gauge=Gauge(4.0, 4.0, counter_step_j=36.0),
         rule=Rule("battery_counter", blocks=True)),
    Case("steps of 36 J", COUNTER, gauge=Gauge(4.0, 4.0, counter_step_j=36.0), rule=Rule("battery_counter")),
    Case("refresh 30 s, windows of 20 s", COARSE, gauge=Gauge(30.0, 30.0), rule=Rule(window_s=20.0)),
    Case("counter in steps of 36 J, windows of 5 s", COARSE, gauge=Gauge(1.0, 1.0, counter_step_j=36.0),
         rule=Rule("battery_counter", window_s=5.0)),
)  # fmt: skip


@dataclass(frozen=True)
class Coverage:
    """Shares of the resolved runs whose interval holds what the windows drew, the long-run mean, the long-run net.

    bias        mean error against what was drawn, as a share
    half_width  median, as a share
    """

    case: Case
    runs: int
    resolved: int
    drawn: float
    long_run: float
    net: float | None
    bias: float
    half_width: float

    @property
    def within_bounds(self) -> bool:
        if self.case.group == COARSE:
            return self.resolved == 0
        low, high = BOUNDS[self.case.group]
        held = [self.long_run, *([] if self.net is None else [self.net])]
        return self.resolved == self.runs and all(low <= share <= high for share in held)


def covers(case: Case, seeds: Iterable[int]) -> list[tuple[bool, bool, bool | None, float, float] | None]:
    """By seed: interval holds the drawn, the long-run, the net energy; error and half-width as shares."""
    found: list[tuple[bool, bool, bool | None, float, float] | None] = []
    for seed in seeds:
        result = measure(seed, case.machine, case.gauge, case.rule)
        if result.gross is None:
            found.append(None)
            continue
        image_j, interval = result.machine.image_j, result.gross
        net_j = image_j - result.machine.idle_w * result.machine.image_s
        found.append((
            interval.low <= result.drawn_j <= interval.high,
            interval.low <= image_j <= interval.high,
            None if result.net is None else result.net.low <= net_j <= result.net.high,
            interval.value / result.drawn_j - 1,
            interval.half_width / image_j,
        ))  # fmt: skip
    return found


def coverage(case: Case, runs: int, pool: ProcessPoolExecutor | None = None) -> Coverage:
    """Runs a case with seeds 0 to runs - 1."""
    pieces = [range(first, min(runs, first + 50)) for first in range(0, runs, 50)]
    mapped = (pool.map if pool else map)(partial(covers, case), pieces)
    known = [row for part in mapped for row in part if row is not None]
    if not known:
        return Coverage(case, runs, 0, 0.0, 0.0, None, 0.0, 0.0)
    drawn, long_run, net, errors, halves = zip(*known, strict=True)
    nets = [one for one in net if one is not None]
    return Coverage(
        case,
        runs,
        len(known),
        drawn=float(np.mean(drawn)),
        long_run=float(np.mean(long_run)),
        net=float(np.mean(nets)) if nets else None,
        bias=float(np.mean(errors)),
        half_width=float(np.median(halves)),
    )
