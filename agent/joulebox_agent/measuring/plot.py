"""Power over time with what was going on: windows, idle, voids, and the stages of single images (thesis, figure 22)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import altair as alt
import vl_convert

from joulebox_agent.errors import UsageError
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.sampling.sampler import Sample

WIDTH, HEIGHT, ZOOM_HEIGHT = 860, 260, 200
MOST_POINTS = 4000  # of a line of 860 pixels
ZOOMED_STAGES = 40  # bands that can still be told apart
KINDS = {"window": "#dbe9f6", "idle": "#e8e8e8", "void": "#f6c9c3"}


def power_chart(records: Sequence[Recording], labels: Sequence[str] = ()) -> alt.VConcatChart:
    """One chart of a session: all of it above, a few images with their stages as bands below.

    records  of one session: their samples are the same. Times are seconds since sampling began. Power of a
    source that only counts is the mean between two movements of its counter. Raises ValueError without records.
    """
    if not records:
        raise ValueError("a chart needs at least one recording")
    zero_s = records[0].start_s
    points = _points(records[0].samples, zero_s)
    title = _title(records)
    whole = alt.layer(
        _spans(_stretches(records, labels, zero_s)),
        _line(points, None),
    ).properties(width=WIDTH, height=HEIGHT, title=title)
    bands = _bands(records[0], zero_s)
    charts: list[Any] = [whole]
    if bands:
        first_s, last_s = bands[0]["start_s"], bands[-1]["end_s"]
        margin_s = (last_s - first_s) / 20
        shown = [first_s - margin_s, last_s + margin_s]
        charts.append(
            alt.layer(_stages(bands, shown), _line(_around(points, *shown), shown)).properties(
                width=WIDTH, height=ZOOM_HEIGHT, title="the first images of a window, by stage"
            )
        )
    chart: alt.VConcatChart = alt.vconcat(*charts).resolve_scale(color="independent").configure_view(stroke="#cccccc")
    return chart


def save_chart(chart: alt.VConcatChart, path: Path) -> None:
    """Writes PNG or SVG by the file's ending. Raises OSError."""
    spec = chart.to_dict()
    if plot_format(path) == "png":
        path.write_bytes(vl_convert.vegalite_to_png(spec, scale=1.5))
    else:
        path.write_text(vl_convert.vegalite_to_svg(spec), encoding="utf-8")


def plot_format(path: Path) -> Literal["png", "svg"]:
    """`png` or `svg`. Raises UsageError for another ending."""
    match path.suffix.lower():
        case ".png":
            return "png"
        case ".svg":
            return "svg"
    raise UsageError(f"The plot {path} must end in .png or .svg.")


def _title(records: Sequence[Recording]) -> Any:
    source, ready = records[0].source, records[0].ready
    what = ready.scene if ready else "nothing rendered"
    label = " (REPLAYED)" if source.quality == "replayed" else ""
    voids = sum(len(record.voided) for record in records)
    windows = sum(len(record.windows) for record in records)
    said = f"{windows} windows" + (f", {voids} void" if voids else "")
    return alt.TitleParams(
        f"{what}: power by {source.method}{label}", subtitle=f"{source.scope}, {said}", anchor="start"
    )


def _points(samples: Sequence[Sample], zero_s: float) -> list[dict[str, float | None]]:
    """Power at every update; None where a reading failed, so that the line breaks there."""
    points: list[dict[str, float | None]] = []
    counted: tuple[float, float, int] | None = None
    for sample in samples:
        reading, time_s = sample.reading, sample.time_s - zero_s
        if reading.problem is not None or reading.refusal is not None:
            points.append({"time_s": time_s, "power_w": None})
            counted = None
        elif reading.power_w is not None:
            points.append({"time_s": time_s, "power_w": reading.power_w})
        elif reading.counter_j is not None:
            if counted is not None and counted[2] == reading.epoch and reading.counter_j > counted[1]:
                power_w = (reading.counter_j - counted[1]) / (time_s - counted[0])
                points.append({"time_s": time_s, "power_w": power_w})
            if counted is None or counted[2] != reading.epoch or reading.counter_j != counted[1]:
                counted = (time_s, reading.counter_j, reading.epoch)
    return _thinned(points)


def _thinned(points: list[dict[str, float | None]]) -> list[dict[str, float | None]]:
    """At most MOST_POINTS of them: the lowest and the highest of every group, in order."""
    if len(points) <= MOST_POINTS:
        return points
    size = -(-2 * len(points) // MOST_POINTS)
    kept = []
    for first in range(0, len(points), size):
        group = points[first : first + size]
        known = [p for p in group if p["power_w"] is not None]
        ends = [min(known, key=_watts), max(known, key=_watts)] if known else []
        gaps = [p for p in group if p["power_w"] is None][:1]
        kept += sorted([*ends, *gaps], key=lambda p: p["time_s"] or 0.0)
    return kept


def _watts(point: dict[str, float | None]) -> float:
    return point["power_w"] or 0.0


def _around(points: list[dict[str, float | None]], start_s: float, end_s: float) -> list[dict[str, float | None]]:
    """The points of a stretch and one on either side of it."""
    inside = [i for i, p in enumerate(points) if start_s <= (p["time_s"] or 0.0) <= end_s]
    if not inside:
        before = [i for i, p in enumerate(points) if (p["time_s"] or 0.0) < start_s][-1:]
        inside = before or [0]
    return points[max(0, inside[0] - 1) : inside[-1] + 2]


def _stretches(records: Sequence[Recording], labels: Sequence[str], zero_s: float) -> list[dict[str, object]]:
    found: list[dict[str, object]] = []

    def add(kind: str, start_s: float, end_s: float, text: str) -> None:
        found.append({"kind": kind, "start_s": start_s - zero_s, "end_s": end_s - zero_s, "text": text})

    for index, record in enumerate(records):
        name = labels[index] if index < len(labels) else ""
        for window in record.windows:
            add("window", window.start_s, window.end_s, f"{name}: {window.images} images".removeprefix(": "))
        for voided in record.voided:
            add("void", voided.start_s, voided.end_s, voided.reason)
    for start_s, end_s in records[0].idle:
        add("idle", start_s, end_s, "nothing rendered")
    return found


def _bands(record: Recording, zero_s: float) -> list[dict[str, Any]]:
    """The first stage intervals of the first window, in the order they ran."""
    if not record.windows:
        return []
    bands: list[dict[str, Any]] = [
        {"stage": name, "start_s": start_s - zero_s, "end_s": end_s - zero_s}
        for name, totals in record.windows[0].stages.items()
        for start_s, end_s in totals.intervals
    ]
    return sorted(bands, key=lambda band: float(band["start_s"]))[:ZOOMED_STAGES]


def _line(points: list[dict[str, float | None]], shown: list[float] | None) -> Any:
    scale = alt.Scale(domain=shown, nice=False) if shown else alt.Scale(nice=False)
    return (
        alt.Chart(alt.InlineData(values=points))
        .mark_line(interpolate="step-after", color="#1f4e79", strokeWidth=1.3, clip=True)
        .encode(
            x=alt.X("time_s:Q", title="time [s]", scale=scale),
            y=alt.Y("power_w:Q", title="power [W]", scale=alt.Scale(zero=False, nice=True)),
        )
    )


def _spans(stretches: list[dict[str, object]]) -> Any:
    return (
        alt.Chart(alt.InlineData(values=stretches))
        .mark_rect(stroke="#ffffff", strokeWidth=1)
        .encode(
            x=alt.X("start_s:Q", title="time [s]"),
            x2="end_s:Q",
            color=alt.Color(
                "kind:N", title=None, scale=alt.Scale(domain=list(KINDS), range=list(KINDS.values())),
                legend=alt.Legend(orient="right"),
            ),
            tooltip=["text:N"],
        )
    )  # fmt: skip


def _stages(bands: list[dict[str, Any]], shown: list[float]) -> Any:
    return (
        alt.Chart(alt.InlineData(values=bands))
        .mark_rect(opacity=0.35, clip=True)
        .encode(
            x=alt.X("start_s:Q", title="time [s]", scale=alt.Scale(domain=shown, nice=False)),
            x2="end_s:Q",
            color=alt.Color("stage:N", title=None, scale=alt.Scale(scheme="tableau10"),
                            legend=alt.Legend(orient="right")),
        )
    )  # fmt: skip
