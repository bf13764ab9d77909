"""What is learnt of a quantity from all points together: a regression over settings for each of its parts.

A cost is the sum of what its stages take, and each stage depends on few settings and nearly as a product of powers
of them: so each is fitted by itself in logs, and the sum is what is told. A difference has one part, and is nearly a
sum of what each source of noise does once it is raised to a power: so that is fitted where it explains more than logs
do. How much intervals of predictions must be widened is measured by leaving each point out in turn.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from joulebox_server.analysis.anova import ENOUGH, Anova, Factor, Prediction
from joulebox_server.analysis.documents import Axis, Point
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.scatter import factor

Array = NDArray[np.float64]

TURNS = 4
"""Of iterated least squares; they settle to a thousandth in three."""
_TINY = 1e-6


class Regression:
    """Fitted to what was measured of a quantity at some points.

    codes       (n, settings) places of the settings' values, see `anova`
    measured    (n,) with intervals
    parts       (k, n) what the values are sums of, in any unit
    repeats     (n,) behind each value
    shared      half-width that all points have in common, as a share: no comparison of points tells anything of it
    tails       by what factor errors are larger than the regression thinks
    powers      of the parts that settings' effects may add up in, 0 for logs; the likeliest one is taken
    enough      points that the strengths of effects are chosen by
    """

    def __init__(
        self,
        factors: list[Factor],
        codes: NDArray[np.intp],
        measured: Sequence[Interval],
        parts: Array,
        repeats: Array,
        shared: float,
        confidence: float,
        tails: float,
        powers: Sequence[float] = (0.0,),
        enough: int = ENOUGH,
    ) -> None:
        self._shared, self._normal, self._tails = shared, factor(confidence, math.inf), tails
        values = np.array([max(each.value, _TINY) for each in measured])
        half = np.array([each.high - each.value for each in measured]) / values
        self._variance = np.maximum(half**2 - shared**2, 0.0) / self._normal**2
        self._variance = _smooth(factors, codes, self._variance, repeats)
        self._logs = np.log(values)
        shares = parts / parts.sum(axis=0)
        self._models = [_Fit(factors, codes, values * share, self._variance, powers, enough) for share in shares]
        self._widened = self._honest(confidence)

    def _honest(self, confidence: float) -> float:
        """Half-width in standard deviations that predictions need: what leaving each point out in turn shows.

        At least Student's; more where the residuals are larger than the regression thinks, or have heavier tails: the
        residual that a share `confidence` of one more draw would stay below (split conformal; Lei et al. 2018).
        """
        expected = _sum([model.left_out() for model in self._models])
        residuals = np.sort(np.abs(self._logs - expected.mean) / np.sqrt(expected.sd**2 + self._variance))
        place = min(math.ceil((len(residuals) + 1) * confidence), len(residuals)) - 1
        return max(float(residuals[place]), factor(confidence, len(residuals) - 1))

    def forecast(self, codes: NDArray[np.intp]) -> list[Interval]:
        """At combinations that were not measured."""
        return self._intervals(_sum([model.predict(codes) for model in self._models]), self._widened)

    def steadied(self) -> list[Interval]:
        """At the points themselves."""
        return self._intervals(_sum([model.steadied() for model in self._models]), self._normal)

    def _intervals(self, found: Prediction, width: float) -> list[Interval]:
        half = np.hypot(self._tails * width * found.sd, self._shared)
        bounds = [np.exp(found.mean + sign * half) for sign in (-1, 0, 1)]
        return [
            Interval(low=float(low), value=float(v), high=float(high)) for low, v, high in zip(*bounds, strict=True)
        ]


def _smooth(factors: list[Factor], codes: NDArray[np.intp], variance: Array, repeats: Array) -> Array:
    """Variances of means as settings alone explain them, by a regression of their logs.

    A few repeats that lack the one bad seed in ten look exact, and low. Trusted by its own scatter, every such point
    would pull the regression below what the settings give in the mean.
    """
    if not (variance > 0).all():
        return variance
    model = Anova(factors, codes, np.log(variance * repeats), np.zeros(len(variance)))
    told = model.predict(codes)
    level = np.log(np.mean(variance * repeats)) - np.log(np.mean(np.exp(told.mean)))
    return np.asarray(np.exp(told.mean + level) / repeats)


class _Fit:
    """Effects of settings on (v^p - 1) / p, or on log v where p is 0 (Box & Cox 1964); it tells of logs of v.

    What is fitted are means, and a power of a mean is not the mean of powers. Iterated least squares of a generalised
    linear model with constant relative variance: see McCullagh & Nelder 1989, section 2.5.
    """

    def __init__(
        self,
        factors: list[Factor],
        codes: NDArray[np.intp],
        values: Array,
        variance: Array,
        powers: Sequence[float],
        enough: int,
    ) -> None:
        """Fit to values (n,) > 0 with relative variances (n,)."""
        logs = np.log(values)
        fits = [
            (power, Anova(factors, codes, _powered(logs, power), _square(logs, power, variance), enough=enough))
            for power in powers
        ]
        self._power, self._model = max(fits, key=lambda fit: fit[1].log_likelihood + (fit[0] - 1) * float(logs.sum()))
        for _ in range(TURNS):
            told = self._model.steadied()
            logs = self._in_logs(told).mean
            target = told.mean + (values - np.exp(logs)) * np.exp((self._power - 1) * logs)
            self._model = Anova(factors, codes, target, _square(logs, self._power, variance), self._model.strengths)

    def predict(self, codes: NDArray[np.intp]) -> Prediction:
        """See `Anova`, as the next two."""
        return self._in_logs(self._model.predict(codes))

    def steadied(self) -> Prediction:
        return self._in_logs(self._model.steadied())

    def left_out(self) -> Prediction:
        return self._in_logs(self._model.left_out())

    def _in_logs(self, told: Prediction) -> Prediction:
        """To first order; what may well be below 0 is taken to be as large as it is uncertain."""
        if not self._power:
            return told
        powered = np.maximum(1 + self._power * told.mean, self._power * told.sd)
        return Prediction(np.log(powered) / self._power, told.sd / powered)


def _powered(logs: Array, power: float) -> Array:
    """(v^p - 1) / p of v given by its log."""
    return np.expm1(power * logs) / power if power else logs


def _square(logs: Array, power: float, variance: Array) -> Array:
    """Variances of a power from relative ones."""
    return np.asarray(np.exp(2 * power * logs) * variance)


def _sum(parts: Sequence[Prediction]) -> Prediction:
    """The log of a sum of parts that are known in logs, each erring for itself."""
    values = np.exp([part.mean for part in parts])
    total = values.sum(axis=0)
    return Prediction(np.log(total), np.sqrt(np.sum((values * [part.sd for part in parts]) ** 2, axis=0)) / total)


def parts_of(points: Sequence[Point], axis: Axis) -> Array:
    """(k, n) what each stage takes of a point's cost, by its share of energy, or of time where that is not known.

    Stages that some points lack are one part together; where some lack all of these, the cost is not told apart.
    """
    names = list(dict.fromkeys(name for point in points for name in point.stages))
    by_energy = axis == "energy_j" and all(s.energy_j is not None for p in points for s in p.stages.values())
    taken = np.array([[_taken(point, name, by_energy) for point in points] for name in names])
    whole = np.ones((1, len(points)))
    if not names:
        return whole
    everywhere = (taken > 0).all(axis=1)
    rest = taken[~everywhere].sum(axis=0, keepdims=True)
    if not rest.any() and everywhere.any():
        return taken[everywhere]
    return np.vstack([taken[everywhere], rest]) if rest.all() else whole


def _taken(point: Point, name: str, by_energy: bool) -> float:
    if name not in point.stages:
        return 0.0
    cost = point.stages[name]
    return max((cost.energy_j or 0.0) if by_energy else cost.time_s, 0.0)
