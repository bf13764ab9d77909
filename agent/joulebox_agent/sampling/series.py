"""Energy of a stretch of time from the samples of a source: pure arithmetic, no clock, no files.

A gauge holds a value for 1 to 30 s and is polled more often than that, so what counts are its *updates*,
not the polls. Power and counter of one pack are refreshed apart, so each has updates of its own; and an update
that repeats a coarse value cannot be seen: it is inferred from the time that has passed.
"""

import numpy as np
from numpy.typing import NDArray

from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sources.reading import Primary

Floats = NDArray[np.float64]
HELD_TOO_LONG = 1.5  # refreshes after which an unchanged value was refreshed, not held
# What may pass without a good sample: three polls, or as many refreshes as fit into a tenth of the stretch.
LEAST_GAP_S, GAP_POLLS, GAP_REFRESHES, GAP_SHARE = 2.0, 3, 3, 0.1
CLOSEST = 0.1  # of the spacings, from the shortest on, that may be a look out of turn
FEWEST_CHANGES = 4  # of the power, below which its refresh is told by the other raw numbers
UWH_J = 3.6e-3  # a microwatt-hour, the unit that energy counters are told in
WHOLE = 0.01  # that a whole number of these may be off by rounding
FEWEST_MOVES = 8  # of a counter that all have a common divisor by chance once in 2^8
RECENT_STEPS = 8  # of a counter, whose rate carries it on after the last one
TORN = 0.5  # refreshes; a power that stood shorter than this was read while the packs were being updated
TORN_POLLS = 4  # a refresh must hold this many polls before anything in it can be called torn


class PowerSeries:
    """The good samples of one source, reduced to updates. Times in seconds on the perf_counter axis."""

    def __init__(self, samples: list[Sample]) -> None:
        good = [s for s in samples if s.reading.problem is None and s.reading.refusal is None]
        self._good = good
        self.poll_times_s: Floats = np.array([s.time_s for s in good])
        self._seen_s = np.array(
            [
                sample.time_s
                for before, sample in zip([None, *good], good, strict=False)
                if before is None or before.reading.raw != sample.reading.raw
            ]
        )
        self._poll_s = float(np.median(np.diff(self.poll_times_s))) if len(good) > 1 else 0.0
        self._counters = _counter_nodes(good)
        self._powers = [(s.time_s, s.reading.power_w) for s in good if s.reading.power_w is not None]
        changes = _changes(self._powers)
        self._changes_s, self._changes_w = np.array([t for t, _ in changes]), np.array([p for _, p in changes])
        self._refresh_s = self._measured_refresh_s()
        self._drop_torn()
        self.node_times_s, self.node_powers_w = self._power_nodes()

    def span_s(self) -> tuple[float, float] | None:
        """First and last good sample, None without any."""
        return (self._good[0].time_s, self._good[-1].time_s) if self._good else None

    def refresh_s(self) -> float | None:
        """Time between updates; None with fewer than three, as the first is not seen to happen."""
        return self._refresh_s

    def _measured_refresh_s(self) -> float | None:
        """The spacing of the closest updates: longer ones skip repeated values.

        Changes of the power tell it where there are enough; other raw numbers may move at a pace of their own. A look
        out of turn (a window's edge) sees an update early and splits a spacing in two: no update is counted between.
        """
        times_s = self._changes_s if self._changes_s.size > FEWEST_CHANGES else self._seen_s
        gaps_s = np.diff(times_s[1:])
        if gaps_s.size < 1 or times_s.size < 3:
            return None
        closest_s = max(self._poll_s, float(np.quantile(gaps_s, CLOSEST, method="inverted_cdf")))
        near_s = gaps_s[gaps_s < 1.9 * closest_s]
        whole = int((near_s >= closest_s / 2).sum())
        return float(near_s.sum()) / whole if whole else closest_s

    def _drop_torn(self) -> None:
        """Forgets powers that stood for less than half a refresh: read while one pack was ahead of the other."""
        if self._refresh_s is None or self._changes_s.size < FEWEST_CHANGES or self.poll_times_s.size < 2:
            return
        if self._refresh_s < TORN_POLLS * self._poll_s:
            return
        stood_s = np.append(np.diff(self._changes_s), np.inf)
        stood_s[0] = np.inf  # the first was not seen to begin
        whole = stood_s >= TORN * self._refresh_s
        # the value after a torn one began when the torn one did
        began_s = np.where(np.append(True, whole[:-1]), self._changes_s, np.append(0.0, self._changes_s[:-1]))
        self._changes_s, self._changes_w = began_s[whole], self._changes_w[whole]

    def _power_nodes(self) -> tuple[Floats, Floats]:
        """Times and watts of all updates, those included that repeated a value and could not be seen."""
        times_s: list[float] = []
        power_w: list[float] = []
        for begin_s, end_s, watts in self.holds():
            times_s.append(begin_s)
            power_w.append(watts)
            if self._refresh_s and end_s - begin_s > HELD_TOO_LONG * self._refresh_s:
                repeats = round((end_s - begin_s) / self._refresh_s) - 1
                times_s += [end_s - self._refresh_s * back for back in range(repeats, 0, -1)]
                power_w += [watts] * repeats
        return np.array(times_s), np.array(power_w)

    def node_s(self, primary: Primary) -> float | None:
        """Typical time between the moments at which power (or the counter) is known; None with fewer than three."""
        if primary == "power":
            return self._refresh_s
        gaps_s = [gap_s for times_s, _ in self._counters.values() for gap_s in np.diff(times_s)]
        return float(np.median(gaps_s)) if len(gaps_s) >= 2 else None

    def counter_step_j(self) -> float | None:
        """What the counter moves by at a time [J], as seen; None with fewer than three movements."""
        steps_j = [step for _, counts_j in self._counters.values() for step in np.diff(counts_j) if step > 0]
        return float(np.median(steps_j)) if len(steps_j) >= 3 else None

    def counter_quantum_j(self) -> float | None:
        """What all movements of the counter are multiples of [J]; None where they are too few to tell, or no whole uWh
        as of a charge times a voltage."""
        # without the last one, which is carried on to the last sample
        seen = [np.diff(counts_j)[:-1] for _, counts_j in self._counters.values()]
        moves_uwh = np.concatenate(seen or [np.empty(0)]) / UWH_J
        whole = np.round(moves_uwh)
        if whole.size < FEWEST_MOVES or float(np.abs(moves_uwh - whole).max()) > WHOLE:
            return None
        return float(np.gcd.reduce(whole.astype(np.int64))) * UWH_J or None

    def holds(self) -> list[tuple[float, float, float]]:
        """Every power that was shown: (from_s, to_s, watts); the last one to the last sample."""
        ends_s = [*self._changes_s[1:], self._powers[-1][0]] if self._changes_s.size else []
        return [
            (float(t), float(e), float(p)) for t, e, p in zip(self._changes_s, ends_s, self._changes_w, strict=True)
        ]

    def update_count(self, start_s: float, end_s: float) -> int:
        """Updates within a stretch (start excluded): of the power where there is one, else of any raw number."""
        times_s = self.node_times_s if self.node_times_s.size > 1 else self._seen_s
        return int(((times_s > start_s) & (times_s <= end_s)).sum())

    def highest_w(self, start_s: float, end_s: float) -> float | None:
        """Largest power seen in a stretch, the value held at its start included."""
        held = [p for t, p in self._powers if t <= start_s]
        seen = [p for t, p in self._powers if start_s < t <= end_s]
        return max([*held[-1:], *seen], default=None)

    def energy_j(self, start_s: float, end_s: float, primary: Primary, lag_s: float = 0.0) -> float | None:
        """Energy of [start_s, end_s] from the gauge ("power") or the counter; None when unknown.

        lag_s  the gauge shows the mean of this many seconds before each update, so the power of a moment is
               shown half of it later; 0 for a counter
        """
        if not self.covered(start_s, end_s):
            return None
        if primary == "counter":
            return self._difference_j(start_s, end_s)
        return self._integral_j(start_s + lag_s / 2, end_s + lag_s / 2)

    def longest_gap_s(self, start_s: float, end_s: float) -> float:
        """Longest time without a good sample in or across the edges of a stretch [s]; inf without any sample."""
        if self.poll_times_s.size == 0:
            return float("inf")
        first = max(0, int(np.searchsorted(self.poll_times_s, start_s, "right")) - 1)
        last = min(self.poll_times_s.size, int(np.searchsorted(self.poll_times_s, end_s, "left")) + 1)
        inside_s = self.poll_times_s[first:last]
        edges_s = (
            [min(start_s, inside_s[0]), *inside_s, max(end_s, inside_s[-1])] if inside_s.size else [start_s, end_s]
        )
        return float(np.diff(edges_s).max())

    def covered(self, start_s: float, end_s: float) -> bool:
        """No time without a good sample is long enough to matter to the energy of the stretch."""
        tenth_s = GAP_SHARE * (end_s - start_s)
        refreshes_s = min(GAP_REFRESHES * self._refresh_s, tenth_s) if self._refresh_s else tenth_s
        return self.longest_gap_s(start_s, end_s) <= max(LEAST_GAP_S, GAP_POLLS * self._poll_s, refreshes_s)

    def _integral_j(self, start_s: float, end_s: float) -> float | None:
        """Trapezoid over updates, bridged to both edges; the last value is held to the end."""
        times_s, power_w = self.node_times_s, self.node_powers_w
        if not times_s.size:
            return None
        inner = times_s[(times_s > start_s) & (times_s < end_s)]
        axis_s = np.concatenate([[start_s], inner, [end_s]])
        return float(np.trapezoid(np.interp(axis_s, times_s, power_w), axis_s))

    def epochs(self, start_s: float, end_s: float) -> set[int]:
        """Epochs of the counter in a stretch and in the samples on either side of it."""
        first = max(0, int(np.searchsorted(self.poll_times_s, start_s, "left")) - 1)
        last = min(self.poll_times_s.size, int(np.searchsorted(self.poll_times_s, end_s, "right")) + 1)
        return {s.reading.epoch for s in self._good[first:last]}

    def _difference_j(self, start_s: float, end_s: float) -> float | None:
        """Counter at the end minus counter at the start, each between the updates around it."""
        epochs = self.epochs(start_s, end_s)
        if len(epochs) != 1:
            return None
        times_s, counts_j = self._counters.get(epochs.pop(), (np.empty(0), np.empty(0)))
        if not times_s.size:
            return None
        at_start, at_end = np.interp([start_s, end_s], times_s, counts_j)
        return float(at_end - at_start)


def _counter_nodes(good: list[Sample]) -> dict[int, tuple[Floats, Floats]]:
    """By epoch: times and joules at which the counter moved, and where it must stand at the last sample."""
    readings: dict[int, list[tuple[float, float]]] = {}
    for sample in good:
        if sample.reading.counter_j is not None:
            readings.setdefault(sample.reading.epoch, []).append((sample.time_s, sample.reading.counter_j))
    found = {}
    for epoch, values in readings.items():
        nodes = _changes(values)
        if nodes[-1][0] < values[-1][0]:
            nodes.append(_since_last_step(nodes[-1 - RECENT_STEPS :], values[-1][0]))
        found[epoch] = (np.array([t for t, _ in nodes]), np.array([count_j for _, count_j in nodes]))
    return found


def _since_last_step(nodes: list[tuple[float, float]], at_s: float) -> tuple[float, float]:
    """A counter between two steps has used more than it says: on at its recent rate, by less than one step."""
    (first_s, first_j), (last_s, last_j) = nodes[0], nodes[-1]
    if last_s <= first_s:
        return at_s, last_j
    rate_w, step_j = (last_j - first_j) / (last_s - first_s), (last_j - first_j) / (len(nodes) - 1)
    return at_s, last_j + min(rate_w * (at_s - last_s), step_j)


def _changes(values: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The (time, value) at which the value differs from the one before, the first included."""
    return [
        pair for before, pair in zip([None, *values], values, strict=False) if before is None or before[1] != pair[1]
    ]
