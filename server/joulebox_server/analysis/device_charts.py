"""Several devices in one chart: the same scene, each device's cost against the difference."""

from collections.abc import Sequence

import altair as alt

from joulebox_server.analysis import layers, palette
from joulebox_server.analysis.charts import HEIGHT, Spec, finish
from joulebox_server.analysis.documents import Axis, Tradeoff
from joulebox_server.analysis.frame import Row, spread
from joulebox_server.analysis.words import figure

_TITLES: dict[Axis, str] = {"energy_j": "energy per image [J]", "time_s": "time per image [s]"}


def shared_axis(tradeoffs: Sequence[Tradeoff]) -> Axis:
    """Energy where every one of them knows it, else time: joules and seconds do not go on one axis."""
    return "energy_j" if all(tradeoff.main_axis == "energy_j" for tradeoff in tradeoffs) else "time_s"


def devices_chart(tradeoffs: Sequence[Tradeoff], axis: Axis | None = None) -> Spec:
    """Cost against difference of one scene, a colour a device: points with intervals, each front joined, the limit.

    axis    of the cost; None takes `shared_axis`

    The legend names what each device's joules rest on.
    """
    on = axis or shared_axis(tradeoffs)
    rows = [row for tradeoff in tradeoffs for row in _rows(tradeoff, on)]
    domain = [_named(tradeoff, on) for tradeoff in tradeoffs]
    colour = alt.Color("device:N", title="device", scale=alt.Scale(domain=domain, range=palette.CATEGORIES))
    shape = alt.Shape("device:N", title="device", scale=alt.Scale(domain=domain))
    limits: list[Row] = [
        {"y": limit, "text": f"acceptable below {figure(limit)}"} for limit in {t.limit for t in tradeoffs}
    ]
    x, y = _scales(rows, [row["y"] for row in limits])
    points = layers.data(rows)
    limit_line = layers.data(limits)
    bars = points.mark_rule(strokeWidth=1.2, opacity=0.6)
    front = layers.data([row for row in rows if row["on_front"]]).mark_line(strokeWidth=1.5, opacity=0.6)
    placed = {"align": "right", "baseline": "bottom", "dx": -4, "dy": -3}
    x_axis = alt.Axis(title=_TITLES[on], format=",~r", labelOverlap=True)
    y_axis = alt.Axis(title="difference to the reference (no unit)", format=",~r", labelOverlap=True)
    told = [alt.Tooltip(f"{name}:N") for name in ("device", "settings", "cost", "difference")]
    chart = alt.layer(
        limit_line.mark_rule(color=palette.GREEN, strokeWidth=1.5).encode(y=alt.Y("y:Q", scale=y, axis=y_axis)),
        limit_line.mark_text(fontSize=11, color=palette.GREEN, **placed).encode(
            x=alt.value("width"), y=alt.Y("y:Q", scale=y, axis=y_axis), text="text:N"
        ),
        bars.encode(x=alt.X("x_low:Q", scale=x, axis=x_axis), x2="x_high:Q", y=alt.Y("y:Q", scale=y), color=colour),
        bars.encode(x=alt.X("x:Q", scale=x), y=alt.Y("y_low:Q", scale=y), y2="y_high:Q", color=colour),
        front.encode(x=alt.X("x:Q", scale=x), y=alt.Y("y:Q", scale=y), color=colour, order="x:Q"),
        points.mark_point(filled=True, size=80, opacity=1).encode(
            x=alt.X("x:Q", scale=x), y=alt.Y("y:Q", scale=y), color=colour, shape=shape, tooltip=told
        ),
    )
    first = tradeoffs[0]
    subtitle = f"{first.confidence:.0%} intervals, {first.width} x {first.height} pixels"
    return finish(chart.properties(height=HEIGHT), f"{first.scene} on {len(tradeoffs)} devices", subtitle)


def _rows(tradeoff: Tradeoff, axis: Axis) -> list[Row]:
    rows = []
    for point in tradeoff.points:
        cost, difference = point.cost(axis), point.difference
        if cost is None or difference is None:
            continue
        rows.append(
            {
                "device": _named(tradeoff, axis),
                "settings": point.label,
                "cost": spread(cost, "J" if axis == "energy_j" else "s"),
                "difference": spread(difference, ""),
                "on_front": point.on_front.energy_j if axis == "energy_j" else point.on_front.time_s,
                "x": cost.value,
                "x_low": cost.low,
                "x_high": cost.high,
                "y": difference.value,
                "y_low": difference.low,
                "y_high": difference.high,
            }
        )
    return rows


def _named(tradeoff: Tradeoff, axis: Axis) -> str:
    known = axis == "energy_j" and tradeoff.energy_quality != "measured"
    return f"{tradeoff.device}, {tradeoff.energy_quality}" if known else tradeoff.device


def _scales(rows: Sequence[Row], limits: Sequence[float]) -> tuple[alt.Scale, alt.Scale]:
    """Logarithmic where all values are above 0: devices differ by factors."""
    return _scale([row["x"] for row in rows], rows, "x"), _scale([*(row["y"] for row in rows), *limits], rows, "y")


def _scale(values: Sequence[float], rows: Sequence[Row], name: str) -> alt.Scale:
    low, high = min(values), max(values)
    if low <= 0:
        return alt.Scale(type="linear", domain=[0, 1.06 * max(high, 1e-9)], nice=False, clamp=True)
    top = min(max([high, *(row[f"{name}_high"] for row in rows)]), 1.5 * high)
    return alt.Scale(type="log", domain=[0.8 * low, 1.15 * top], nice=False, clamp=True)
