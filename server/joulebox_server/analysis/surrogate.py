"""Predictions for combinations of settings that were never run, from those that were.

Log cost and log difference are each a sum over settings, with terms for pairs where the data supports them; see
`anova`. What the predictions are worth is measured by leaving each point out in turn, and their intervals are
widened to what that shows.
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

from joulebox_server.analysis.anova import Anova, Factor, Prediction
from joulebox_server.analysis.documents import Axis, Point, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.lines import is_number, varied
from joulebox_server.analysis.scatter import factor

MIN_POINTS = 8
POINTS_PER_EFFECT = 2
"""Fewer measured points than this, or than two for each value that a setting was changed to, teach nothing."""
COST_TAILS, DIFFERENCE_TAILS = 1.15, 1.4
"""By what factor intervals of predictions are wider than points that are left out show.

Those also served to choose how strong each setting's effect is; and of differences, they share the seeds of all others,
and a seed's luck is not quite the same for every setting."""
MAX_COMBINATIONS = 20_000
"""Of larger grids a sample of this many is looked at."""
_TINY = 1e-6


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
        self._names = varied([point.settings for point in self.points])
        self._levels = {name: _levels(name, self.points) for name in self._names}
        effects = sum(len(values) - 1 for values in self._levels.values())
        self.possible = effects > 0 and len(self.points) >= max(MIN_POINTS, POINTS_PER_EFFECT * effects + 1)

    @cached_property
    def _fits(self) -> tuple["_Fit", "_Fit"]:
        """Of the cost and of the difference; made only when something is to be predicted."""
        codes = self._codes([point.settings for point in self.points])
        factors = [_factor(values) for values in self._levels.values()]
        costs = [cost for point in self.points if (cost := point.cost(self._axis)) is not None]
        differences = [point.difference for point in self.points if point.difference is not None]
        shared = self._tradeoff.shared
        return (
            _Fit(factors, codes, costs, shared.of(self._axis), self._tradeoff.confidence, COST_TAILS),
            _Fit(factors, codes, differences, shared.difference_share, self._tradeoff.confidence, DIFFERENCE_TAILS),
        )

    def steadied(self) -> list[tuple[Point, Interval, Interval]]:
        """Cost and difference of the points that were measured, each steadied by all others."""
        costs, differences = (fit.steadied() for fit in self._fits)
        return list(zip(self.points, costs, differences, strict=True))

    def never_run(self) -> list[dict[str, Any]]:
        """Every combination of values that were run, apart from those that were run together."""
        levels = list(self._levels.values())
        combinations: Iterable[tuple[Any, ...]] = product(*levels)
        if math.prod(len(values) for values in levels) > MAX_COMBINATIONS:
            draw = random.Random(MAX_COMBINATIONS)
            combinations = [tuple(draw.choice(values) for values in levels) for _ in range(MAX_COMBINATIONS)]
        known = {tuple(map(str, (p.settings.get(name) for name in self._names))) for p in self.points}
        new = {key: values for values in combinations if (key := tuple(map(str, values))) not in known}
        base = self.points[0].settings
        return [{**base, **dict(zip(self._names, values, strict=True))} for values in new.values()]

    def forecasts(self, settings: Sequence[dict[str, Any]]) -> list[Forecast]:
        """Predictions with intervals; every value must be one that was run."""
        if not settings:
            return []
        codes = self._codes(settings)
        costs, differences = (fit.forecast(codes) for fit in self._fits)
        return [Forecast(*each) for each in zip(settings, costs, differences, strict=True)]

    def _codes(self, settings: Sequence[Mapping[str, Any]]) -> NDArray[np.intp]:
        places = {name: {str(value): k for k, value in enumerate(values)} for name, values in self._levels.items()}
        return np.array([[places[name][str(given.get(name))] for name in self._names] for given in settings], np.intp)


class _Fit:
    """A quantity's regression in logs, and how much its intervals must be widened.

    shared   half-width that all points have in common, as a share: no comparison of points tells anything of it
    tails    factor on the intervals of predictions
    """

    def __init__(
        self,
        factors: list[Factor],
        codes: NDArray[np.intp],
        measured: Sequence[Interval],
        shared: float,
        confidence: float,
        tails: float,
    ) -> None:
        self._shared, self._normal, self._tails = shared, factor(confidence, math.inf), tails
        values = np.array([max(each.value, _TINY) for each in measured])
        half = np.array([each.high - each.value for each in measured]) / values
        own = np.sqrt(np.maximum(half**2 - shared**2, 0.0)) / self._normal
        self._model = Anova(factors, codes, np.log(values), own**2)
        self._widened = self._honest(confidence)

    def _honest(self, confidence: float) -> float:
        """Half-width in standard deviations that predictions need: what leaving each point out in turn shows.

        At least Student's; more where the residuals are larger than the regression thinks, or have heavier tails: the
        residual that a share `confidence` of one more draw would stay below (split conformal; Lei et al. 2018).
        """
        residuals = np.sort(np.abs(self._model.left_out_residuals()))
        place = min(math.ceil((len(residuals) + 1) * confidence), len(residuals)) - 1
        return max(float(residuals[place]), factor(confidence, len(residuals) - 1))

    def forecast(self, codes: NDArray[np.intp]) -> list[Interval]:
        """At combinations that were not measured."""
        return self._intervals(self._model.predict(codes), self._widened, self._tails)

    def steadied(self) -> list[Interval]:
        """At the points themselves."""
        return self._intervals(self._model.steadied(), self._normal, 1.0)

    def _intervals(self, found: Prediction, width: float, tails: float) -> list[Interval]:
        half = tails * np.hypot(width * found.sd, self._shared)
        bounds = [np.exp(found.mean + sign * half) for sign in (-1, 0, 1)]
        return [
            Interval(low=float(low), value=float(v), high=float(high)) for low, v, high in zip(*bounds, strict=True)
        ]


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
