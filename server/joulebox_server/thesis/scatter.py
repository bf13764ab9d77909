"""How far a configuration's mean may be off, where three renders or fewer say little about their own scatter.

Costs scatter in proportion to themselves, and so do differences over seeds, so both are looked at as logarithms. What
tells is whatever was rendered more than once in the same family of sweeps: on the same scene, by the same method, in
the same minutes. Where a family has five such configurations or more, each one's own scatter is drawn towards what
they have in common (`analysis.scatter`); with fewer it is pooled. A family that rendered nothing twice is judged by
the scatter of the whole run.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from joulebox_server.analysis.intervals import Interval, exactly
from joulebox_server.analysis.scatter import Experience, Scatter, common_scatter, factor
from joulebox_server.thesis.rows import CostBasis, Row, base_sweep, configuration_key

CONFIDENCE = 0.99
"""Of every interval of the study: a claim looks at up to a dozen of them at once."""
SMALLEST_STAGE = 0.02
"""Share of an image's cost from which on a stage's scatter counts for others: a clock's grain is most of less."""
LEAST_FREEDOM = 4
"""Degrees of freedom from which on a family of few points is judged by itself."""
NO_EXPERIENCE = Experience(0.0, 0.0)

Quantity = tuple[str, ...]
"""`("cost",)`, `("time",)`, `("difference",)`, or `("stage", name, ...)`: the sum of stages."""
COST: Quantity = ("cost",)
TIME: Quantity = ("time",)
DIFFERENCE: Quantity = ("difference",)


def value_of(row: Row, quantity: Quantity, basis: CostBasis) -> float | None:
    """A quantity of one render; a stage that did not run costs nothing, a picture may not have been compared."""
    kind, *names = quantity
    if kind == "difference":
        return row.difference
    if kind == "stage":
        return math.fsum(row.stages[name].on(basis) for name in names if name in row.stages)
    return row.image.time_s if kind == "time" else row.image.on(basis)


@dataclass(frozen=True)
class Spread:
    """Standard deviation of the logarithm of single values, and the degrees of freedom behind it."""

    sigma: float
    freedom: int

    def bounds(self, count: int) -> float:
        """Factor by which the mean of `count` values may be off, both ways."""
        return math.exp(factor(CONFIDENCE, self.freedom) * self.sigma / math.sqrt(count))


class Scatters:
    """Of everything in a run that was rendered more than once; `basis` is what its costs rest on."""

    def __init__(self, rows: Iterable[Row], basis: CostBasis) -> None:
        self._basis = basis
        self._families: dict[str, list[Row]] = {}
        for row in rows:
            self._families.setdefault(family(row.sweep), []).append(row)
        self._learnt: dict[tuple[str, Quantity], Scatter | Spread | None] = {}

    def interval(self, rows: Sequence[Row], quantity: Quantity) -> Interval:
        """Mean of a quantity over the renders of one configuration, with its interval; one of them must have it."""
        values = [value for row in rows if (value := value_of(row, quantity, self._basis)) is not None]
        whole = {"difference": self.difference, "stage": self.stage}.get(quantity[0], self.cost)
        return interval_of(values, self._common(family(rows[0].sweep), quantity), whole)

    def _common(self, name: str, quantity: Quantity) -> Scatter | Spread | None:
        if (name, quantity) not in self._learnt:
            groups = list(self._values(self._families[name], quantity))
            # no two configurations share a number here: what a repeat does to all is left in, as scatter
            numbered = [dict(enumerate(values, 1000 * place)) for place, values in enumerate(groups)]
            found: Scatter | Spread | None = common_scatter(numbered, NO_EXPERIENCE)
            if found is None:
                pooled = _pooled(groups)
                found = pooled if pooled and pooled.freedom >= LEAST_FREEDOM else None
            self._learnt[name, quantity] = found
        return self._learnt[name, quantity]

    def _values(self, rows: Iterable[Row], quantity: Quantity) -> Iterable[list[float]]:
        """A quantity of every configuration that was rendered more than once."""
        for group in _alike(rows, seeds_alone=quantity == DIFFERENCE):
            yield [value for row in group if (value := value_of(row, quantity, self._basis)) is not None]

    # --- of the whole run ----------------------------------------------------------------------------------

    @cached_property
    def cost(self) -> Spread | None:
        """Of an image's cost."""
        return self._whole(COST)

    @cached_property
    def stage(self) -> Spread | None:
        """Of a stage's cost."""
        groups = [group for rows in self._families.values() for group in _alike(rows)]
        return _pooled(values for group in groups for values in self._stages(group))

    @cached_property
    def difference(self) -> Spread | None:
        """Of a difference, over seeds."""
        return self._whole(DIFFERENCE)

    def _whole(self, quantity: Quantity) -> Spread | None:
        return _pooled(values for rows in self._families.values() for values in self._values(rows, quantity))

    def _stages(self, group: Sequence[Row]) -> Iterable[list[float]]:
        image = math.fsum(row.image.on(self._basis) for row in group)
        for name in {name for row in group for name in row.stages}:
            values = [row.stages[name].on(self._basis) for row in group if name in row.stages]
            if math.fsum(values) > SMALLEST_STAGE * image:
                yield values


def family(sweep: str) -> str:
    """What a sweep shares with those that scatter alike: further seeds of it, and the same at other sizes."""
    return re.sub(r"-\d+$", "", base_sweep(sweep))


def interval_of(
    values: Sequence[float], common: Scatter | Spread | None = None, whole: Spread | None = None
) -> Interval:
    """Mean of values with its interval: by what their family has in common, else Student's t over three or more, else
    by the scatter of the whole run.

    Without any of them the interval has no width, which says that nothing is known.
    """
    mean = math.fsum(values) / len(values)
    positive = min(values) > 0
    if isinstance(common, Scatter) and positive:
        # a share of the mean, learnt from logarithms
        return _within(mean, math.exp(common.half_width(dict(enumerate(values)), CONFIDENCE) / mean))
    if isinstance(common, Spread) and positive:
        return _within(mean, common.bounds(len(values)))
    if len(values) >= 3:
        variance = math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1)
        half = factor(CONFIDENCE, len(values) - 1) * math.sqrt(variance / len(values))
        return Interval(value=mean, low=max(min(0.0, mean), mean - half), high=mean + half)
    if whole is None or mean <= 0:
        return exactly(mean)
    return _within(mean, whole.bounds(len(values)))


def paired(one: Mapping[int, float], other: Mapping[int, float]) -> Interval | None:
    """one / other by what they have in common, seed by seed: what a seed does to both falls out.

    The geometric mean of the ratios, with Student's t over their logarithms; None for fewer than three seeds.
    """
    logs = [math.log(one[n] / other[n]) for n in sorted(one.keys() & other.keys()) if one[n] > 0 and other[n] > 0]
    if len(logs) < 3:
        return None
    mean = math.fsum(logs) / len(logs)
    variance = math.fsum((value - mean) ** 2 for value in logs) / (len(logs) - 1)
    by = math.exp(factor(CONFIDENCE, len(logs) - 1) * math.sqrt(variance / len(logs)))
    return _within(math.exp(mean), by)


def _within(value: float, by: float) -> Interval:
    return Interval(value=value, low=value / by, high=value * by)


def _alike(rows: Iterable[Row], *, seeds_alone: bool = False) -> list[list[Row]]:
    """Rows of equal scene and settings but the seed, where there are two or more.

    A control run is a configuration again, so it joins that one's rows - but not where seeds alone are asked for: it
    has the seed that its configuration had, and a noise floor is a comparison of another kind.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if not seeds_alone or row.purpose == "measure":
            groups.setdefault((row.scene, configuration_key(row.settings)), []).append(row)
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
