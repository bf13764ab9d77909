"""Energy of every window of a measurement, and what the source could not resolve."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from joulebox_agent.calibration import Calibration
from joulebox_agent.estimate import Interval, two_stage_interval
from joulebox_agent.series import PowerSeries
from joulebox_agent.sources.reading import EnergySource, Primary
from joulebox_agent.windows import Window

ADVISED_REFRESHES = 15
FEWEST_STEPS = 5  # of a counter over all windows, below which its difference says little
DISAGREEMENT_NOTED, DISAGREEMENT_REJECTED = 0.05, 1.0
IDLE_PIECES = 3
NODES_A_STAGE = 4  # of a fast source in one run of a stage, below which neighbouring stages blur


@dataclass(frozen=True)
class WindowEnergies:
    """gross_j, counter_j: one value a window, None where unknown. notes: what a reader must know."""

    gross_j: tuple[float | None, ...]
    counter_j: tuple[float | None, ...]
    notes: tuple[str, ...]


def window_energies(
    series: PowerSeries, source: EnergySource, windows: list[Window], resolution_j: float | None
) -> WindowEnergies:
    """Whole-window energies; all None, with a note on the bound, where the source cannot resolve them.

    resolution_j  step of the counter [J], None when it has no noticeable one
    """
    nothing = (None,) * len(windows)
    if source.quality == "none" or not windows:
        return WindowEnergies(nothing, nothing, ())
    gross_j = tuple(series.energy_j(w.start_s, w.end_s, source.primary) for w in windows)
    counter_j = tuple(series.energy_j(w.start_s, w.end_s, "counter") for w in windows)
    notes: list[str] = []
    counter_bound = _coarse_counter(counter_j, windows, resolution_j)
    if counter_bound:
        counter_j = nothing
    if source.primary == "counter":
        return WindowEnergies(counter_j, counter_j, (counter_bound,) if counter_bound else ())
    gauge_bound = _slow_gauge(series, windows)
    if gauge_bound:
        return WindowEnergies(nothing, nothing, (gauge_bound,))
    notes += _short_windows(series, windows)
    disagreement = _disagreement(gross_j, counter_j)
    if disagreement is not None and abs(disagreement) > DISAGREEMENT_NOTED:
        notes.append(f"the battery's counter says {disagreement:+.0%} against its gauge")
        if not 1 / (1 + DISAGREEMENT_REJECTED) <= 1 + disagreement <= 1 + DISAGREEMENT_REJECTED:
            counter_j = nothing
            notes[-1] += " and is rejected"
    return WindowEnergies(gross_j, counter_j, tuple(notes))


def _coarse_counter(
    counter_j: tuple[float | None, ...], windows: list[Window], resolution_j: float | None
) -> str | None:
    known = [energy_j for energy_j in counter_j if energy_j is not None]
    if not known or not resolution_j or sum(known) >= FEWEST_STEPS * resolution_j:
        return None
    bound_j = FEWEST_STEPS * resolution_j / sum(w.images for w in windows)
    return (
        f"not resolvable by the counter: {sum(known):.3g} J in all windows, by steps of "
        f"{resolution_j:.3g} J; an image costs less than {bound_j:.3g} J"
    )


def _slow_gauge(series: PowerSeries, windows: list[Window]) -> str | None:
    """A gauge with less than one update a window: the windows share their readings and are no sample."""
    start_s, end_s = windows[0].start_s, windows[-1].end_s
    updates = series.update_count(start_s, end_s)
    if updates >= len(windows):
        return None
    highest_w = series.highest_w(start_s, end_s)
    if highest_w is None:
        return "not resolvable: the gauge gave no power in the windows"
    bound_j = highest_w * (end_s - start_s) / sum(w.images for w in windows)
    return (
        f"not resolvable: {updates} gauge updates in {len(windows)} windows of {windows[0].wall_s:.1f} s; "
        f"at the highest power seen an image costs {bound_j:.3g} J; make windows longer"
    )


def _short_windows(series: PowerSeries, windows: list[Window]) -> list[str]:
    refresh_s = series.refresh_s()
    if refresh_s is None or windows[0].wall_s >= ADVISED_REFRESHES * refresh_s:
        return []
    held = windows[0].wall_s / refresh_s
    return [
        f"short windows: {windows[0].wall_s:.1f} s hold {held:.1f} gauge refreshes of {refresh_s:.1f} s, "
        f"{ADVISED_REFRESHES} are advised"
    ]


def _disagreement(gross_j: tuple[float | None, ...], counter_j: tuple[float | None, ...]) -> float | None:
    """Counter against gauge over the windows that have both, as a share: +0.1 is 10 % more."""
    both = [(g, c) for g, c in zip(gross_j, counter_j, strict=True) if g is not None and c is not None]
    gauge_j = sum(g for g, _ in both)
    return sum(c for _, c in both) / gauge_j - 1 if gauge_j > 0 else None


def idle_power(series: PowerSeries, source: EnergySource, blocks: list[tuple[float, float]]) -> Interval | None:
    """Mean idle power [W] over blocks (start_s, end_s), its interval from thirds of every block.

    Thirds, because single samples of a gauge are autocorrelated. None when a third holds no update.
    """
    pieces_w: list[float] = []
    for start_s, end_s in blocks:
        length_s = (end_s - start_s) / IDLE_PIECES
        for piece in range(IDLE_PIECES):
            from_s = start_s + piece * length_s
            energy_j = series.energy_j(from_s, from_s + length_s, source.primary)
            if energy_j is None or series.update_count(from_s, from_s + length_s) == 0:
                return None
            pieces_w.append(energy_j / length_s)
    return two_stage_interval(pieces_w, len(pieces_w)) if len(pieces_w) >= 2 else None


def integrated_stage_energies(
    series: PowerSeries,
    stages: Mapping[str, Sequence[tuple[float, float]]],
    total_j: float,
    windows: Sequence[tuple[float, float]],
    primary: Primary = "counter",
    calibration: Calibration | None = None,
) -> dict[str, float] | None:
    """Energy [J] of every stage over its own intervals, scaled so that all the windows' time sums to total_j.

    series       of a source fast enough to resolve a stage (RAPL, a fast replay)
    stages       name -> intervals (start_s, end_s) within the windows; see windows.stage_intervals
    total_j      energy of the windows (start_s, end_s) as the gross source tells it: the scale
    calibration  P_battery = a + b P_rapl, applied before the scale; None: the share is RAPL's own
    None where the source cannot resolve the stages: fewer than 4 of its nodes in a stage's median interval.
    """
    node_s = series.node_s(primary)
    spans = [end_s - start_s for intervals in stages.values() for start_s, end_s in intervals]
    if node_s is None or not spans:
        return None
    if any(
        float(np.median([e - s for s, e in intervals])) < NODES_A_STAGE * node_s
        for intervals in stages.values()
        if intervals
    ):
        return None
    at_battery: dict[str, float] = {}
    for name, intervals in {**stages, "": windows}.items():
        energies = [series.energy_j(start_s, end_s, primary) for start_s, end_s in intervals]
        known = [energy_j for energy_j in energies if energy_j is not None]
        if len(known) < len(energies):
            return None
        length_s = sum(end_s - start_s for start_s, end_s in intervals)
        fixed_j, slope = (0.0, 1.0) if calibration is None else (calibration.a_w * length_s, calibration.b)
        at_battery[name] = fixed_j + slope * sum(known)
    whole_j = at_battery.pop("")
    if whole_j <= 0:
        return None
    return {name: energy_j * total_j / whole_j for name, energy_j in at_battery.items()}
