"""The charts, as pure functions from a trade-off to a Vega-Lite specification, and its rendering.

One specification serves the dashboard, the pictures of a report and a page of its own. All data are
inline; nothing is fetched.
"""

import math
from collections.abc import Sequence
from typing import Any

import altair as alt

from joulebox_server.analysis import layers, palette
from joulebox_server.analysis.candidates import Candidate
from joulebox_server.analysis.documents import UNITS, Axis, Point, Tradeoff
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.frame import Row, View, frame, values_of, varied
from joulebox_server.analysis.trace import Trace, trace_layers
from joulebox_server.analysis.words import figure, quality_suffix, setting

Spec = dict[str, Any]

HEIGHT = 380
TRACE_HEIGHT = 180
MOST_BARS = 24
BAR_STEP = 24
UNBOOKED = "other"
"""Time of an image that no stage accounts for."""
_UNBOOKED_FROM_SHARE = 0.005
_TOLD_OF_REFERENCE = {"configuration_id", "label", "energy_j", "time_s", "image_sha256", "settings", "quality"}


def tradeoff_chart(tradeoff: Tradeoff, view: View = View(), predictions: Sequence[Candidate] = ()) -> Spec:
    """Cost against difference: points with intervals, the front, the limit, the floor, the reference.

    predictions     settings that were never measured, drawn where they are expected

    The parameters `limit` and `budget` of the specification are in the units of its axes and may be moved by
    whoever shows it. Its `usermeta` says what the trade-off is, so that a page needs nothing else to draw itself.
    Raises AnalysisError as `frame` does.
    """
    shown = frame(tradeoff, view, predictions)
    if not shown.points:
        return _nothing_yet(tradeoff, "no configuration has been both measured and compared") | _about(tradeoff)
    on = layers.axes(shown, view.x, view.y, tradeoff)
    parts = [
        *layers.limit_layers(shown, on),
        *layers.floor_layers(shown, on),
        *layers.budget_layers(shown, view.x, on),
        layers.front_layer(shown, on),
        *layers.interval_layers(shown, on),
        *layers.point_layers(shown, tradeoff, on),
        *(layers.reference_layers(shown.reference, shown, on) if shown.reference else []),
    ]
    moved = (alt.param(name=layers.LIMIT, value=shown.limit), alt.param(name=layers.BUDGET, value=view.budget))
    chart = alt.layer(*parts).add_params(*moved).properties(height=HEIGHT)
    spec = _finish(chart, tradeoff, _repeats_told(tradeoff)) | _about(tradeoff)
    return spec | {"datasets": {layers.POINTS: shown.points, layers.PREDICTIONS: shown.predicted}}


def stages_chart(tradeoff: Tradeoff, unit: Axis | None = None, chosen: str | None = None) -> Spec:
    """What every stage costs per image: one stacked bar a configuration, cheapest first, reference last.

    unit    "energy_j" or "time_s"; None takes energy where every bar's stages have one, else time
    chosen  a configuration that is shown in any case

    Of more than MOST_BARS configurations those on the front are shown, spread over it where they too are many.
    What no stage accounts for is shown as "other". Raises AnalysisError for energy where a configuration's
    stages have none.
    """
    points = _worth_a_bar([point for point in tradeoff.points if point.stages], tradeoff, chosen)
    bars = [*points, *([tradeoff.reference] if tradeoff.reference and tradeoff.reference.stages else [])]
    if not bars:
        return _nothing_yet(tradeoff, "no stage has been measured")
    priced = all(s.energy_j is not None for point in bars for s in point.stages.values())
    axis: Axis = unit or ("energy_j" if priced and all(p.energy_j for p in bars) else "time_s")
    if axis == "energy_j" and not priced:
        raise AnalysisError(f"not every stage of {tradeoff.scene} has an energy, the chart must be over time_s")
    names, labels = _bar_labels(tradeoff, bars)
    rows = [row for label, point in zip(labels, bars, strict=True) for row in _stage_rows(label, point, axis)]
    left_out = len(tradeoff.points) - len(points)
    some = f"; {len(points)} of {len(tradeoff.points)}, those on the front" if left_out else ""
    return _finish(_stage_bars(rows, axis, tradeoff), tradeoff, f"cost per image by stage{names}{some}")


def trace_chart(tradeoff: Tradeoff, label: str, trace: Trace) -> Spec:
    """Power against time while one configuration was measured. Raises AnalysisError without any power."""
    chart = trace_layers(trace).properties(height=TRACE_HEIGHT)
    told = f"power{quality_suffix(tradeoff.energy_quality)}; shaded: the windows that count"
    return _finish(chart, tradeoff, [label, told])


def _worth_a_bar(points: Sequence[Point], tradeoff: Tradeoff, chosen: str | None) -> Sequence[Point]:
    if len(points) <= MOST_BARS:
        return points
    axis = tradeoff.main_axis
    front = [p for p in points if (p.on_front.energy_j if axis == "energy_j" else p.on_front.time_s)]
    kept = {p.configuration_id for p in front[:: -(-len(front) // MOST_BARS) or 1]} | {chosen}
    return [p for p in points if p.configuration_id in kept]


def finish(chart: Any, title: str, subtitle: str | list[str]) -> Spec:
    """The specification, with title, width and the shared configuration."""
    chart = chart.properties(
        width="container",
        title=alt.TitleParams(title, subtitle=subtitle),
        autosize=alt.AutoSizeParams(type="fit-x", contains="padding"),
    )
    spec: Spec = chart.to_dict()
    spec["config"] = palette.config()
    return spec


def _finish(chart: Any, tradeoff: Tradeoff, subtitle: str | list[str]) -> Spec:
    return finish(chart, f"{tradeoff.scene} on {tradeoff.device}", subtitle)


def _about(tradeoff: Tradeoff) -> Spec:
    """What Vega ignores and a page reads: the trade-off without its points, and the values its settings take."""
    head = tradeoff.model_dump(mode="json", exclude={"points", "reference", "ratings", "shared"})
    reference = tradeoff.reference
    head["reference"] = reference and reference.model_dump(mode="json", include=_TOLD_OF_REFERENCE)
    head["settings"] = {name: [setting(v) for v in values_of(tradeoff, name)] for name in varied(tradeoff)}
    head["point_count"] = len(tradeoff.points)
    return {"usermeta": head}


def _nothing_yet(tradeoff: Tradeoff, why: str) -> Spec:
    text = layers.data([{"text": "nothing to show yet"}]).mark_text(fontSize=14, color=palette.MUTED)
    return _finish(text.encode(text="text:N").properties(height=HEIGHT), tradeoff, why)


def _repeats_told(tradeoff: Tradeoff) -> str:
    counts = sorted({point.repeats for point in tradeoff.points})
    repeats = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    noun = "repeat" if counts == [1] else "repeats"
    size = f"{tradeoff.width} x {tradeoff.height} pixels"
    which = " on the front" if len(tradeoff.points) > layers.MANY_POINTS else ""
    return f"{repeats} {noun} a point, {tradeoff.confidence:.0%} intervals{which}, {size}"


def _bar_labels(tradeoff: Tradeoff, bars: Sequence[Point]) -> tuple[str, list[str]]:
    """What the labels list, as an addition to the subtitle, and a label of its own for every bar.

    The values of the sweep's axes alone where they tell the bars apart: names would leave no room for bars.
    """
    axes = tradeoff.axes
    short = [
        point.label if point is tradeoff.reference else ", ".join(setting(point.settings.get(a)) for a in axes)
        for point in bars
    ]
    if axes and len(set(short)) == len(bars):
        return f"; rows: {', '.join(axes)}", short
    full = [point.label for point in bars]
    if len(set(full)) == len(bars):
        return "", full
    return "", [f"{point.label} ({point.configuration_id})" for point in bars]


def _stage_rows(label: str, point: Point, axis: Axis) -> list[Row]:
    """One row a stage, and one for what is left of the image's cost."""
    costs = {name: stage.time_s if axis == "time_s" else stage.energy_j for name, stage in point.stages.items()}
    whole = point.cost(axis)
    left = whole.value - math.fsum(cost or 0.0 for cost in costs.values()) if whole else 0.0
    if whole and left > _UNBOOKED_FROM_SHARE * whole.value:
        costs[UNBOOKED] = left
    unit = UNITS[axis]
    return [
        {
            "bar": label,
            "configuration": point.label,
            "stage": name,
            "order": _stage_order(name),
            "cost": cost or 0.0,
            "told": f"{figure(cost or 0.0)} {unit}",
            "image": f"{figure(whole.value)} {unit}" if whole else "not known",
        }
        for name, cost in costs.items()
    ]


def _stage_order(name: str) -> int:
    known: Sequence[str] = [*palette.STAGES, UNBOOKED]
    return known.index(name) if name in known else len(known)


def _stage_bars(rows: list[Row], axis: Axis, tradeoff: Tradeoff) -> Any:
    present = sorted({row["stage"] for row in rows}, key=lambda name: (_stage_order(name), name))
    colours = palette.STAGES | {UNBOOKED: palette.MUTED}
    spare = [colour for colour in palette.CATEGORIES if colour not in colours.values()]
    unknown = [name for name in present if name not in colours]
    colours |= {name: spare[place % len(spare)] for place, name in enumerate(unknown)}
    title = "time per image [s]"
    if axis == "energy_j":
        title = f"energy per image [J]{quality_suffix(tradeoff.energy_quality)}"
    labels = alt.Axis(title=None, labelLimit=260, ticks=False, domain=False, grid=False, labelPadding=8)
    legend = alt.Legend(columns=2)  # three columns of stage names are wider than a phone
    colour_scale = alt.Scale(domain=present, range=[colours[name] for name in present])
    return (
        layers.data(rows)
        .mark_bar(height={"band": 0.72})
        .encode(
            x=alt.X("cost:Q", stack="zero", axis=alt.Axis(title=title, format=",~r", tickCount=8)),
            y=alt.Y("bar:N", sort=None, axis=labels),
            color=alt.Color("stage:N", title="stage", scale=colour_scale, legend=legend),
            order=alt.Order("order:Q"),
            tooltip=[
                alt.Tooltip("configuration:N"),
                alt.Tooltip("stage:N"),
                alt.Tooltip("told:N", title="cost"),
                alt.Tooltip("image:N", title="whole image"),
            ],
        )
        .properties(height=BAR_STEP * len({row["bar"] for row in rows}))  # a Step does not go with "fit-x"
    )
