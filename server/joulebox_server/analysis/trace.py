"""The discharge trace: power against time while one configuration was measured, with its windows."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import altair as alt

from joulebox_server.analysis import palette
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.layers import data
from joulebox_server.analysis.words import figure

MOST_SAMPLES = 2000
"""More are averaged in groups: nobody sees more, and a picture with them is slow."""


@dataclass(frozen=True)
class Trace:
    """Samples of power, and the windows that were cut from them, good and voided."""

    times_s: Sequence[float]
    powers_w: Sequence[float]
    windows: Sequence[Mapping[str, Any]]
    void_windows: Sequence[Mapping[str, Any]]


def read_trace(ndjson: bytes, document: Mapping[str, Any]) -> Trace:
    """Samples as the agent writes them (a line each with `time_s` and `power_w`), windows as its document has them.

    Raises AnalysisError for lines that are something else.
    """
    times_s, powers_w = [], []
    for number, line in enumerate(ndjson.splitlines(), 1):
        try:
            sample = json.loads(line)
            time_s, power_w = float(sample["time_s"]), sample.get("power_w")
        except (ValueError, TypeError, KeyError, AttributeError):
            raise AnalysisError(f"line {number} of the samples must be an object with time_s and power_w") from None
        if isinstance(power_w, int | float):
            times_s.append(time_s)
            powers_w.append(float(power_w))
    return Trace(times_s, powers_w, document.get("window_data") or [], document.get("void_windows") or [])


def trace_layers(trace: Trace) -> Any:
    """The chart: power over the windows; those that count are shaded, the voided ones outlined with their reason."""
    if not trace.times_s:
        raise AnalysisError("these samples hold no power, so there is no trace to draw")
    axis = alt.X("time_s:Q", axis=alt.Axis(title="time since the measurement began [s]", tickCount=8))
    parts = [_spans(trace.windows, filled=True, x=axis), _spans(trace.void_windows, filled=False, x=axis)]
    times_s, powers_w = _thinned(trace.times_s), _thinned(trace.powers_w)
    line = data([{"time_s": t, "power_w": p} for t, p in zip(times_s, powers_w, strict=True)])
    power = alt.Y("power_w:Q", axis=alt.Axis(title="power [W]", tickCount=5), scale=alt.Scale(zero=True))
    drawn = line.mark_line(color=palette.BLUE, strokeWidth=1.5, interpolate="step-after").encode(x=axis, y=power)
    return alt.layer(*(part for part in parts if part is not None), drawn)


def _spans(windows: Sequence[Mapping[str, Any]], *, filled: bool, x: Any) -> Any:
    rows = [
        {
            "time_s": window["start_s"],
            "end_s": window["start_s"] + window["time_s"],
            "told": _told(window),
        }
        for window in windows
    ]
    if not rows:
        return None
    look = {"opacity": 0.18} if filled else {"filled": False, "strokeDash": [4, 3], "strokeWidth": 1.5}
    colour = palette.GREEN if filled else palette.VERMILION
    return (
        data(rows)
        .mark_rect(color=colour, **look)
        .encode(x=x, x2="end_s:Q", tooltip=alt.Tooltip("told:N", title="window"))
    )


def _told(window: Mapping[str, Any]) -> str:
    if window.get("reason"):
        return f"does not count: {window['reason']}"
    energy_j = window.get("energy_j")
    energy = "energy not known" if energy_j is None else f"{figure(energy_j)} J"
    return f"{window['images']} image(s) in {figure(window['time_s'])} s, {energy}"


def _thinned(values: Sequence[float]) -> list[float]:
    """Means of equally long groups, at most MOST_SAMPLES of them."""
    size = -(-len(values) // MOST_SAMPLES)
    groups = [values[start : start + size] for start in range(0, len(values), size)]
    return [sum(group) / len(group) for group in groups]
