"""Confidence intervals of what was measured in windows, several times.

An interval is symmetric about its value except that it never reaches below 0: energies, times and
differences cannot.
"""

import math
from collections.abc import Mapping, Sequence

from pydantic import BaseModel, ConfigDict, model_validator

from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.scatter import Scatter, factor

TINY, MIN_DEVIATION = 1e-9, 1e-6
"""Stand for 0 where a logarithm is taken, and where it is divided by."""


class Interval(BaseModel):
    """A value and the bounds of its confidence interval, all in one unit; low <= value <= high."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    value: float
    low: float
    high: float

    @model_validator(mode="after")
    def _ordered(self) -> "Interval":
        if not self.low <= self.value <= self.high:
            raise ValueError(f"low {self.low}, value {self.value}, high {self.high} must be in rising order")
        return self

    def scaled(self, factor: float) -> "Interval":
        """The interval in another unit; factor > 0."""
        return Interval(value=self.value * factor, low=self.low * factor, high=self.high * factor)


def exactly(value: float) -> Interval:
    """An interval without width: the value is exact, or nothing is known of its scatter."""
    return Interval(value=value, low=value, high=value)


def log_deviation(bounded: Interval, confidence: float) -> float:
    """Standard deviation of the log of what is normal in logs and below `high` with the confidence.

    At even odds `high` is the value itself and tells nothing of it: then it is as if there were none.
    """
    reach = factor(2 * confidence - 1, math.inf)
    if not reach:
        return MIN_DEVIATION
    return max((math.log(max(bounded.high, TINY)) - math.log(max(bounded.value, TINY))) / reach, MIN_DEVIATION)


def t_factor(confidence: float, count: int) -> float:
    """Half-width of the interval of a mean in standard errors: two-sided Student t, count - 1 degrees."""
    return factor(confidence, count - 1)


def check_confidence(confidence: float) -> None:
    """Raise AnalysisError unless it is a number from 0.5 to 0.999."""
    if not 0.5 <= confidence <= 0.999:
        raise AnalysisError(f"the confidence is {confidence}, it must be from 0.5 to 0.999")


def over_repeats(
    repeats: Mapping[int, Interval],
    windows: Sequence[int],
    stated: Sequence[float],
    confidence: float,
    scatter: Scatter | None = None,
) -> Interval:
    """Interval of the mean over repeats that were each measured in windows.

    repeats     one interval a repeat, by its number, over its own windows
    stated      the confidence of each
    windows     windows behind each; from 2 on the interval is restated at `confidence` by Student's t
    scatter     how much repeats of all points scatter, where enough is known of it

    With two repeats or more it is the larger of (a) Student t over the repeats' values, whose scatter
    holds the noise of seeds, of the machine between repeats and of the windows (with `scatter` also for one
    repeat, and with what all points have in common), and (b) the windows' own half-widths combined,
    sqrt(sum h^2) / n. Adding both would count the windows twice; taking (a) alone would let a few repeats
    that agree by luck claim more than their windows support. With one repeat and no `scatter` it is (b), which
    knows nothing of what changes between repeats: the caller flags that.
    """
    count = len(repeats)
    restated = [
        # the upper side: the lower one may have been cut at 0
        (r.high - r.value) * (t_factor(confidence, n) / t_factor(c, n) if n >= 2 else 1.0)
        for r, n, c in zip(repeats.values(), windows, stated, strict=True)
    ]
    within = math.sqrt(sum(h * h for h in restated)) / count
    values = {repeat: interval.value for repeat, interval in repeats.items()}
    return _about(_level(values, scatter), max(_between(values, confidence, scatter), within))


def over_values(values: Mapping[int, float], confidence: float, scatter: Scatter | None = None) -> Interval:
    """Student t interval of the mean of values by repeat; without width where nothing is known of their scatter."""
    return _about(_level(values, scatter), _between(values, confidence, scatter))


def _level(values: Mapping[int, float], scatter: Scatter | None) -> float:
    """The mean; of a point that lacks repeats which others have, as all repeats would show it."""
    if scatter is not None and min(values.values()) > 0:
        return scatter.level(values)
    return math.fsum(values.values()) / len(values)


def _between(values: Mapping[int, float], confidence: float, scatter: Scatter | None) -> float:
    """Half-width by Student t over values; 0 for one value without `scatter`."""
    count = len(values)
    if scatter is not None and min(values.values()) > 0:
        return scatter.half_width(values, confidence)
    if count < 2:
        return 0.0
    mean = math.fsum(values.values()) / count
    variance = math.fsum((value - mean) ** 2 for value in values.values()) / (count - 1)
    return t_factor(confidence, count) * math.sqrt(variance / count)


def _about(value: float, half_width: float) -> Interval:
    return Interval(value=value, low=max(min(0.0, value), value - half_width), high=value + half_width)
