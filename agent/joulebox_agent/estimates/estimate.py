"""Intervals over windows, and how many windows a wanted half-width needs.

Windows, not samples: a gauge's samples are autocorrelated.
Source: Stein 1945, "A two-sample test for a linear hypothesis whose power is independent of the variance".
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

CONFIDENCE = 0.95
MOST_NEEDED = 1_000_000_000  # windows; more than anybody will measure


class Interval(BaseModel):
    """An estimate and its two-sided bounds, all in the unit of the field that holds it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    value: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        return self.value - self.low


def t_quantile(degrees_of_freedom: float, confidence: float = CONFIDENCE) -> float:
    """Student's t such that |t| is exceeded with probability 1 - confidence."""
    from scipy.special import stdtrit  # loads for half a second, which no other command should wait for

    return float(stdtrit(degrees_of_freedom, 0.5 + confidence / 2))


def mixture_half_width(
    weights: NDArray[np.float64], errors: NDArray[np.float64], degrees_of_freedom: float, confidence: float = CONFIDENCE
) -> float:
    """Half-width that holds an error which is Student's t times errors[k] with probability weights[k].

    weights, errors  (m,) of sum 1; standard errors > 0
    """
    from scipy.special import stdtr

    t = t_quantile(degrees_of_freedom, confidence)
    low, high = t * float(errors.min()), t * float(errors.max())
    for _ in range(40):  # halves the bracket each time, down to rounding
        middle = (low + high) / 2
        beyond = 2 * float(weights @ stdtr(degrees_of_freedom, -middle / errors))
        low, high = (middle, high) if beyond > 1 - confidence else (low, middle)
    return high


def two_stage_interval(
    values: Sequence[float], pilot_count: int, confidence: float = CONFIDENCE, least_half: float = 0.0
) -> Interval:
    """Mean of all values with the bounds of Stein's two-stage rule.

    The spread and its degrees of freedom are the pilot's (the first `pilot_count` values): the number of
    further windows was chosen from that spread, and only so the interval keeps its rate. Student's t over
    all windows would cover 92.6 instead of 95 % in the middle of the range. Without further windows both
    are the same. `least_half` is the least half-width, which drift between the windows asks for (drift.py) or a
    counter's step (`step_half`).
    Raises ValueError for fewer than two values, which say nothing of their spread.
    """
    if len(values) < 2:
        raise ValueError("an interval needs at least two values")
    mean = float(np.mean(values))
    pilot = values[: max(2, pilot_count)]
    spread = float(np.std(pilot, ddof=1))
    half = max(least_half, t_quantile(len(pilot) - 1, confidence) * spread / math.sqrt(len(values)))
    return Interval(value=mean, low=mean - half, high=mean + half)


@cache
def step_half(count: int) -> float:
    """Least half-width, in steps, of the mean of `count` >= 2 differences of a counter that moves in steps.

    Steady windows of 29.4 steps are told as 29 or 30, by where each begins, and where all are told alike they have no
    spread. With any fraction of a step as likely as another, k of them told as the greater leave it Beta(k + 1,
    count - k + 1): the half-width is such that it and Student's t, whichever is wider, hold 95 % over all k.
    """
    from scipy.special import betainc

    greater = np.arange(count + 1)
    share = greater / count
    by_spread = t_quantile(count - 1) * np.sqrt(share * (1 - share) / (count - 1))

    def held(least: float) -> float:
        half = np.maximum(by_spread, least)
        upto = [betainc(greater + 1, count - greater + 1, np.clip(share + side * half, 0, 1)) for side in (1, -1)]
        return float(np.mean(upto[0] - upto[1]))

    low, high = 0.0, 1.0
    for _ in range(30):  # halves the bracket each time, down to a billionth of a step
        middle = (low + high) / 2
        low, high = (low, middle) if held(middle) >= CONFIDENCE else (middle, high)
    return high if low > 0 else 0.0


def windows_needed(
    pilot: Sequence[float], half_width: float, confidence: float = CONFIDENCE, least_share: float = 0.0
) -> int:
    """Windows that Stein's rule asks for, at least the pilot's own.

    half_width   wanted half-width as a share of the mean, > 0
    least_share  half-width that drift or a counter's step asks for with the pilot alone, as such a share; it falls as
                 1 / sqrt(windows)
    """
    wanted = half_width * abs(float(np.mean(pilot)))
    spread = float(np.std(pilot, ddof=1))
    if spread == 0.0 and not least_share:
        return len(pilot)
    if wanted == 0.0:
        return MOST_NEEDED  # a mean of nothing is never known to a share of itself
    by_spread = t_quantile(len(pilot) - 1, confidence) * spread / wanted
    by_least = math.sqrt(len(pilot)) * least_share / half_width
    return max(len(pilot), math.ceil(min(max(by_spread, by_least), math.sqrt(MOST_NEEDED)) ** 2))


def net_of_idle(
    values_j: Sequence[float],
    times_s: Sequence[float],
    idle_w: Interval,
    idle_pieces: int,
    pilot_count: int,
    least_half: float = 0.0,
) -> Interval:
    """Energy above idle: gross - P_idle x T, window by window, with the variance of idle carried through.

    values_j, times_s  gross energy and wall time per image of every window; longer images cost more and idle longer,
                       so the spread of the difference is not that of the gross energy
    idle_pieces        stretches whose spread idle_w rests on
    least_half         least half-width of the gross energy [J]
    Degrees of freedom of the sum after Welch 1947; adding the half-widths in quadrature would hold 98.5 %.
    """
    above_j = [value_j - idle_w.value * time_s for value_j, time_s in zip(values_j, times_s, strict=True)]
    over_windows = two_stage_interval(above_j, pilot_count, least_half=least_half)
    parts = [
        (over_windows.half_width, min(len(above_j), max(2, pilot_count)) - 1),
        (idle_w.half_width * float(np.mean(times_s)), idle_pieces - 1),
    ]
    variances = [((half / t_quantile(freedom)) ** 2, freedom) for half, freedom in parts]
    total = sum(variance for variance, _ in variances)
    spread = sum(variance**2 / freedom for variance, freedom in variances)
    half = t_quantile(total**2 / spread) * math.sqrt(total) if spread > 0 else 0.0
    return Interval(value=over_windows.value, low=over_windows.value - half, high=over_windows.value + half)
