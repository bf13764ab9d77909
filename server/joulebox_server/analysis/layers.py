"""The layers of the trade-off chart, each a pure function of what is shown."""

from dataclasses import dataclass
from typing import Any, Literal

import altair as alt

from joulebox_server.analysis import palette
from joulebox_server.analysis.documents import Tradeoff
from joulebox_server.analysis.frame import (
    MAX_COLOURS,
    PREDICTED,
    SETTING_PREFIX,
    X_UNITS,
    Frame,
    Range,
    Row,
    XName,
    YName,
    values_of,
    varied,
)
from joulebox_server.analysis.words import figure, quality_suffix

_NUMBER = ",~r"
_FIGURE = ",.3~r"
MANY_POINTS = 400
"""From here on points are drawn small, and intervals only on the front: thousands of bars hide everything."""

POINTS, PREDICTIONS = "points", "predictions"
"""Datasets of a specification."""
LIMIT, BUDGET = "limit", "budget"
"""Parameters of a specification, in the units of its axes: whoever shows it can move them."""

FRAGILE = "fragile: a cliff is one step away"
_MARKS = {
    "on the front": "circle",
    "on the front, not confirmed": "diamond",
    "off the front": "cross",
    PREDICTED: "square",
    FRAGILE: "triangle-down",
}
"""Shapes, so that nothing hangs on colour."""


@dataclass(frozen=True)
class Axes:
    """How both axes are scaled and titled; every layer states the same, so that they merge into one."""

    x_scale: Any
    x_axis: Any
    y_scale: Any
    y_axis: Any

    def x(self, field: str = "x") -> Any:
        """The x channel of a field."""
        return alt.X(f"{field}:Q", scale=self.x_scale, axis=self.x_axis)

    def y(self, field: str = "y") -> Any:
        """The y channel of a field."""
        return alt.Y(f"{field}:Q", scale=self.y_scale, axis=self.y_axis)


def axes(shown: Frame, x: XName, y: YName, tradeoff: Tradeoff) -> Axes:
    """Scales and titles, with units, of the quantities shown."""
    quality = quality_suffix(tradeoff.energy_quality)
    titles: dict[XName, str] = {
        "energy_j": f"energy per image [J]{quality}",
        "time_s": "time per image [s]",
        "energy_j_per_pixel": f"energy per pixel [J]{quality}",
    }
    what = "difference to the reference" if y == "difference" else "difference per pixel"
    x_format = "~s" if x == "energy_j_per_pixel" else _NUMBER
    return Axes(
        x_scale=_scale(shown.x),
        x_axis=alt.Axis(title=titles[x], format=x_format, labelOverlap=True, tickCount=8),
        y_scale=_scale(shown.y),
        y_axis=alt.Axis(
            title=f"{what} ({tradeoff.metric}, no unit)",
            format=_NUMBER if y == "difference" else "~e",
            labelOverlap=True,
            tickCount=7,
        ),
    )


def limit_layers(shown: Frame, on: Axes) -> list[Any]:
    """The acceptable area, its edge, and what it is called; the parameter `limit` moves them."""
    words = f"'acceptable below ' + format({LIMIT}, '{_FIGURE}')"
    base = data([{"y2": shown.y.low}]).transform_calculate(y=LIMIT, text=words)
    return [
        base.mark_rect(color=palette.GREEN, opacity=0.07).encode(y=on.y(), y2="y2:Q"),
        base.mark_rule(color=palette.GREEN, strokeWidth=1.5).encode(y=on.y()),
        *_edge_text(base, palette.GREEN, on),
    ]


def floor_layers(shown: Frame, on: Axes) -> list[Any]:
    """The level below which a difference is the reference's own noise."""
    if shown.floor is None or shown.floor <= 0:
        return []
    base = data([{"y": shown.floor, "text": f"noise floor {figure(shown.floor)}"}])
    rule = base.mark_rule(color=palette.MUTED, strokeWidth=1.5, strokeDash=[2, 3]).encode(y=on.y())
    return [rule, *_edge_text(base, palette.MUTED, on)]


def budget_layers(shown: Frame, name: XName, on: Axes) -> list[Any]:
    """An upright line at the budget, in the unit of the x axis; the parameter `budget` moves it, null hides it."""
    words = f"'budget ' + format({BUDGET}, '{_FIGURE}') + ' {X_UNITS[name]}'"
    base = data([{"y": shown.y.high}]).transform_filter(f"isValid({BUDGET})").transform_calculate(x=BUDGET, text=words)
    right = f"{BUDGET} > {shown.x.at(0.7)!r}"
    placed = {
        "align": alt.ExprRef(f"{right} ? 'right' : 'left'"),
        "dx": alt.ExprRef(f"{right} ? -5 : 5"),
        "baseline": "top",
        "dy": 2,
    }
    rule = base.mark_rule(color=palette.VERMILION, strokeWidth=1.5, strokeDash=[6, 3])
    return [rule.encode(x=on.x()), *_text(base, palette.VERMILION, placed, x=on.x(), y=on.y(), text="text:N")]


def front_layer(shown: Frame, on: Axes) -> Any:
    """The front's line, dashed where the intervals do not confirm it."""
    dash = alt.condition("datum.confirmed", alt.value([1, 0]), alt.value([5, 4]))
    line = data(shown.segments).mark_rule(color=palette.INK, strokeWidth=1.5, opacity=0.55)
    return line.encode(x=on.x(), y=on.y(), x2="x2:Q", y2="y2:Q", strokeDash=dash)


def interval_layers(shown: Frame, on: Axes) -> list[Any]:
    """The confidence intervals of every point that is looked at, both ways; of many points, those on the front."""
    base = named(POINTS).mark_rule(color=palette.MUTED, strokeWidth=1.2)
    if len(shown.points) > MANY_POINTS:
        base = base.transform_filter("datum.on_front")
    base = base.encode(opacity=alt.condition("datum.shown", alt.value(0.8), alt.value(0)))
    return [
        base.encode(x=on.x("x_low"), x2="x_high:Q", y=on.y()),
        base.encode(x=on.x(), y=on.y("y_low"), y2="y_high:Q"),
    ]


def point_layers(shown: Frame, tradeoff: Tradeoff, on: Axes) -> list[Any]:
    """The points: shape by standing, colour by a setting, all settings that vary in the tooltip.

    Beside what was measured: where a cliff is near, a mark above the point; and what is only predicted.
    """
    many = len(shown.points) > MANY_POINTS
    shape, colour = _shape(shown), _colour(shown, tradeoff)
    there = alt.condition("datum.shown", alt.value(1), alt.value(0.12))
    edge = {"stroke": "#ffffff", "strokeWidth": 0.4 if many else 0.8}
    points = (
        named(POINTS)
        .transform_calculate(verdict=f"datum.y <= {LIMIT} ? 'acceptable' : 'beyond the limit'")
        .mark_point(filled=True, size=36 if many else 95, **edge)
        .encode(x=on.x(), y=on.y(), shape=shape, color=colour, opacity=there, tooltip=_tooltips(tradeoff))
        .properties(name="points")
    )
    parts = [points]
    if any(row["fragile"] for row in shown.points):
        mark = (
            named(POINTS)
            .transform_filter("isValid(datum.fragile) && datum.shown")
            .transform_calculate(standing=f"'{FRAGILE}'")
        )
        above = {"filled": True, "color": palette.VERMILION, "size": 22 if many else 40, "yOffset": -7 if many else -11}
        parts.append(mark.mark_point(**above).encode(x=on.x(), y=on.y(), shape=shape, tooltip="fragile:N"))
    if shown.predicted:
        hollow = {"filled": False, "size": 70, "strokeWidth": 1.6}
        told = [tip for tip in _tooltips(tradeoff) if tip.shorthand not in ("repeats:Q", "verdict:N")]
        parts.append(
            named(PREDICTIONS)
            .mark_point(**hollow)
            .encode(x=on.x(), y=on.y(), shape=shape, color=colour, opacity=there, tooltip=told)
            .properties(name="predicted")
        )
    return parts


def _shape(shown: Frame) -> Any:
    present = {row["standing"] for row in (*shown.points, *shown.predicted)}
    if any(row["fragile"] for row in shown.points):
        present.add(FRAGILE)
    domain = [name for name in _MARKS if name in present]
    return alt.Shape(
        "standing:N",
        title="Pareto front",
        scale=alt.Scale(domain=domain, range=[_MARKS[name] for name in domain]),
        legend=alt.Legend(symbolFillColor=palette.MUTED, symbolStrokeColor=palette.MUTED, columns=2),
    )


def reference_layers(reference: Row, shown: Frame, on: Axes) -> list[Any]:
    """The reference, on the floor of the chart: its difference to itself is 0."""
    base = data([reference])
    tooltip = [alt.Tooltip(f"{name}:N", title=name) for name in ("label", "energy", "time")]
    mark = base.mark_point(shape="triangle-up", filled=True, size=130, color=palette.INK, opacity=1, yOffset=-5)
    right = shown.x.fraction(reference["x"]) > 0.7
    placed = {"align": "right" if right else "left", "dx": -9 if right else 9, "dy": -7}
    return [
        mark.encode(x=on.x(), y=on.y(), tooltip=tooltip),
        *_text(base, palette.INK, placed, x=on.x(), y=on.y(), text="label:N"),
    ]


def data(rows: list[Row]) -> Any:
    """A chart of inline rows."""
    return alt.Chart(alt.Data(values=rows))  # type: ignore[no-untyped-call]


def named(name: str) -> Any:
    """A chart of rows that the specification lists once under `datasets`: they may be thousands."""
    return alt.Chart(alt.NamedData(name))


def _scale(span: Range) -> Any:
    kind: Literal["log", "linear"] = "log" if span.log else "linear"
    zero = alt.Undefined if kind == "log" else False  # Vega warns of any on a logarithmic scale
    return alt.Scale(type=kind, domain=[span.low, span.high], nice=False, zero=zero)


def _edge_text(base: Any, colour: str, on: Axes) -> list[Any]:
    """A word above a level line, at the right edge of the chart."""
    placed = {"align": "right", "baseline": "bottom", "dx": -4, "dy": -3}
    return _text(base, colour, placed, x=alt.value("width"), y=on.y(), text="text:N")


def _text(base: Any, colour: str, placed: dict[str, Any], **channels: Any) -> list[Any]:
    """A word with a white edge, which keeps it readable on grid lines and intervals."""
    edge = base.mark_text(fontSize=11, stroke="#ffffff", strokeWidth=4, strokeJoin="round", **placed)
    return [edge.encode(**channels), base.mark_text(fontSize=11, color=colour, **placed).encode(**channels)]


def _colour(shown: Frame, tradeoff: Tradeoff) -> Any:
    """Colour by a setting: dark to light for numbers, colours that stand apart for words."""
    name = shown.colour_by
    if name is None:
        return alt.value(palette.BLUE)
    values = values_of(tradeoff, name)
    field = SETTING_PREFIX + name
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    if numeric and len(values) > MAX_COLOURS:
        return alt.Color(f"{field}:Q", title=name, scale=alt.Scale(scheme="viridis"))
    if numeric:
        scale = alt.Scale(scheme=alt.SchemeParams(name="viridis", extent=[0.05, 0.9]))
        return alt.Color(f"{field}:O", title=name, sort=values, scale=scale, legend=alt.Legend(format=_NUMBER))
    return alt.Color(f"{field}:N", title=name, sort=values, scale=alt.Scale(range=palette.CATEGORIES))


def _tooltips(tradeoff: Tradeoff) -> list[Any]:
    told = [alt.Tooltip(f"{SETTING_PREFIX}{name}:N", title=name) for name in varied(tradeoff)]
    told += [alt.Tooltip(f"{name}:N", title=name) for name in ("difference", "verdict", "energy", "time")]
    return [*told, alt.Tooltip("standing:N", title="front"), alt.Tooltip("repeats:Q", title="repeats")]
