"""How long a gauge averages, found from how it follows a step of the power, and what that does at a window's edge.

Many gauges show the mean of the last seconds, some of the last two minutes. Within a window of one
configuration that changes nothing; where the power steps (idle before the first window, another configuration
next) the shown power ramps for that long, and a window that began with the step would be billed for its
neighbour. The power of every window and of the time around them is fitted for every lag of a grid, and the
shortest lag that explains the updates is taken: without a step the lag is unknown, does not matter, and is 0.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from joulebox_agent.series import Floats, PowerSeries

REFRESHES = (0, 0.5, 1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 30, 40, 50, 60, 80, 100, 120)
LONGEST_LAG_S = 120.0
BEFORE, AFTER = 2, 4  # refreshes around the stretches whose updates are looked at
NEEDED_GAIN = 8.0  # in twice the log likelihood, before a longer lag is believed


@dataclass(frozen=True)
class Lag:
    """lag_s: the gauge shows the mean of this many seconds. edge_j: what every window, integrated half a lag
    later, lacks because the step at its edges is blurred [J]."""

    lag_s: float
    edge_j: tuple[float, ...]


def fit_lag(series: PowerSeries, stretches: Sequence[tuple[float, float]]) -> Lag:
    """The gauge's lag from the steps at the edges of stretches (start_s, end_s), in order, without overlap."""
    nothing = Lag(0.0, (0.0,) * len(stretches))
    refresh_s = series.refresh_s()
    if refresh_s is None or not stretches:
        return nothing
    longest_s = min(LONGEST_LAG_S, min(end_s - start_s for start_s, end_s in stretches))
    lags_s = [count * refresh_s for count in REFRESHES if count * refresh_s <= longest_s]
    earliest_s, latest_s = stretches[0][0] - BEFORE * refresh_s, stretches[-1][1] + AFTER * refresh_s
    taken = (series.node_times_s > earliest_s) & (series.node_times_s <= latest_s)
    times_s, power_w = series.node_times_s[taken], series.node_powers_w[taken]
    edges_s = _edges(stretches, lags_s[-1] + AFTER * refresh_s)
    if times_s.size < 2 * len(edges_s):
        return nothing
    fits = [_levels(times_s, power_w, lag_s, edges_s) for lag_s in lags_s]
    enough = min(cost for cost, _ in fits) + NEEDED_GAIN
    lag_s, levels_w = next(
        (lag_s, levels) for lag_s, (cost, levels) in zip(lags_s, fits, strict=True) if cost <= enough
    )
    return Lag(lag_s, _edge_energies(stretches, edges_s, levels_w, _leak_s(lag_s, refresh_s)))


def _levels(times_s: Floats, power_w: Floats, lag_s: float, edges_s: list[float]) -> tuple[float, Floats]:
    """(minus twice the log likelihood, power between neighbouring edges [W]; nan where no update tells it)."""
    design = _overlaps(times_s, max(lag_s, 1e-6), edges_s)
    told = design.sum(axis=0) > 0.5
    levels_w = np.full(told.size, np.nan)
    levels_w[told], *_ = np.linalg.lstsq(design[:, told], power_w, rcond=None)
    misfit = float(((power_w - design[:, told] @ levels_w[told]) ** 2).sum())
    return times_s.size * math.log(misfit + 1e-9 * float(power_w @ power_w)), levels_w


def _edges(stretches: Sequence[tuple[float, float]], margin_s: float) -> list[float]:
    """Borders of all stretches and of the time around them; neighbours that touch share a border."""
    edges_s = [stretches[0][0] - margin_s]
    for start_s, end_s in stretches:
        if start_s > edges_s[-1]:
            edges_s.append(start_s)
        edges_s.append(end_s)
    return [*edges_s, stretches[-1][1] + margin_s]


def _overlaps(times_s: Floats, lag_s: float, edges_s: list[float]) -> Floats:
    """Share (updates, levels) of each update's averaging time that falls between neighbouring edges."""
    borders_s = np.array(edges_s)
    upto = np.clip((borders_s[None, :] - (times_s[:, None] - lag_s)) / lag_s, 0.0, 1.0)
    return np.diff(upto, axis=1)


def _leak_s(lag_s: float, refresh_s: float) -> float:
    """Mean distance that power is carried over an edge: E[max(X, 0)] for X uniform over the lag plus the
    triangle of the interpolation between updates; 0.4 of its standard deviation, within 8 %."""
    return 0.4 * math.sqrt(lag_s**2 / 12 + refresh_s**2 / 6)


def _edge_energies(
    stretches: Sequence[tuple[float, float]], edges_s: list[float], levels_w: Floats, leak_s: float
) -> tuple[float, ...]:
    found = []
    for start_s, _ in stretches:
        level = edges_s.index(start_s)
        steps_w = levels_w[level] - levels_w[[level - 1, level + 1]]
        found.append(float(leak_s * np.nan_to_num(steps_w).sum()))
    return tuple(found)
