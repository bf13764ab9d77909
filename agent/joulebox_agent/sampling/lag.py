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

from joulebox_agent.sampling.series import Floats, PowerSeries

REFRESHES = (0, 0.5, 1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 30, 40, 50, 60, 80, 100, 120)
LONGEST_LAG_S = 120.0
PIECE = (
    3.0  # refreshes; length of the first piece of constant power beside a stretch, each further one is twice as long
)
MOST_STRETCHES = 40  # that the lag, a property of the gauge, is fitted on
Stretch = tuple[float, float]  # (start_s, end_s)
FINER = 9  # lags that are looked at around the one of the grid
NEEDED_GAIN = 8.0  # in twice the log likelihood, before a longer lag is believed


@dataclass(frozen=True)
class Lag:
    """lag_s: the gauge shows the mean of this many seconds. edges_j: what every window, integrated half a lag
    later, lacks at its start and at its end because the step there is blurred [J]."""

    lag_s: float
    edges_j: tuple[tuple[float, float], ...]


def fit_lag(series: PowerSeries, stretches: Sequence[Stretch], loads: Sequence[Stretch] | None = None) -> Lag:
    """The gauge's lag from the steps at the edges of loads.

    stretches  (start_s, end_s) that do not overlap
    loads      for each of them the longer stretch of the same load that it lies in; None: the power steps at its edges
    """
    refresh_s = series.refresh_s()
    if refresh_s is None or not stretches:
        return Lag(0.0, ((0.0, 0.0),) * len(stretches))
    pairs = list(zip(stretches, stretches if loads is None else loads, strict=True))
    lag_s = _likeliest_s(series, _widened(sorted(pairs)[:MOST_STRETCHES]), refresh_s)
    return Lag(lag_s, tuple(_edges_j(series, stretch, load, lag_s, refresh_s) for stretch, load in pairs))


def _widened(pairs: Sequence[tuple[Stretch, Stretch]]) -> list[Stretch]:
    """Every stretch up to where its load begins and ends, or where its neighbour of the same load lies."""
    wide = []
    for number, ((start_s, end_s), (from_s, to_s)) in enumerate(pairs):
        first = number == 0 or pairs[number - 1][0][1] <= from_s
        last = number + 1 == len(pairs) or to_s <= pairs[number + 1][0][0]
        wide.append((from_s if first else start_s, to_s if last else end_s))
    return wide


def _likeliest_s(series: PowerSeries, stretches: Sequence[Stretch], refresh_s: float) -> float:
    """The shortest lag of the grid that explains the updates within the stretches, 0 where they are too few [s]."""
    longest_s = min(LONGEST_LAG_S, min(end_s - start_s for start_s, end_s in stretches))
    lags_s = [count * refresh_s for count in REFRESHES if count * refresh_s <= longest_s]
    inside = np.zeros(series.node_times_s.size, dtype=bool)
    for start_s, end_s in stretches:
        inside |= (series.node_times_s > start_s) & (series.node_times_s <= end_s)
    times_s, power_w = series.node_times_s[inside], series.node_powers_w[inside]
    edges_s = _edges(stretches, lags_s[-1] + refresh_s, PIECE * refresh_s)
    if times_s.size < 2 * len(stretches) + 2:
        return 0.0
    costs = [_cost(times_s, power_w, lag_s, edges_s) for lag_s in lags_s]
    if costs[0] <= min(costs) + NEEDED_GAIN:
        return 0.0
    best = int(np.argmin(costs))
    finer_s = np.linspace(lags_s[best - 1], lags_s[min(best + 1, len(lags_s) - 1)], FINER)
    return float(min(finer_s, key=lambda lag_s: _cost(times_s, power_w, lag_s, edges_s)))


def _cost(times_s: Floats, power_w: Floats, lag_s: float, edges_s: list[float]) -> float:
    """Schwarz' criterion of this lag: power is constant between neighbouring edges, the updates average it."""
    design = _overlaps(times_s, max(lag_s, 1e-6), edges_s)
    design = design[:, design.sum(axis=0) > 0.5]
    normal = design.T @ design
    levels_w = np.linalg.solve(normal + 1e-6 * np.eye(normal.shape[0]), design.T @ power_w)
    misfit = float(((power_w - design @ levels_w) ** 2).sum()) + 1e-9 * float(power_w @ power_w)
    return times_s.size * math.log(misfit) + math.log(times_s.size) * int(design.shape[1])


def _edges(stretches: Sequence[Stretch], margin_s: float, piece_s: float) -> list[float]:
    """Borders of all stretches, and of the pieces that the time around them is cut into, finest beside a stretch.

    Neighbours that touch share a border.
    """
    edges_s = [stretches[0][0] - back_s for back_s in reversed(_outward(margin_s, piece_s))]
    for number, (start_s, end_s) in enumerate(stretches):
        edges_s += [start_s] if not number or start_s > edges_s[-1] else []
        edges_s.append(end_s)
        if number + 1 < len(stretches):
            gap_s = stretches[number + 1][0] - end_s
            away = _outward(gap_s / 2, piece_s)[:-1] if gap_s > 2 * piece_s else []
            edges_s += [end_s + on_s for on_s in away] + [end_s + gap_s - back_s for back_s in reversed(away)]
    return edges_s + [stretches[-1][1] + on_s for on_s in _outward(margin_s, piece_s)]


def _outward(length_s: float, piece_s: float) -> list[float]:
    """Distances from a border at which pieces end: each twice as long as the one before, the last at length_s."""
    ends_s = []
    at_s = piece_s
    while at_s < length_s - piece_s:
        ends_s.append(at_s)
        at_s = 2 * at_s + piece_s
    return [*ends_s, length_s]


def _overlaps(times_s: Floats, lag_s: float, edges_s: list[float]) -> Floats:
    """Share (updates, levels) of each update's averaging time that falls between neighbouring edges."""
    borders_s = np.array(edges_s)
    upto = np.clip((borders_s[None, :] - (times_s[:, None] - lag_s)) / lag_s, 0.0, 1.0)
    return np.diff(upto, axis=1)


def _leak_s(lag_s: float, refresh_s: float, away_s: float) -> float:
    """Mean distance that power of a step is carried into a stretch whose edge is away_s from it: E[max(X - away, 0)]
    for X uniform over the lag plus the triangle of the interpolation between updates, within 8 % of their spread
    that of a normal X."""
    spread_s = math.sqrt(lag_s**2 / 12 + refresh_s**2 / 6)
    z = away_s / spread_s
    return spread_s * (math.exp(-z * z / 2) / math.sqrt(2 * math.pi) - z * math.erfc(z / math.sqrt(2)) / 2)


def _edges_j(
    series: PowerSeries, stretch: Stretch, load: Stretch, lag_s: float, refresh_s: float
) -> tuple[float, float]:
    """Energy that leaks out of a stretch over either edge, from the updates around its load; 0 without any [J]."""
    (start_s, end_s), (from_s, to_s) = stretch, load
    own_w = _mean_w(series, start_s + lag_s, end_s)
    beside_s = PIECE * refresh_s
    before_w = _mean_w(series, from_s - beside_s, from_s)
    after_w = _mean_w(series, to_s + lag_s, to_s + lag_s + beside_s)
    before_s, after_s = _leak_s(lag_s, refresh_s, start_s - from_s), _leak_s(lag_s, refresh_s, to_s - end_s)
    return (
        0.0 if own_w is None or before_w is None else before_s * (own_w - before_w),
        0.0 if own_w is None or after_w is None else after_s * (own_w - after_w),
    )


def _mean_w(series: PowerSeries, start_s: float, end_s: float) -> float | None:
    """Mean of the updates in a stretch, None without any."""
    inside = (series.node_times_s > start_s) & (series.node_times_s <= end_s)
    return float(series.node_powers_w[inside].mean()) if inside.any() else None
