"""Energy of a stretch of time from the samples of a source: pure arithmetic, no clock, no files.

A gauge holds a value for 1 to 30 s and is polled more often than that, so what counts are its *updates*
(the raw numbers changed), not the polls.
"""

import numpy as np

from joulebox_agent.sampler import Sample
from joulebox_agent.sources.reading import Primary

HELD_TOO_LONG = 1.5  # refreshes after which an unchanged value was refreshed, not held
LONGEST_GAP_S = 10.0  # without a good sample, or three refreshes when that is longer


class PowerSeries:
    """The good samples of one source, reduced to updates. Times in seconds on the perf_counter axis."""

    def __init__(self, samples: list[Sample]) -> None:
        good = [s for s in samples if s.reading.problem is None and s.reading.refusal is None]
        self._good = good
        self._poll_times = np.array([s.time_s for s in good])
        self._updates = [
            sample
            for before, sample in zip([None, *good], good, strict=False)
            if before is None or before.reading.raw != sample.reading.raw
        ]

    def span_s(self) -> tuple[float, float] | None:
        """First and last good sample, None without any."""
        return (self._good[0].time_s, self._good[-1].time_s) if self._good else None

    def refresh_s(self) -> float | None:
        """Median time between updates; None with fewer than three, as the first is not seen to happen."""
        if len(self._updates) < 3:
            return None
        return float(np.median(np.diff([s.time_s for s in self._updates[1:]])))

    def node_s(self, primary: Primary) -> float | None:
        """Median time between the moments at which power (or the counter) is known; None with fewer than three."""
        if primary == "power":
            return self.refresh_s()
        times_s = [s.time_s for s in self._updates if s.reading.counter_j is not None]
        return float(np.median(np.diff(times_s))) if len(times_s) >= 3 else None

    def update_count(self, start_s: float, end_s: float) -> int:
        """Updates seen within a stretch (start excluded)."""
        return sum(start_s < s.time_s <= end_s for s in self._updates)

    def highest_w(self, start_s: float, end_s: float) -> float | None:
        """Largest power seen in a stretch, the value held at its start included."""
        held = [s.reading.power_w for s in self._good if s.time_s <= start_s and s.reading.power_w is not None]
        seen = [s.reading.power_w for s in self._good if start_s < s.time_s <= end_s]
        return max((p for p in [*held[-1:], *seen] if p is not None), default=None)

    def energy_j(self, start_s: float, end_s: float, primary: Primary) -> float | None:
        """Energy of [start_s, end_s] from the gauge ("power") or the counter; None when unknown."""
        if not self._covered(start_s, end_s):
            return None
        return self._integral_j(start_s, end_s) if primary == "power" else self._difference_j(start_s, end_s)

    def _covered(self, start_s: float, end_s: float) -> bool:
        """No stretch without a good sample is longer than a few refreshes."""
        if self._poll_times.size == 0:
            return False
        inside = self._poll_times[(self._poll_times > start_s) & (self._poll_times < end_s)]
        edges = np.concatenate([[start_s], inside, [end_s]])
        before = self._poll_times[self._poll_times <= start_s]
        after = self._poll_times[self._poll_times >= end_s]
        edges[0] = before[-1] if before.size else start_s
        edges[-1] = after[0] if after.size else end_s
        allowed_s = max(LONGEST_GAP_S, 3 * (self.refresh_s() or 0.0))
        return bool(np.diff(edges).max() <= allowed_s)

    def _power_nodes(self) -> tuple[list[float], list[float]]:
        """Times and watts of the updates. A value that outlives its refresh was confirmed: it gets a second
        node one refresh before the next update, or a plateau would be read as a ramp."""
        refresh_s = self.refresh_s()
        times_s: list[float] = []
        power_w: list[float] = []
        for sample in self._updates:
            if sample.reading.power_w is None:
                continue
            if times_s and refresh_s and sample.time_s - times_s[-1] > HELD_TOO_LONG * refresh_s:
                times_s.append(sample.time_s - refresh_s)
                power_w.append(power_w[-1])
            times_s.append(sample.time_s)
            power_w.append(sample.reading.power_w)
        return times_s, power_w

    def _integral_j(self, start_s: float, end_s: float) -> float | None:
        """Trapezoid over distinct updates, bridged to both edges; the last value is held to the end."""
        times_s, power_w = self._power_nodes()
        if not times_s:
            return None
        inner = [t for t in times_s if start_s < t < end_s]
        axis_s = np.array([start_s, *inner, end_s])
        return float(np.trapezoid(np.interp(axis_s, times_s, power_w), axis_s))

    def _difference_j(self, start_s: float, end_s: float) -> float | None:
        """Counter at the end minus counter at the start, each between the updates around it."""
        around = [s for s in self._good if start_s <= s.time_s <= end_s]
        before = [s for s in self._good if s.time_s < start_s][-1:]
        after = [s for s in self._good if s.time_s > end_s][:1]
        if len({s.reading.epoch for s in [*before, *around, *after]}) != 1:
            return None
        epoch = (around or before or after)[0].reading.epoch
        nodes = [s for s in self._updates if s.reading.epoch == epoch and s.reading.counter_j is not None]
        last = self._good[-1]
        if last.reading.epoch == epoch and last.reading.counter_j is not None and last is not nodes[-1]:
            nodes.append(last)
        counters_j = [s.reading.counter_j or 0.0 for s in nodes]
        if not counters_j:
            return None
        at_start, at_end = np.interp([start_s, end_s], [s.time_s for s in nodes], counters_j)
        return float(at_end - at_start)
