"""Lines through the points of a trade-off: points that differ in one setting alone, in that setting's order."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from joulebox_server.analysis.documents import Axis, Point, Step, Tradeoff

CLIFF_FACTOR = 3.0
"""A step that multiplies the difference by this much, and ends beyond the limit, is a cliff."""
NO_SETTINGS = frozenset({"seed"})
"""Told apart by repeats, not by configurations."""


@dataclass(frozen=True)
class Line:
    """Points with equal settings but one, in the order of its values; words keep the order they came in."""

    setting: str
    points: tuple[Point, ...]

    @property
    def ordered(self) -> bool:
        """Whether the values are numbers, so that only neighbours are a step apart."""
        return all(is_number(point.settings[self.setting]) for point in self.points)

    def steps(self) -> list[tuple[Point, Point]]:
        """Pairs that are one step apart, each once."""
        if self.ordered:
            return list(pairwise(self.points))
        return [(one, other) for k, one in enumerate(self.points) for other in self.points[k + 1 :]]


def is_number(value: object) -> bool:
    """A finite number; true and false are words."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def varied(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of the settings that take more than one value, in order of their first appearance."""
    names = dict.fromkeys(name for given in settings for name in given if name not in NO_SETTINGS)
    return [name for name in names if len({_key(given.get(name)) for given in settings}) > 1]


def lines(points: Sequence[Point]) -> list[Line]:
    """Every line of at least two points."""
    names = varied([point.settings for point in points])
    found: list[Line] = []
    for name in names:
        others = [other for other in names if other != name]
        groups: dict[tuple[Any, ...], list[Point]] = {}
        for point in points:
            if name in point.settings:
                groups.setdefault(tuple(_key(point.settings.get(other)) for other in others), []).append(point)
        found += [_line(name, group) for group in groups.values() if len(group) > 1]
    return found


def steps_from(tradeoff: Tradeoff, point: Point, axis: Axis) -> list[Step]:
    """Every measured step away from a point: one setting changed to its next value."""
    own = [line for line in lines(tradeoff.points) if point in line.points]
    found = []
    for line in own:
        for one, other in line.steps():
            if point in (one, other):
                target = other if point == one else one
                found.append(step(line.setting, point, target, axis, tradeoff.limit))
    return found


def step(name: str, start: Point, end: Point, axis: Axis, limit: float) -> Step:
    """What a change of one setting does."""
    cost, other_cost = start.cost(axis), end.cost(axis)
    cost_ratio = other_cost.value / cost.value if cost and other_cost and cost.value > 0 else None
    before = start.difference.value if start.difference else None
    after = end.difference.value if end.difference else None
    slope = None
    if cost_ratio is not None and before and after and abs(math.log(cost_ratio)) > 1e-6:
        slope = (math.log(after) - math.log(before)) / math.log(cost_ratio)
    return Step(
        setting=name,
        start=start.settings[name],
        end=end.settings[name],
        cost_ratio=cost_ratio,
        difference_start=before,
        difference_end=after,
        slope=slope,
        cliff=is_cliff(before, after, limit),
        same_picture=start.pixel_sha256 is not None and start.pixel_sha256 == end.pixel_sha256,
    )


def is_cliff(before: float | None, after: float | None, limit: float) -> bool:
    """Whether a step falls: three times the difference or more, to beyond the limit."""
    return before is not None and after is not None and after >= CLIFF_FACTOR * before and after > limit


def _line(name: str, group: Sequence[Point]) -> Line:
    if all(is_number(point.settings[name]) for point in group):
        group = sorted(group, key=lambda point: point.settings[name])
    return Line(name, tuple(group))


def _key(value: Any) -> tuple[str, Any]:
    """Tells true from 1, and 1 not from 1.0."""
    return ("word", str(value)) if not is_number(value) else ("number", float(value))
