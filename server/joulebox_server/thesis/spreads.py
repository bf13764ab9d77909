"""Charts that draw every seed: strips of one quantity a regime, and clouds of cost against difference."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import altair as alt

from joulebox_server.analysis import palette
from joulebox_server.analysis.layers import data
from joulebox_server.thesis.batch import Spec
from joulebox_server.thesis.figures import finished

ROW_HEIGHT = 26
CLOUD_HEIGHT = 400


def strips(values: Mapping[str, Sequence[float]], title: str, limit: float | None = None, *, log: bool) -> Spec | None:
    """A row a name: a tick a seed, a bar of one standard deviation about the mean, and the mean; None without values.

    limit   an upright line
    """
    shown = {name: [v for v in found if v > 0 or not log] for name, found in values.items()}
    shown = {name: found for name, found in shown.items() if found}
    if not shown:
        return None
    scale = alt.Scale(type="log" if log else "linear", zero=alt.Undefined if log else False)
    x_axis = alt.Axis(title=title, format=",~r", labelOverlap=True)
    y = alt.Y("name:N", sort=list(shown), axis=alt.Axis(title=None, labelLimit=300, ticks=False, domain=False))
    seeds = data([{"name": name, "x": value} for name, found in shown.items() for value in found])
    means = data([_mean_row(name, found) for name, found in shown.items()])
    told = [alt.Tooltip("name:N", title="regime"), alt.Tooltip("told:N", title=title)]
    parts = [
        means.mark_rule(strokeWidth=7, opacity=0.3, color=palette.BLUE).encode(
            x=alt.X("low:Q", scale=scale, axis=x_axis), x2="high:Q", y=y
        ),
        seeds.mark_tick(thickness=1.2, size=13, opacity=0.65, color=palette.INK).encode(
            x=alt.X("x:Q", scale=scale, axis=x_axis), y=y
        ),
        means.mark_point(filled=True, size=70, opacity=1, color=palette.BLUE).encode(
            x=alt.X("mean:Q", scale=scale, axis=x_axis), y=y, tooltip=told
        ),
    ]
    if limit is not None:
        line = data([{"x": limit}])
        parts.append(
            line.mark_rule(color=palette.GREEN, strokeDash=[5, 3], strokeWidth=1.5).encode(
                x=alt.X("x:Q", scale=scale, axis=x_axis)
            )
        )
    return finished(alt.layer(*parts).properties(height=ROW_HEIGHT * len(shown)))


def clouds(
    found: Mapping[str, tuple[str, Sequence[float], Sequence[float]]], x: str, y: str, limit: float
) -> Spec | None:
    """Every seed as a small point, each regime's mean with bars of one standard deviation both ways, and its name.

    found   name -> (kind, by which it is coloured; x values; y values)
    """
    seeds, means = [], []
    for name, (kind, xs, ys) in found.items():
        pairs = [(a, b) for a, b in zip(xs, ys, strict=True) if a > 0 and b > 0]
        if not pairs:
            continue
        across, up = _mean_row(name, [a for a, _ in pairs]), _mean_row(name, [b for _, b in pairs])
        seeds += [{"kind": kind, "x": a, "y": b, "name": name} for a, b in pairs]
        means.append({"kind": kind, "name": name, "x": across["mean"], "y": up["mean"], "x_low": across["low"],
                      "x_high": across["high"], "y_low": up["low"], "y_high": up["high"],
                      "cost": across["told"], "difference": up["told"]})  # fmt: skip
    if not means:
        return None
    kinds = list(dict.fromkeys(row["kind"] for row in means))
    colour = alt.Color("kind:N", title="method", sort=kinds, scale=alt.Scale(domain=kinds, range=palette.CATEGORIES))
    on = alt.Scale(type="log", nice=False, padding=12)
    x_axis, y_axis = alt.Axis(title=x, format=",~r"), alt.Axis(title=y, format=",~r")
    told = [alt.Tooltip(f"{name}:N") for name in ("name", "kind", "cost", "difference")]
    base = data(means)
    at = {"x": alt.X("x:Q", scale=on, axis=x_axis), "y": alt.Y("y:Q", scale=on, axis=y_axis)}
    chart = alt.layer(
        data([{"y": limit}])
        .mark_rule(color=palette.GREEN, strokeDash=[5, 3], strokeWidth=1.5)
        .encode(y=alt.Y("y:Q", scale=on, axis=y_axis)),
        data(seeds).mark_circle(size=14, opacity=0.45).encode(**at, color=colour),
        base.mark_rule(strokeWidth=1.6).encode(
            x=alt.X("x_low:Q", scale=on, axis=x_axis), x2="x_high:Q", y=at["y"], color=colour
        ),
        base.mark_rule(strokeWidth=1.6).encode(
            x=at["x"], y=alt.Y("y_low:Q", scale=on, axis=y_axis), y2="y_high:Q", color=colour
        ),
        base.mark_point(filled=True, size=70, opacity=1, stroke="#ffffff").encode(**at, color=colour, tooltip=told),
        *(_names(means[place::2], at, dy) for place, dy in enumerate((-7, 11))),
    )
    return finished(chart.properties(height=CLOUD_HEIGHT))


def _names(means: list[dict[str, Any]], at: dict[str, Any], dy: int) -> Any:
    """Names beside means, every other one lower: regimes that come out alike would hide each other's."""
    return data(means).mark_text(color=palette.INK, align="left", dx=8, dy=dy, fontSize=10).encode(**at, text="name:N")


def _mean_row(name: str, values: Sequence[float]) -> dict[str, Any]:
    """Mean, and one standard deviation about it; on a logarithmic axis the lower end must stay above 0."""
    mean = math.fsum(values) / len(values)
    deviation = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / max(len(values) - 1, 1))
    told = f"{mean:.4g}, one standard deviation {deviation:.2g}, {min(values):.4g} to {max(values):.4g}"
    low = max(mean - deviation, min(*values, mean))
    return {"name": name, "mean": mean, "low": low, "high": mean + deviation, "told": told}
