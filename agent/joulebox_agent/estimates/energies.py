"""Energy of every window of a measurement, and what the source could not resolve."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from joulebox_agent.estimates import drift
from joulebox_agent.estimates.calibration import Calibration
from joulebox_agent.estimates.estimate import Interval, step_half, two_stage_interval
from joulebox_agent.estimates.windows import Window
from joulebox_agent.sampling.faults import counter_fault
from joulebox_agent.sampling.lag import Lag, fit_lag
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.reading import EnergySource, Primary

ADVISED_REFRESHES = 15
FEWEST_STEPS = 5  # of a counter in a window, below which its difference says little
DISAGREEMENT_NOTED = 0.05  # share by which a counter may differ from the gauge unmentioned
REJECTED_BEYOND = 2.0  # times the gauge's energy, or its inverse
IDLE_PIECES = 3
PIECE_UPDATES, MOST_PIECES = 2, 8  # pieces of a window, in which drift within it shows
MANY_WINDOWS, MOST_ROWS = 20, 80  # from which on they show drift uncut; pieces that are looked at
NO_LAG = Lag(0.0, ())
NODES_A_STAGE = 4  # of a fast source in one run of a stage, below which neighbouring stages blur


@dataclass(frozen=True)
class WindowEnergies:
    """gross_j, counter_j: one value a window, None where unknown. notes: what a reader must know.

    least_share, counter_least_share  least half-width of a mean over the windows, as a share of it: what drift asks
                                      for, and of a counter its steps
    lag_s  the gauge shows the mean of this many seconds, as fitted; 0 where nothing tells it
    """

    gross_j: tuple[float | None, ...]
    counter_j: tuple[float | None, ...]
    notes: tuple[str, ...]
    least_share: float = 0.0
    counter_least_share: float = 0.0
    lag_s: float = 0.0


def window_energies(
    series: PowerSeries, source: EnergySource, windows: list[Window], resolution_j: float | None
) -> WindowEnergies:
    """Whole-window energies; all None, with a note on the bound, where the source cannot resolve them.

    resolution_j  step of the counter [J] as told, None when it has no noticeable one; what is seen comes first
    """
    nothing = (None,) * len(windows)
    if source.quality == "none" or not windows:
        return WindowEnergies(nothing, nothing, ())
    resolution_j = series.counter_quantum_j() or resolution_j
    stretches = [(w.start_s, w.end_s) for w in windows]
    lag = fit_lag(series, stretches, [w.load_s for w in windows]) if source.primary == "power" else NO_LAG
    gross_j = _energies_j(series, source.primary, stretches, lag)
    counter_j = tuple(series.energy_j(w.start_s, w.end_s, "counter") for w in windows)
    notes: list[str] = []
    disagreement_notes, rejected = _disagreement(gross_j, counter_j, resolution_j or 0.0)
    counter_bound = _coarse_counter(counter_j, windows, resolution_j)
    if counter_bound:
        counter_j = nothing
    if source.primary == "counter":
        if counter_bound:
            return WindowEnergies(nothing, nothing, (counter_bound,))
        share = max(drift_share(series, windows, None), _step_share(series, windows, counter_j, resolution_j))
        return WindowEnergies(counter_j, counter_j, (), share, share)
    gauge_bound = _slow_gauge(series, windows)
    if gauge_bound:
        return WindowEnergies(nothing, nothing, (gauge_bound,))
    notes += _short_windows(series, windows)
    notes += disagreement_notes
    backwards = sum(counter_fault(series, w.start_s, w.end_s) is not None for w in windows)
    if backwards:
        notes.append(f"the counter beside the gauge ran backwards or lost its thread in {backwards} windows")
    if rejected:
        counter_j = nothing
    share = drift_share(series, windows, lag)
    counter_share = max(share, _step_share(series, windows, counter_j, resolution_j))
    return WindowEnergies(gross_j, counter_j, tuple(notes), share, counter_share, lag.lag_s)


def stretch_energies_j(
    series: PowerSeries, primary: Primary, stretches: Sequence[tuple[float, float]]
) -> tuple[float | None, ...]:
    """Energy [J] of stretches (start_s, end_s) that share no time, None where unknown; allows for a lag."""
    return _energies_j(series, primary, stretches, fit_lag(series, stretches) if primary == "power" else NO_LAG)


def _energies_j(
    series: PowerSeries, primary: Primary, stretches: Sequence[tuple[float, float]], lag: Lag
) -> tuple[float | None, ...]:
    plain_j = [series.energy_j(start_s, end_s, primary, lag.lag_s) for start_s, end_s in stretches]
    if primary != "power":
        return tuple(plain_j)
    return tuple(j + sum(edges_j) if j is not None else None for j, edges_j in zip(plain_j, lag.edges_j, strict=True))


def drift_share(series: PowerSeries, windows: Sequence[Window], lag: Lag | None) -> float:
    """Half-width that drift asks for, as a share of the mean; see drift.half_share. lag: of a gauge.

    Every window is cut into the same number of pieces of whole images, each of PIECE_UPDATES updates or more, of
    MOST_ROWS windows at the most; 0 where a window does not hold two such pieces and there are few windows.
    """
    windows = windows[:MOST_ROWS]
    updates = min(series.update_count(w.start_s, w.end_s) for w in windows)
    count = min(MOST_PIECES, updates // PIECE_UPDATES, MOST_ROWS // len(windows), *(w.images for w in windows))
    if count < (2 if len(windows) < MANY_WINDOWS else 1):
        return 0.0
    pieces = np.array([piece for window in windows for piece in window.pieces(count)])
    starts_s, lengths_s, images = pieces[:, 0], pieces[:, 1] - pieces[:, 0], pieces[:, 2]
    if lengths_s.min() <= 0:
        return 0.0
    looks = [_piece_energies_j(series, "counter", pieces, NO_LAG, count)]
    if lag is not None:
        looks.append(_piece_energies_j(series, "power", pieces, lag, count))
    views = [look_j / part for look_j in looks if look_j is not None for part in (images, lengths_s)]
    # the first piece begins where the power stepped, and what is known between two updates is blurred by that
    return drift.half_share([view[1:] for view in views], starts_s[1:], lengths_s[1:], windows[0].wall_s)


def _piece_energies_j(
    series: PowerSeries, primary: Primary, pieces: drift.Floats, lag: Lag, count: int
) -> drift.Floats | None:
    """Energy of every piece, `count` of them a window; None where one is unknown."""
    found = [series.energy_j(start_s, end_s, primary, lag.lag_s) for start_s, end_s, _ in pieces]
    known = [energy_j for energy_j in found if energy_j is not None]
    if len(known) < len(found):
        return None
    energies_j = np.array(known)
    for row, (at_start_j, at_end_j) in enumerate(lag.edges_j[: len(known) // count]):
        energies_j[row * count] += at_start_j
        energies_j[row * count + count - 1] += at_end_j
    return energies_j


def _step_share(
    series: PowerSeries, windows: Sequence[Window], counter_j: Sequence[float | None], resolution_j: float | None
) -> float:
    """Half-width that the counter's steps ask for at least, as a share of the windows' mean; see estimate.step_half.

    Where the counter refreshes several times a step, it is seen to move, and is known at that moment to what is used
    in a refresh.
    """
    known = [energy_j for energy_j in counter_j if energy_j is not None]
    refresh_s = series.refresh_s()
    if len(known) < 2 or not resolution_j or refresh_s is None or sum(known) <= 0:
        return 0.0
    mean_j = sum(known) / len(known)
    refresh_j = refresh_s * mean_j / (sum(window.wall_s for window in windows) / len(windows))
    return step_half(len(known)) * min(resolution_j, refresh_j) / mean_j


def _coarse_counter(
    counter_j: tuple[float | None, ...], windows: list[Window], resolution_j: float | None
) -> str | None:
    """A counter whose steps are too coarse for the windows: they share steps and are no sample."""
    known = [energy_j for energy_j in counter_j if energy_j is not None]
    if not known or not resolution_j or sum(known) >= FEWEST_STEPS * resolution_j * len(known):
        return None
    bound_j = FEWEST_STEPS * resolution_j * len(windows) / sum(w.images for w in windows)
    return (
        f"not resolvable by the counter: {sum(known):.3g} J in {len(known)} windows, by steps of "
        f"{resolution_j:.3g} J; an image costs less than {bound_j:.3g} J; make windows longer"
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
        f"short windows: {windows[0].wall_s:.1f} s hold {held:.1f} gauge refreshes of {refresh_s:.3g} s, "
        f"{ADVISED_REFRESHES} are advised"
    ]


def _disagreement(
    gross_j: tuple[float | None, ...], counter_j: tuple[float | None, ...], resolution_j: float
) -> tuple[list[str], bool]:
    """What to say of the counter against the gauge over the windows that have both, and whether to reject it.

    Differences within two steps of the counter say nothing.
    """
    both = [(g, c) for g, c in zip(gross_j, counter_j, strict=True) if g is not None and c is not None]
    gauge_j, counted_j = sum(g for g, _ in both), sum(c for _, c in both)
    if gauge_j <= 0 or abs(counted_j - gauge_j) <= DISAGREEMENT_NOTED * gauge_j + 2 * resolution_j:
        return [], False
    note = f"the battery's counter says {counted_j / gauge_j - 1:+.0%} against its gauge"
    if 1 / REJECTED_BEYOND <= counted_j / gauge_j <= REJECTED_BEYOND:
        return [note], False
    return [note + " and is rejected"], True


def idle_power(
    series: PowerSeries, source: EnergySource, blocks: list[tuple[float, float]], lag_s: float = 0.0
) -> Interval | None:
    """Mean idle power [W] over blocks (start_s, end_s), its interval from thirds of every block.

    Thirds, because single samples of a gauge are autocorrelated; how far the blocks drift apart is part of the
    interval (drift.py). The beginning of a block, in which the gauge (lag_s) still shows what was before, is
    left out. None when a third holds no update.
    """
    settle_s = max(lag_s, series.refresh_s() or 0.0) if source.primary == "power" else 0.0
    starts_s: list[float] = []
    lengths_s: list[float] = []
    pieces_w: list[float] = []
    for block_start_s, end_s in blocks:
        start_s = block_start_s + settle_s
        length_s = (end_s - start_s) / IDLE_PIECES
        for piece in range(IDLE_PIECES):
            from_s = start_s + piece * length_s
            if length_s <= 0 or series.update_count(from_s, from_s + length_s) == 0:
                return None
            energy_j = series.energy_j(from_s, from_s + length_s, source.primary)
            if energy_j is None:
                return None
            starts_s.append(from_s)
            lengths_s.append(length_s)
            pieces_w.append(energy_j / length_s)
    if len(pieces_w) < 2:
        return None
    share = drift.half_share([np.array(pieces_w)], np.array(starts_s), np.array(lengths_s), max(lengths_s))
    return two_stage_interval(pieces_w, len(pieces_w), least_half=share * float(np.mean(pieces_w)))


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
