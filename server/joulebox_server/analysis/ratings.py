"""What each setting costs and what it does to the picture: the thesis' tables 3 and 4, by rule.

Energy impact: elasticity |d ln E / d ln s| at the steepest step; low below 0.15, high above 0.6, medium between.
A change of words, or from or to 0, counts as a doubling of s.
Image sensitivity: low when every point of the axis stays within the limit, high when the first step away from
the reference exceeds three limits, medium between.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from joulebox_server.analysis.documents import Axis, Point, Rating, Tradeoff
from joulebox_server.analysis.lines import Line, is_cliff, is_number, lines, step
from joulebox_server.analysis.words import figure, setting

LOW_ELASTICITY, HIGH_ELASTICITY = 0.15, 0.6
HIGH_SENSITIVITY_LIMITS = 3.0

Level = Literal["low", "medium", "high"]


def rate(points: Sequence[Point], reference: Point | None, axis: Axis, limit: float) -> list[Rating]:
    """One rating a setting that was varied alone, along the line that shows it best.

    That is the line with the most values; of several the one whose best point differs least, because errors of
    other settings do not hide there what this one does.
    """
    best: dict[str, Line] = {}
    for line in lines([p for p in points if p.difference is not None and p.cost(axis) is not None]):
        if line.setting not in best or _clearness(line) > _clearness(best[line.setting]):
            best[line.setting] = line
    base = reference.settings if reference else None
    return [_rating(line, base, axis, limit) for line in best.values()]


def fragility(points: Sequence[Point], limit: float) -> dict[str, str]:
    """Why a point is fragile, by configuration id: a setting one step away falls off a cliff."""
    told: dict[str, str] = {}
    for line in lines([point for point in points if point.difference is not None]):
        for one, other in line.steps():
            for start, end in ((one, other), (other, one)):
                sentence = _falls(line.setting, start, end, limit)
                if sentence is not None:
                    told.setdefault(start.configuration_id, sentence)
    return told


def uncertain(point: Point, limit: float, confidence: float) -> str | None:
    """Why the difference may not stay within the limit although its mean does."""
    difference = point.difference
    if difference is None:
        return None
    if point.repeats < 2 and difference.low == difference.high:
        return (
            f"rendered with one seed only: its difference of {figure(difference.value)} may be larger with "
            "another seed, and nothing is known of by how much"
        )
    if difference.value <= limit < difference.high:
        return (
            f"its difference is {figure(difference.value)} on average over {point.repeats} "
            f"seed{'s' if point.repeats > 1 else ''}, but its {confidence:.0%} interval reaches "
            f"{figure(difference.high)}, beyond the limit {figure(limit)}"
        )
    return None


def why_fragile(tradeoff: Tradeoff, point: Point, limit: float) -> str | None:
    """Everything that makes a point fragile at this limit, in one sentence; None where nothing does."""
    cliff = point.fragile if limit == tradeoff.limit else fragility(tradeoff.points, limit).get(point.configuration_id)
    told = [why for why in (uncertain(point, limit, tradeoff.confidence), cliff) if why is not None]
    return "; ".join(told) or None


def _clearness(line: Line) -> tuple[int, float]:
    return len(line.points), -min(p.difference.value for p in line.points if p.difference)


def _falls(name: str, start: Point, end: Point, limit: float) -> str | None:
    assert start.difference is not None, "only points with a difference are asked for"
    assert end.difference is not None, "only points with a difference are asked for"
    before, after = start.difference.value, end.difference.value
    if not is_cliff(before, after, limit):
        return None
    times = f"multiplies its difference by {figure(after / before)}, to" if before > 0 else "takes its difference to"
    return (
        f"one step away is a cliff: {name} {setting(end.settings[name])} instead of {setting(start.settings[name])} "
        f"{times} {figure(after)}, beyond the limit {figure(limit)}"
    )


def _rating(line: Line, base: Mapping[str, Any] | None, axis: Axis, limit: float) -> Rating:
    elasticity = max(_elasticity(line.setting, one, other, axis) for one, other in line.steps())
    steps = [step(line.setting, one, other, axis, limit) for one, other in line.steps()]
    cliffs = [
        step(line.setting, start, end, axis, limit)
        for one, other in line.steps()
        for start, end in ((one, other), (other, one))
        if is_cliff(_difference(start), _difference(end), limit)
    ]
    return Rating(
        setting=line.setting,
        energy_impact=_level(elasticity, LOW_ELASTICITY, HIGH_ELASTICITY),
        elasticity=elasticity,
        image_sensitivity=_sensitivity(line, base, limit),
        steps=steps,
        cliffs=cliffs,
    )


def _elasticity(name: str, one: Point, other: Point, axis: Axis) -> float:
    costs = [point.cost(axis) for point in (one, other)]
    low, high = (cost.value if cost else 0.0 for cost in costs)
    if low <= 0 or high <= 0:
        return 0.0
    values = [point.settings[name] for point in (one, other)]
    ratio = values[1] / values[0] if all(is_number(v) and v > 0 for v in values) else 2.0
    return abs(math.log(high / low) / math.log(ratio))


def _sensitivity(line: Line, base: Mapping[str, Any] | None, limit: float) -> Level:
    if all(_difference(point) <= limit for point in line.points):
        return "low"
    return "high" if max(map(_difference, _first_step(line, base))) > HIGH_SENSITIVITY_LIMITS * limit else "medium"


def _first_step(line: Line, base: Mapping[str, Any] | None) -> list[Point]:
    """The points one step away from the reference's value; without a reference, from the best point."""
    wanted = base.get(line.setting) if base else None
    there = [place for place, point in enumerate(line.points) if point.settings[line.setting] == wanted]
    if not there and is_number(wanted) and line.ordered:
        # the reference lies beside the axis: the nearest of its points is the first step
        return [min(line.points, key=lambda point: abs(point.settings[line.setting] - wanted))]
    place = there[0] if there else min(range(len(line.points)), key=lambda k: _difference(line.points[k]))
    if not line.ordered:
        return [point for k, point in enumerate(line.points) if k != place]
    return [line.points[k] for k in (place - 1, place + 1) if 0 <= k < len(line.points)]


def _difference(point: Point) -> float:
    return point.difference.value if point.difference else math.inf


def _level(value: float, low: float, high: float) -> Level:
    return "low" if value < low else "high" if value > high else "medium"
