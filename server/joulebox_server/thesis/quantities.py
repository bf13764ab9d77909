"""Figures as a table: lines of points along a setting, and a quantity of each point."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from joulebox_server.analysis.intervals import Interval
from joulebox_server.thesis import figures
from joulebox_server.thesis.batch import Spec
from joulebox_server.thesis.results import Point, Results

Series = Mapping[str, Sequence[tuple[Any, Point]]]
"""Lines by their names: (value of what varies, point)."""
Lines = Callable[[Results], Series]


@dataclass(frozen=True)
class Quantity:
    """Something of a point with an interval, and the title of its axis; {unit} is that of costs."""

    title: str
    of: Callable[[Point], Interval | None]
    levels: Mapping[str, float] | None = None


COST = Quantity("cost of an image [{unit}]", lambda point: point.cost)
COST_PER_PIXEL = Quantity("cost a pixel [{unit}]", lambda point: point.cost.scaled(1 / point.pixels))
DIFFERENCE = Quantity("difference to the reference", lambda point: point.difference)
LIMITED = Quantity(DIFFERENCE.title, DIFFERENCE.of, {"acceptable at 256x256": 100.0})
DIFFERENCE_PER_PIXEL = Quantity("difference a pixel", lambda point: point.per_pixel, {"acceptable": 100 / 65_536})


def stage(name: str) -> Quantity:
    """The cost of one stage."""
    return Quantity(f"cost of {figures.STAGE_WORDS[name]} [{{unit}}]", lambda point: point.stage(name))


def over(quantity: Quantity, lines: Lines, x: str, legend: str = "", **look: Any) -> Callable[[Results], Spec | None]:
    """A figure of lines: a quantity over what varies along them."""

    def draw(results: Results) -> Spec | None:
        found = [(name, x_value, point) for name, points in lines(results).items() for x_value, point in points]
        rows = [
            figures.value(x_value, value, name)
            for name, x_value, point in found
            if (value := quantity.of(point)) is not None
        ]
        # of all points: one that has no such quantity keeps its place among the words
        order = list(dict.fromkeys(str(x_value) for _, x_value, _ in found))
        title = quantity.title.format(unit=results.unit)
        return figures.lines(rows, x, title, legend, levels=quantity.levels, order=order, **look)

    return draw


def stacked(lines: Lines, x: str) -> Callable[[Results], Spec | None]:
    """A figure of stacked bars: every stage of every point."""

    def draw(results: Results) -> Spec | None:
        rows = [
            row
            for name, points in lines(results).items()
            for value, point in points
            for row in figures.stage_rows(" ".join(part for part in (name, figures.short(value)) if part), point)
        ]
        return figures.bars(rows, x, f"cost of an image [{results.unit}]")

    return draw


def trade_off(lines: Lines, legend: str = "", *, log: bool = True) -> Callable[[Results], Spec | None]:
    """A figure of points: cost against difference."""

    def draw(results: Results) -> Spec | None:
        rows = figures.known(
            figures.spot(point, name, figures.short(value))
            for name, points in lines(results).items()
            for value, point in points
        )
        title = f"cost of an image [{results.unit}]"
        return figures.points(rows, title, "difference to the reference", legend, log=log)

    return draw
