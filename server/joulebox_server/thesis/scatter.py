"""How far one render may be off: learnt from control runs and from seeds, where a configuration has one render.

Costs scatter in proportion to themselves, and so do differences over seeds, so both are looked at as logarithms. The
control runs of a sweep (its first configuration, rendered again and again, spread over the sweep) tell how far an
image's and a stage's cost scatter; configurations with several seeds tell how far a difference scatters. Each is
pooled over all of them, within each configuration about its own mean.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from joulebox_server.analysis.intervals import Interval, exactly
from joulebox_server.analysis.scatter import factor
from joulebox_server.thesis.rows import CostBasis, Row, configuration_key

CONFIDENCE = 0.99
"""Of every interval of the study: a claim looks at up to a dozen of them at once."""
SEEDS = "-seeds"
"""End of the names of sweeps that render a few ordinary settings with several seeds."""
SMALLEST_STAGE = 0.02
"""Share of an image's cost from which on a stage's scatter counts: a clock's grain is most of smaller ones."""


@dataclass(frozen=True)
class Spread:
    """Standard deviation of the logarithm of single values, and the degrees of freedom behind it."""

    sigma: float
    freedom: int

    def bounds(self, count: int) -> float:
        """Factor by which the mean of `count` values may be off, both ways."""
        return math.exp(factor(CONFIDENCE, self.freedom) * self.sigma / math.sqrt(count))


@dataclass(frozen=True)
class Scatters:
    """Of an image's cost, a stage's cost, a difference; None where nothing tells."""

    cost: Spread | None
    stage: Spread | None
    difference: Spread | None

    @classmethod
    def learnt(cls, rows: Iterable[Row], basis: CostBasis) -> "Scatters":
        """From everything in a run that was rendered more than once."""
        alike = _alike(rows)
        again = [g for g in alike if any(row.purpose == "control" for row in g)]
        costs = [[row.image.on(basis) for row in group] for group in again]
        stages = [
            [row.stages[name].on(basis) for row in group if name in row.stages]
            for group in again
            for name in {name for row in group for name in row.stages}
            if sum(row.stages[name].on(basis) for row in group if name in row.stages)
            > SMALLEST_STAGE * sum(row.image.on(basis) for row in group)
        ]
        seeds = [[row for row in group if row.sweep.endswith(SEEDS)] for group in alike]
        differences = [[row.difference for row in g if row.difference and row.purpose == "measure"] for g in seeds]
        return cls(_pooled(costs), _pooled(stages), _pooled(differences))


def interval_of(values: Sequence[float], spread: Spread | None) -> Interval:
    """Mean of values with its interval: Student t over three or more, else by the scatter of the whole run.

    Without either the interval has no width, which says that nothing is known.
    """
    mean = math.fsum(values) / len(values)
    if len(values) >= 3:
        variance = math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1)
        half = factor(CONFIDENCE, len(values) - 1) * math.sqrt(variance / len(values))
        return Interval(value=mean, low=max(min(0.0, mean), mean - half), high=mean + half)
    if spread is None or mean <= 0:
        return exactly(mean)
    by = spread.bounds(len(values))
    return Interval(value=mean, low=mean / by, high=mean * by)


def _alike(rows: Iterable[Row]) -> list[list[Row]]:
    """Rows of equal scene and settings but the seed, where there are two or more.

    A control run is the sweep's first configuration again, so it joins that one's rows.
    """
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.sweep, row.scene, configuration_key(row.settings)), []).append(row)
    return [group for group in groups.values() if len(group) > 1]


def _pooled(groups: Iterable[Sequence[float]]) -> Spread | None:
    """Within-group scatter of logarithms; None unless some group has two positive values."""
    squares, freedom = 0.0, 0
    for group in groups:
        logs = [math.log(value) for value in group if value > 0]
        if len(logs) > 1:
            mean = math.fsum(logs) / len(logs)
            squares += math.fsum((value - mean) ** 2 for value in logs)
            freedom += len(logs) - 1
    return Spread(math.sqrt(squares / freedom), freedom) if freedom else None
