"""Faults of a sensor that no single reading shows: each named, each with the stretch it spoils.

`stretch_fault` says why a window cannot be trusted; the window is void, the measurement goes on.
"""

import math
from collections.abc import Sequence

from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.reading import Primary

FROZEN_REFRESHES = 5
BY_CHANCE = 1e-5  # a run of repeated values that is less likely than this is a frozen gauge
COUNTER_STEPS = 3  # that a counter must be short of, or off by, before it contradicts the gauge
DISAGREEMENT = 0.05


def stretch_fault(
    series: PowerSeries,
    start_s: float,
    end_s: float,
    primary: Primary,
    load_changes_s: Sequence[float] = (),
) -> str | None:
    """Why the samples of [start_s, end_s] cannot be trusted, or None.

    load_changes_s  moments at which the power is known to have stepped (rendering began or ended)
    """
    gap_s = series.longest_gap_s(start_s, end_s)
    if not series.covered(start_s, end_s):
        return f"no good sample for {gap_s:.1f} s" if math.isfinite(gap_s) else "no good sample at all"
    if primary == "counter":
        return counter_fault(series, start_s, end_s)
    return frozen_gauge(series, start_s, end_s, load_changes_s)


def counter_fault(series: PowerSeries, start_s: float, end_s: float) -> str | None:
    """A counter that ran backwards, may have wrapped twice, or lost a pack within the stretch, or None."""
    if len(series.epochs(start_s, end_s)) > 1:
        return "the counter ran backwards or lost its thread (a pack changed, a second wrap)"
    return None


def frozen_gauge(series: PowerSeries, start_s: float, end_s: float, load_changes_s: Sequence[float] = ()) -> str | None:
    """Why the gauge counts as frozen in a part of [start_s, end_s], or None.

    Five refreshes without another value are a suspicion only, since a coarse gauge repeats itself at constant
    power. Proof is one of: the load stepped meanwhile; the counter moved by something else than what the held
    value says; the counter stood still as well although energy was used; the run is too long to be chance,
    judged by how often this gauge repeats itself elsewhere.
    """
    refresh_s = series.refresh_s()
    if refresh_s is None:
        return None
    for held_from_s, held_to_s, held_w in series.holds():
        held_s = held_to_s - held_from_s
        if held_s <= FROZEN_REFRESHES * refresh_s or held_to_s <= start_s or held_from_s >= end_s:
            continue
        why = (
            _stepped(held_from_s + 2 * refresh_s, held_to_s - 2 * refresh_s, load_changes_s)
            or _counter_objects(series, held_from_s, held_to_s, held_w)
            or _too_long(series, held_s, refresh_s)
        )
        if why:
            return f"the gauge froze at {held_w:.4g} W for {held_s:.1f} s ({held_s / refresh_s:.0f} refreshes): {why}"
    return None


def _stepped(from_s: float, to_s: float, load_changes_s: Sequence[float]) -> str | None:
    return "the load changed meanwhile" if any(from_s < at_s < to_s for at_s in load_changes_s) else None


def _counter_objects(series: PowerSeries, from_s: float, to_s: float, held_w: float) -> str | None:
    """What the counter says against a value held for so long, None when it agrees or cannot tell."""
    counted_j, step_j = series.energy_j(from_s, to_s, "counter"), series.counter_step_j()
    if counted_j is None or step_j is None:
        return None
    expected_j = held_w * (to_s - from_s)
    if abs(counted_j - expected_j) <= max(COUNTER_STEPS * step_j, DISAGREEMENT * expected_j):
        return None
    if counted_j <= 1.01 * step_j:
        return f"the counter stood still as well, where {expected_j:.3g} J were used"
    return f"the counter says {counted_j:.3g} J, the held value {expected_j:.3g} J"


def _too_long(series: PowerSeries, held_s: float, refresh_s: float) -> str | None:
    """Whether the run of repeats is beyond chance, given the share of repeats in all other updates."""
    lengths = [max(1, round((to_s - from_s) / refresh_s)) for from_s, to_s, _ in series.holds()]
    run = max(1, round(held_s / refresh_s))
    lengths.remove(run)
    others = sum(lengths)
    repeats = others - len(lengths)
    # chance of run - 1 more repeats, the rate of repeats being known from the others only (Jeffreys' prior)
    chance = math.prod((repeats + 0.5 + more) / (others + 1 + more) for more in range(run - 1))
    return "it repeats itself nowhere else like that" if (1 + len(lengths)) * chance < BY_CHANCE else None
