"""Predictions for combinations of settings that were never run, from those that were.

The logs of what each stage takes, and a power of the difference, are each a sum over settings, with terms for settings
together where the data supports them; see `regression` and `anova`.
"""

import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulebox_server.analysis.anova import ENOUGH, Factor
from joulebox_server.analysis.difference import VALUE_EXPONENT
from joulebox_server.analysis.documents import Axis, Point, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.lines import is_number, varied
from joulebox_server.analysis.regression import Regression, parts_of

MIN_POINTS = 8
POINTS_PER_EFFECT = 2
"""Fewer measured points than this, or than two for each value that a setting was changed to, teach nothing."""
COST_TAILS, DIFFERENCE_TAILS = 1.0, 1.4
"""By what factor errors are larger than the regression thinks, and than points that are left out show.

Differences are no sum of stages: what pairs of settings do not explain is left, and points also served to choose how
strong each setting's effect is."""
DIFFERENCE_POWERS = (0.0, 2 / VALUE_EXPONENT)
"""Of a difference that effects of settings may add up in: logs, or the square of noise. A difference is a sum over
pixels of how visible the noise there is, to a power; noise from independent sources adds up in its square."""
NEAR_LIMITS, NEAR_ENOUGH = 8.0, 400
"""What differs by more limits than this does not steady what is near the limit, where there is enough that does; and
by how many near points the strengths of effects are chosen.

Pictures far beyond the limit follow a law of their own: there the brightness itself is wrong, not only noisy."""
MAX_COMBINATIONS = 20_000
"""Of larger grids a sample of this many is looked at."""


@dataclass(frozen=True)
class Forecast:
    """What a combination is predicted to cost and to differ by."""

    settings: dict[str, Any]
    cost: Interval
    difference: Interval


class Surrogate:
    """Fitted to the points of one trade-off for one cost. `possible` tells whether there are enough of them."""

    def __init__(self, tradeoff: Tradeoff, axis: Axis) -> None:
        self._tradeoff, self._axis = tradeoff, axis
        self.points = [p for p in tradeoff.points if p.cost(axis) is not None and p.difference is not None]
        self._levels = _varied_levels(self.points)
        self._factors = [_factor(values) for values in self._levels.values()]
        self.possible = _are_enough(self.points)

    @cached_property
    def _costs(self) -> Regression:
        """What is learnt of the cost; made only when something is to be told, as the next."""
        costs = [cost for point in self.points if (cost := point.cost(self._axis)) is not None]
        return Regression(
            self._factors,
            self._codes([point.settings for point in self.points]),
            costs,
            parts_of(self.points, self._axis),
            _repeats(self.points),
            self._tradeoff.shared.of(self._axis),
            self._tradeoff.confidence,
            COST_TAILS,
        )

    @cached_property
    def _differences(self) -> Regression:
        return self._of_differences(self.points)

    def _of_differences(self, points: Sequence[Point], enough: int = ENOUGH) -> Regression:
        """What these points teach of the difference."""
        return Regression(
            self._factors,
            self._codes([point.settings for point in points]),
            [point.difference for point in points if point.difference is not None],
            np.ones((1, len(points))),
            _repeats(points),
            self._tradeoff.shared.difference_share,
            self._tradeoff.confidence,
            DIFFERENCE_TAILS,
            DIFFERENCE_POWERS,
            enough,
        )

    def steadied(self) -> list[tuple[Point, Interval, Interval]]:
        """Cost and difference of the points that were measured, each steadied by others."""
        return list(zip(self.points, self._costs.steadied(), self._steadied_differences(), strict=True))

    def _steadied_differences(self) -> list[Interval]:
        """Of points near the limit by those that are near it too, of others by all."""
        told = self._differences.steadied()
        limit = NEAR_LIMITS * self._tradeoff.limit
        near = [k for k, p in enumerate(self.points) if p.difference is not None and p.difference.value <= limit]
        points = [self.points[k] for k in near]
        if len(near) < len(told) and _are_enough(points):
            for k, interval in zip(near, self._of_differences(points, NEAR_ENOUGH).steadied(), strict=True):
                told[k] = interval
        return told

    def never_run(self) -> list[dict[str, Any]]:
        """Every combination of values that were run, apart from those that were run together."""
        levels = list(self._levels.values())
        combinations: Iterable[tuple[Any, ...]] = product(*levels)
        if math.prod(len(values) for values in levels) > MAX_COMBINATIONS:
            draw = random.Random(MAX_COMBINATIONS)
            combinations = [tuple(draw.choice(values) for values in levels) for _ in range(MAX_COMBINATIONS)]
        known = {tuple(map(str, (p.settings.get(name) for name in self._levels))) for p in self.points}
        new = {key: values for values in combinations if (key := tuple(map(str, values))) not in known}
        base = self.points[0].settings
        return [{**base, **dict(zip(self._levels, values, strict=True))} for values in new.values()]

    def forecasts(self, settings: Sequence[dict[str, Any]]) -> list[Forecast]:
        """Predictions with intervals; every value must be one that was run."""
        if not settings:
            return []
        codes = self._codes(settings)
        costs, differences = self._costs.forecast(codes), self._differences.forecast(codes)
        return [Forecast(*each) for each in zip(settings, costs, differences, strict=True)]

    def _codes(self, settings: Sequence[Mapping[str, Any]]) -> NDArray[np.intp]:
        places = {name: {str(value): k for k, value in enumerate(values)} for name, values in self._levels.items()}
        return np.array([[places[name][str(given.get(name))] for name in self._levels] for given in settings], np.intp)


def _are_enough(points: Sequence[Point]) -> bool:
    """Whether these points can tell the effects of what was changed between them."""
    effects = sum(len(values) - 1 for values in _varied_levels(points).values())
    return effects > 0 and len(points) >= max(MIN_POINTS, POINTS_PER_EFFECT * effects + 1)


def _repeats(points: Sequence[Point]) -> NDArray[np.float64]:
    return np.array([float(point.repeats) for point in points])


def _varied_levels(points: Sequence[Point]) -> dict[str, list[Any]]:
    """The values of each setting that differs between points."""
    return {name: _levels(name, points) for name in varied([point.settings for point in points])}


def _levels(name: str, points: Sequence[Point]) -> list[Any]:
    """The values of a setting, numbers in rising order."""
    found = {str(point.settings.get(name)): point.settings.get(name) for point in points}
    values = list(found.values())
    return sorted(values) if all(is_number(value) for value in values) else values


def _factor(values: Sequence[Any]) -> Factor:
    """Numbers by their logarithm where all are above 0, else by rank; words have no order."""
    if not all(is_number(value) for value in values):
        return Factor(None)
    scale = np.log(values) if min(values) > 0 else np.arange(len(values), dtype=np.float64)
    return Factor((scale - scale[0]) / (scale[-1] - scale[0]))
