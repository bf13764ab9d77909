"""The few kinds of chart that the study's figures are made of: lines, stacked bars, points. Pure functions of rows."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import altair as alt

from joulebox_server.analysis import palette
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.layers import data
from joulebox_server.thesis.batch import Spec
from joulebox_server.thesis.results import Point

Row = dict[str, Any]
HEIGHT = 320
STAGE_WORDS = {
    "photon_map": "map creation",
    "direct": "direct",
    "indirect": "indirect",
    "caustics": "caustics",
}
STAGE_COLOURS = {words: palette.STAGES[name] for name, words in STAGE_WORDS.items()}


def value(x: Any, y: Interval, series: str = "", **more: Any) -> Row:
    """A row of `lines`: where, how much with its interval, of which line."""
    return {"x": x, "y": y.value, "low": y.low, "high": y.high, "series": series, **more}


def stage_rows(bar: Any, point: Point) -> list[Row]:
    """Rows of `bars`: the stages of one point."""
    return [
        {"bar": bar, "stage": words, "order": place, "cost": point.stage(name).value}
        for place, (name, words) in enumerate(STAGE_WORDS.items())
    ]


def lines(
    rows: Sequence[Row],
    x: str,
    y: str,
    series: str = "",
    *,
    log_x: bool = False,
    log_y: bool = False,
    levels: Mapping[str, float] | None = None,
    from_zero: bool = True,
    order: Sequence[str] | None = None,
) -> Spec | None:
    """Lines through points with their intervals, one a series, and horizontal levels with their words.

    x, y, series   titles with units; None without rows
    order          of places that are words, where it is not that of the rows
    """
    if not rows:
        return None
    if log_y:
        rows = [row for row in rows if row["y"] > 0]
        least = min((row["y"] for row in rows), default=1.0)
        rows = [row | {"low": max(row["low"], least / 10)} for row in rows]
    words = any(isinstance(row["x"], str) for row in rows)
    x_kind, x_scale = ("N", alt.Undefined) if words else ("Q", _scale(log_x))
    x_axis = alt.Axis(title=x, labelAngle=0, format=alt.Undefined if words else ",~r")
    x_channel = alt.X(f"x:{x_kind}", scale=x_scale, axis=x_axis, sort=order if words else alt.Undefined)
    y_axis = alt.Axis(title=y, format=",~r" if not _tiny(rows) else "~e")
    present = list(dict.fromkeys(row["series"] for row in rows))
    colour: Any = alt.value(palette.BLUE)
    if len(present) > 1:
        scale = alt.Scale(domain=present, range=[palette.CATEGORIES[k % 8] for k in range(len(present))])
        colour = alt.Color("series:N", title=series or None, scale=scale, sort=present)
    y_scale = _scale(log_y) if from_zero else alt.Scale(zero=False)
    base = data(list(rows))
    told = [alt.Tooltip("series:N"), alt.Tooltip(f"x:{x_kind}", title=x), alt.Tooltip("y:Q", title=y, format=",.4~r")]
    parts = [
        base.mark_rule(strokeWidth=1.4, opacity=0.7).encode(
            x=x_channel, y=alt.Y("low:Q", scale=y_scale, axis=y_axis), y2="high:Q", color=colour
        ),
        base.mark_line(strokeWidth=1.8).encode(x=x_channel, y=alt.Y("y:Q", scale=y_scale, axis=y_axis), color=colour),
        base.mark_point(filled=True, size=60, opacity=1).encode(
            x=x_channel, y=alt.Y("y:Q", scale=y_scale, axis=y_axis), color=colour, tooltip=told
        ),
    ]
    for name, level in (levels or {}).items():
        if not (log_y and level <= 0):
            parts += _level(name, level, y_scale, y_axis)
    return finished(alt.layer(*parts).properties(height=HEIGHT))


def bars(rows: Sequence[Row], x: str, y: str) -> Spec | None:
    """Stacked bars of stages, in the order of the rows."""
    if not rows:
        return None
    present = [name for name in STAGE_COLOURS if any(row["stage"] == name and row["cost"] > 0 for row in rows)]
    order = list(dict.fromkeys(str(row["bar"]) for row in rows))
    shown = [row | {"bar": str(row["bar"])} for row in rows if row["stage"] in present]
    colours = alt.Scale(domain=present, range=[STAGE_COLOURS[name] for name in present])
    chart = (
        data(shown)
        .mark_bar(height={"band": 0.72})
        .encode(
            x=alt.X("cost:Q", stack="zero", axis=alt.Axis(title=y, format=",~r")),
            y=alt.Y("bar:N", sort=order, axis=alt.Axis(title=x, ticks=False, domain=False, labelLimit=260)),
            color=alt.Color("stage:N", title="stage", scale=colours, sort=present),
            order=alt.Order("order:Q"),
            tooltip=[alt.Tooltip("bar:N"), alt.Tooltip("stage:N"), alt.Tooltip("cost:Q", title=y, format=",.4~r")],
        )
        .properties(height=26 * len(order))
    )
    return finished(chart)


def points(rows: Sequence[Row], x: str, y: str, series: str = "", *, log: bool = False) -> Spec | None:
    """A scatter of cost against difference with intervals both ways.

    rows   x, x_low, x_high, y, low, high, series, label
    """
    shown = [row for row in rows if not log or (row["x"] > 0 and row["y"] > 0)]
    if not shown:
        return None
    if log:
        # an interval that reaches 0 has no place on a logarithmic axis
        least_x, least_y = (min(row[axis] for row in shown) for axis in ("x", "y"))
        shown = [row | {"low": max(row["low"], least_y / 10), "x_low": max(row["x_low"], least_x / 2)} for row in shown]
    present = list(dict.fromkeys(row["series"] for row in shown))
    scale = alt.Scale(domain=present, range=[palette.CATEGORIES[k % 8] for k in range(len(present))])
    colour: Any = alt.Color("series:N", title=series or None, scale=scale, sort=present)
    base, on = data(shown), alt.Scale(type="log", nice=False, padding=18) if log else alt.Scale(zero=True)
    y_point = alt.Y("y:Q", scale=on, axis=alt.Axis(title=y, format=",~r"))
    x_axis, y_axis = alt.Axis(title=x, format=",~r"), alt.Axis(title=y, format=",~r")
    told = [alt.Tooltip(f"{name}:N") for name in ("series", "label")]
    told += [alt.Tooltip("x:Q", title=x, format=",.4~r"), alt.Tooltip("y:Q", title=y, format=",.4~r")]
    chart = alt.layer(
        base.mark_rule(opacity=0.6).encode(
            x=alt.X("x_low:Q", scale=on, axis=x_axis),
            x2="x_high:Q",
            y=alt.Y("y:Q", scale=on, axis=y_axis),
            color=colour,
        ),
        base.mark_rule(opacity=0.6).encode(
            x=alt.X("x:Q", scale=on, axis=x_axis), y=alt.Y("low:Q", scale=on, axis=y_axis), y2="high:Q", color=colour
        ),
        base.mark_point(filled=True, size=80, opacity=1).encode(
            x=alt.X("x:Q", scale=on, axis=x_axis), y=y_point, color=colour, tooltip=told
        ),
    )
    return finished(chart.properties(height=HEIGHT))


def spot(point: Point, series: str, label: str) -> Row | None:
    """A row of `points`: cost against difference of a point; None for one without a difference."""
    cost, difference = point.cost, point.difference
    if difference is None:
        return None
    return {"x": cost.value, "x_low": cost.low, "x_high": cost.high,
            **value(cost.value, difference, series), "label": label}  # fmt: skip


def known(rows: Iterable[Row | None]) -> list[Row]:
    """Those that are there."""
    return [row for row in rows if row is not None]


def finished(chart: Any) -> Spec:
    """The specification with the width and look that all charts share."""
    sized = chart.properties(width="container", autosize=alt.AutoSizeParams(type="fit-x", contains="padding"))
    spec: Spec = sized.to_dict()
    spec["config"] = palette.config()
    return spec


def _level(name: str, level: float, scale: Any, axis: Any) -> list[Any]:
    base = data([{"y": level, "text": name}])
    on = alt.Y("y:Q", scale=scale, axis=axis)
    rule = base.mark_rule(color=palette.GREEN, strokeDash=[5, 3], strokeWidth=1.4).encode(y=on)
    text = base.mark_text(align="right", baseline="bottom", dx=-4, dy=-3, color=palette.GREEN, fontSize=11)
    return [rule, text.encode(x=alt.value("width"), y=on, text="text:N")]


def _scale(log: bool) -> Any:
    return alt.Scale(type="log", nice=False, padding=14) if log else alt.Scale(zero=True)


def _tiny(rows: Sequence[Row]) -> bool:
    return bool(rows) and max(abs(row["y"]) for row in rows) < 0.01


def short(given: Any) -> str:
    """A value of a setting for a label: 50,000, 0.02, a word as it is."""
    return f"{given:,g}" if isinstance(given, int | float) and not isinstance(given, bool) else str(given)
