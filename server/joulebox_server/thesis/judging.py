"""Intervals combined, and rules applied to them. A rule is decided by the whole interval, never by its middle."""

import math
from collections.abc import Sequence
from itertools import pairwise

from joulebox_server.analysis import words
from joulebox_server.analysis.intervals import Interval, exactly
from joulebox_server.thesis.batch import Finding, Verdict
from joulebox_server.thesis.results import MissingError

UNBOUNDED = 1e300
"""The upper end of an interval that has none: of what is divided by something that may be 0."""


def ratio(one: Interval, other: Interval) -> Interval:
    """one / other, errors taken as independent and in proportion. Raises MissingError for a divisor of 0."""
    if other.value <= 0:
        raise MissingError("there is nothing to compare with: the divisor is 0")
    value = one.value / other.value
    if value <= 0:
        return exactly(0.0)
    low, high = 0.0, UNBOUNDED
    if one.low > 0 and bounded(other):
        low = value * math.exp(-math.hypot(_log(one.value, one.low), _log(other.high, other.value)))
    if other.low > 0 and bounded(one):
        high = value * math.exp(math.hypot(_log(one.high, one.value), _log(other.value, other.low)))
    return Interval(value=value, low=low, high=high)


def bounded(value: Interval) -> bool:
    """Whether the interval has an upper end."""
    return value.high < UNBOUNDED


def share(part: Interval, rest: Interval) -> Interval:
    """part / (part + rest), errors of the two taken as independent and in proportion."""
    if part.value <= 0:
        return exactly(0.0)
    over = ratio(rest, part)
    low = 1 / (1 + over.high) if bounded(over) else 0.0
    return Interval(value=1 / (1 + over.value), low=low, high=1 / (1 + over.low))


def difference(one: Interval, other: Interval) -> Interval:
    """one - other, errors taken as independent."""
    value = one.value - other.value
    up = math.hypot(one.high - one.value, other.value - other.low)
    down = math.hypot(one.value - one.low, other.high - other.value)
    return Interval(value=value, low=value - down, high=value + up)


def saving(cheaper: Interval, dearer: Interval) -> Interval:
    """The share of a cost that another saves, below 0 where it is the dearer one."""
    return difference(exactly(1.0), ratio(cheaper, dearer))


def total(parts: Sequence[Interval]) -> Interval:
    """Their sum, errors taken as independent."""
    value = math.fsum(p.value for p in parts)
    up = math.sqrt(math.fsum((p.high - p.value) ** 2 for p in parts))
    down = math.sqrt(math.fsum((p.value - p.low) ** 2 for p in parts))
    return Interval(value=value, low=value - down, high=value + up)


def largest(parts: Sequence[Interval]) -> Interval:
    """The one with the greatest value. Raises MissingError for none."""
    if not parts:
        raise MissingError("there is nothing to take the largest of")
    return max(parts, key=lambda part: part.value)


def smallest(parts: Sequence[Interval]) -> Interval:
    """The one with the least value. Raises MissingError for none."""
    if not parts:
        raise MissingError("there is nothing to take the smallest of")
    return min(parts, key=lambda part: part.value)


def between(value: Interval, low: float = -math.inf, high: float = math.inf) -> Verdict:
    """Holds with all of the interval within low..high, fails with all of it outside, else unclear."""
    if low <= value.low and value.high <= high:
        return "holds"
    if value.high < low or value.low > high:
        return "fails"
    return "unclear"


def every(verdicts: Sequence[Verdict]) -> Verdict:
    """Holds when all hold; fails when one fails."""
    if not verdicts:
        raise MissingError("there is nothing to judge")
    if "fails" in verdicts:
        return "fails"
    return "unclear" if "unclear" in verdicts else "holds"


def rises(values: Sequence[Interval]) -> Verdict:
    """Whether the last is above the first, and no step surely falls. Raises MissingError for fewer than two."""
    if len(values) < 2:
        raise MissingError("fewer than two points are there to rise")
    steps = [between(ratio(b, a), low=1.0) for a, b in pairwise(values)]
    whole = between(ratio(values[-1], values[0]), low=1.0)
    if whole == "holds" and "fails" not in steps:
        return "holds"
    return "fails" if whole == "fails" or "fails" in steps else "unclear"


def told(value: Interval, unit: str = "") -> str:
    """An interval in words: 3.84 J (3.72 to 3.96), 1.2 (0.3 to no bound)."""
    text = f"{words.figure(value.value)} {unit}".strip()
    high = words.figure(value.high) if bounded(value) else "no bound"
    return text if value.low == value.high else f"{text} ({words.figure(value.low)} to {high})"


def told_share(value: Interval) -> str:
    """A share with its interval, in words: 55 % (31 % to 70 %)."""
    text = words.share(value.value)
    return text if value.low == value.high else f"{text} ({words.share(value.low)} to {words.share(value.high)})"


def finding(value: Interval, verdict: Verdict, said: str, unit: str = "") -> Finding:
    """A finding whose words get the number."""
    return Finding(value, unit, verdict, f"{said}: {told(value, unit)}")


def _log(one: float, other: float) -> float:
    return math.log(one / other) if one > 0 and other > 0 else 0.0
