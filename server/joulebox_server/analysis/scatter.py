"""How much repeats scatter, learnt from all points of a trade-off together.

Three repeats say little about their own scatter: Student's factor for two degrees of freedom is 4.3, and a
point whose repeats agree by luck looks exact. But the points of one sweep are measured by one meter and
rendered by one method. Two things are learnt from them, both as shares of a value (in logs):

- what a repeat shifts for all points alike: a session's drift of meter and machine, a seed's luck. However many
  points there are, this is seen as often as there are repeats, so it is held to be at least about as large as
  experience says;
- what is left to each point alone. How alike points are in it is estimated from the points themselves, and each
  one's own scatter is drawn towards what is common (empirical Bayes; Smyth 2004, "Linear models and empirical
  Bayes methods for assessing differential expression", section 6.2).
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import digamma, polygamma
from scipy.stats import t as student_t

MIN_POINTS = 5
"""Fewer repeated points say too little about what is common."""
EVEN_ODDS = 0.5
"""The least confidence."""
MAX_FREEDOM = 1e4
"""Stands for "all alike"."""
SWEEPS = 20
"""Turns of alternating means; they settle in two where every point has every repeat."""


@dataclass(frozen=True)
class Experience:
    """What a repeat is held to shift for all points: a standard deviation as a share, worth so many repeats."""

    share: float
    freedom: float


DRIFT = Experience(0.03, 4.0)
"""Of costs, from session to session."""
SEED_LUCK = Experience(0.2, 4.0)
"""Of differences, from seed to seed: one seed's photons fall well or badly for all settings."""


@dataclass(frozen=True)
class Scatter:
    """Variances of one repeat as shares squared: own to each point, and shared by all points of a repeat."""

    own: float
    own_freedom: float
    shared: float
    shared_freedom: float
    shifts: Mapping[int, float]

    def half_width(self, values: Mapping[int, float], confidence: float) -> float:
        """Half-width of the interval of the mean of a point's values, by repeat, in their unit.

        One repeat has a half-width too: the common scatter is known even where its own is not.
        """
        count = len(values)
        logs = [math.log(value) - self.shifts.get(repeat, 0.0) for repeat, value in values.items()]
        seen = float(np.var(logs, ddof=1)) if count > 1 else 0.0
        freedom = self.own_freedom + count - 1
        own = (self.own_freedom * self.own + (count - 1) * seen) / freedom
        alone = factor(confidence, freedom) * math.sqrt(own / count)
        sessions = len(self.shifts) if values.keys() <= self.shifts.keys() else count
        return math.hypot(alone, self.shared_half_width(sessions, confidence)) * self.level(values)

    def level(self, values: Mapping[int, float]) -> float:
        """The mean of a point's values as all repeats would show it, without the shift of those that it has.

        The plain mean where it has all of them, or ones that nothing is known of.
        """
        shift = math.fsum(self.shifts.get(repeat, 0.0) for repeat in values) / len(values)
        return math.fsum(values.values()) / len(values) * math.exp(-shift)

    def shared_half_width(self, count: int, confidence: float) -> float:
        """By what share the means of so many repeats may be off, those of all points together."""
        return factor(confidence, self.shared_freedom) * math.sqrt(self.shared / count)


def one_sided(confidence: float) -> float:
    """Of a two-sided half-width, the part that bounds the value from above alone with the same confidence."""
    return factor(2 * confidence - 1, math.inf) / factor(confidence, math.inf)


def stretch(confidence: float, tries: int) -> float:
    """What a one-sided bound is to be multiplied by to hold for all of so many tries, normal errors given.

    At even odds the bound is the value itself, of which there is nothing to multiply.
    """
    if confidence == EVEN_ODDS:
        return 1.0
    return factor(1 - 2 * (1 - confidence) / tries, math.inf) / factor(2 * confidence - 1, math.inf)


@cache
def factor(confidence: float, freedom: float) -> float:
    """Half-width of a two-sided interval in standard errors: Student's t, the normal one for infinite freedom."""
    return float(student_t.ppf(0.5 + confidence / 2, freedom))


def common_scatter(points: Sequence[Mapping[int, float]], experience: Experience) -> Scatter | None:
    """What the repeats of several points have in common; None where too few points were repeated.

    points   the values of each point by repeat (or by seed); only those with two or more, all above 0, tell something.
             A repeat that too few points have is their own affair: it tells of own scatter alone
    """
    known = [values for values in points if len(values) > 1 and min(values.values()) > 0]
    if len(known) < MIN_POINTS:
        return None
    times = Counter(repeat for values in known for repeat in values)
    common = sorted(repeat for repeat, count in times.items() if count >= MIN_POINTS)
    logs = _by_column(known, common)
    shifts, residuals = _two_way(logs, len(common))
    counts = np.isfinite(logs).sum(axis=1)
    variances = np.nansum(residuals**2, axis=1) / (counts - 1)
    own, freedom = _moderated(variances, counts - 1.0)
    if not common:
        return Scatter(own, freedom, 0.0, math.inf, {})
    seen_freedom = len(common) - 1
    shared_freedom = experience.freedom + seen_freedom
    shared = (experience.freedom * experience.share**2 + float(np.sum(shifts**2))) / shared_freedom
    return Scatter(own, freedom, shared, shared_freedom, dict(zip(common, shifts.tolist(), strict=True)))


def _by_column(points: Sequence[Mapping[int, float]], common: Sequence[int]) -> NDArray[np.float64]:
    """(points, columns) of logs, NaN for none: one column for each common repeat, then each point's others in a row."""
    others = [[math.log(value) for repeat, value in values.items() if repeat not in set(common)] for values in points]
    most = max(len(each) for each in others)
    return np.array(
        [
            [math.log(values[r]) if r in values else math.nan for r in common] + each + [math.nan] * (most - len(each))
            for values, each in zip(points, others, strict=True)
        ]
    )


def _two_way(logs: NDArray[np.float64], common: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shift of each common repeat (their mean is 0), and what is left when they and each point's mean are taken off.

    common   columns, the first ones, that have a shift
    """
    shifts = np.zeros(logs.shape[1])
    for _ in range(SWEEPS):
        centred = logs - np.nanmean(logs - shifts, axis=1, keepdims=True)
        if common:
            shifts[:common] = np.nanmean(centred[:, :common], axis=0)
            shifts[:common] -= shifts[:common].mean()
    return shifts[:common], centred - shifts


def _moderated(variances: NDArray[np.float64], freedom: NDArray[np.float64]) -> tuple[float, float]:
    """The common variance, and the degrees of freedom that it counts for beside a point's own."""
    positive = variances > 0
    if positive.sum() < MIN_POINTS:
        return float(variances.mean()), MAX_FREEDOM
    variances, half = variances[positive], freedom[positive] / 2
    # log variances scatter by trigamma(own) through few repeats, and by trigamma(common) since points differ
    centred = np.log(variances) - digamma(half) + np.log(half)
    spread = float(np.var(centred, ddof=1)) - float(np.mean(polygamma(1, half)))
    common = _inverse_trigamma(spread)
    level = float(centred.mean()) + float(digamma(common)) - math.log(common)
    return math.exp(level), 2 * common


def _inverse_trigamma(value: float) -> float:
    """The x of trigamma(x) = value; the largest there is where the points scatter no more than chance."""
    if value <= float(polygamma(1, MAX_FREEDOM / 2)):
        return MAX_FREEDOM / 2
    return float(brentq(lambda x: float(polygamma(1, x)) - value, 1e-6, MAX_FREEDOM / 2))
