"""The layers of the trade-off chart, each a pure function of what is shown."""

from dataclasses import dataclass
from typing import Any, Literal

import altair as alt

from joulebox_server.analysis import palette
from joulebox_server.analysis.documents import Tradeoff
from joulebox_server.analysis.frame import (
    MAX_COLOURS,
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
_FRONT_MARKS = {"on the front": "circle", "on the front, not confirmed": "diamond", "off the front": "cross"}


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
    """The acceptable area, its edge, and what it is called."""
    base = data([{"y": shown.limit, "y2": shown.y.low, "text": f"acceptable below {figure(shown.limit)}"}])
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


def budget_layers(shown: Frame, budget: float, name: XName, on: Axes) -> list[Any]:
    """An upright line at the budget, in the unit of the x axis."""
    text = f"budget {figure(budget)} {X_UNITS[name]}"
    base = data([{"x": budget, "y": shown.y.high, "text": text}])
    right = shown.x.fraction(budget) > 0.7
    placed = {"align": "right" if right else "left", "baseline": "top", "dx": -5 if right else 5, "dy": 2}
    rule = base.mark_rule(color=palette.VERMILION, strokeWidth=1.5, strokeDash=[6, 3])
    return [rule.encode(x=on.x()), *_text(base, palette.VERMILION, placed, x=on.x(), y=on.y(), text="text:N")]


def front_layer(shown: Frame, on: Axes) -> Any:
    """The front's line, dashed where the intervals do not confirm it."""
    dash = alt.condition("datum.confirmed", alt.value([1, 0]), alt.value([5, 4]))
    line = data(shown.segments).mark_rule(color=palette.INK, strokeWidth=1.5, opacity=0.55)
    return line.encode(x=on.x(), y=on.y(), x2="x2:Q", y2="y2:Q", strokeDash=dash)


def interval_layers(shown: Frame, on: Axes) -> list[Any]:
    """The confidence intervals of every point, both ways."""
    base = data(shown.points).mark_rule(color=palette.MUTED, strokeWidth=1.2, opacity=0.8)
    return [
        base.encode(x=on.x("x_low"), x2="x_high:Q", y=on.y()),
        base.encode(x=on.x(), y=on.y("y_low"), y2="y_high:Q"),
    ]


def point_layer(shown: Frame, tradeoff: Tradeoff, on: Axes) -> Any:
    """The points: shape by standing, colour by a setting, all settings that vary in the tooltip."""
    present = {row["standing"] for row in shown.points}
    domain = [name for name in _FRONT_MARKS if name in present]
    shape = alt.Shape(
        "standing:N",
        title="Pareto front",
        scale=alt.Scale(domain=domain, range=[_FRONT_MARKS[name] for name in domain]),
        legend=alt.Legend(symbolFillColor=palette.MUTED, symbolStrokeColor="#ffffff", columns=2),
    )
    points = data(shown.points).mark_point(filled=True, size=95, opacity=1, stroke="#ffffff", strokeWidth=0.8)
    colour = _colour(shown, tradeoff)
    return points.encode(x=on.x(), y=on.y(), shape=shape, color=colour, tooltip=_tooltips(tradeoff)).properties(
        name="points"
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
    told += [alt.Tooltip(f"{name}:N", title=name) for name in ("difference", "energy", "time")]
    return [*told, alt.Tooltip("standing:N", title="front"), alt.Tooltip("repeats:Q", title="repeats")]
