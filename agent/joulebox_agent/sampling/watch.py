"""From samples, as they come, to the stretches of time that void a window, and to the end of all measuring.

A fault voids the windows that it touches and the measurement goes on; only what will not pass ends it: mains
that stays, a sensor that is gone. What no single sample shows (a frozen gauge) is in faults.py.
"""

import math
from dataclasses import dataclass, replace

from joulebox_agent.sources.reading import Primary, Reading

SLEPT_AT_LEAST_S = 0.1
UNREAD_AFTER_S = 10.0  # no good sample for so long leaves the power between two of them unknown
STOOD_STILL_S = 5.0  # between two polls; a loaded machine delays them by far less


@dataclass(frozen=True)
class Patience:
    """How long a trouble may last before it ends the measurement rather than a window [s].

    lost_s     the sensor answers nothing but errors
    refused_s  mains is online, or nothing discharges
    """

    lost_s: float = 60.0
    refused_s: float = 3.0


@dataclass(frozen=True)
class Fault:
    """A stretch that voids every window it overlaps; it lasts still while `end_s` is infinite."""

    start_s: float
    end_s: float
    reason: str


class FaultWatch:
    """Judges samples in the order they come. Times in seconds on the perf_counter axis.

    start_s   when sampling began; the sentences count from there
    poll_s    the source's polling interval
    primary   what gives the energy: a counter that starts anew matters where it does
    """

    def __init__(self, start_s: float, poll_s: float, primary: Primary, patience: Patience | None = None) -> None:
        self._start_s, self._primary = start_s, primary
        self._still_s = max(STOOD_STILL_S, 10 * poll_s)
        self._patience = patience or Patience()
        self._faults: list[Fault] = []
        self._open: Fault | None = None
        self._last: tuple[float, float] | None = None  # time and time slept at the last sample
        self._good_s = start_s
        self._bad: Reading | None = None  # the reading since which nothing good came
        self._raw: tuple[int | float, ...] | None = None
        self._epoch = 0
        self._end: str | None = None

    def add(self, time_s: float, slept_s: float, reading: Reading) -> None:
        """Takes the next sample: its time, seconds the machine has slept since boot, and what was read."""
        if self._last is not None:
            self._judge_time(*self._last, time_s, slept_s)
        self._last = (time_s, slept_s)
        if reading.refusal is not None or reading.problem is not None:
            self._judge_bad(time_s, reading)
            return
        if self._bad is not None:
            self._close(time_s)
            self._bad = None
        self._judge_packs(time_s, reading)
        self._good_s = time_s
        self._raw, self._epoch = reading.raw, reading.epoch

    def void(self, start_s: float, end_s: float, reason: str) -> None:
        """Adds a stretch that somebody else knows to be bad (the sampler's own death)."""
        self._faults.append(Fault(start_s, end_s, reason))

    def over(self, start_s: float, end_s: float) -> str | None:
        """Why the stretch is void, or None."""
        faults = self._faults if self._open is None else [*self._faults, self._open]
        return next((f.reason for f in faults if f.start_s < end_s and f.end_s > start_s), None)

    def end(self) -> str | None:
        """Why nothing more can be measured, or None."""
        return self._end

    def _at(self, time_s: float) -> str:
        return f"at {time_s - self._start_s:.1f} s"

    def _judge_time(self, last_s: float, last_slept_s: float, time_s: float, slept_s: float) -> None:
        if slept_s - last_slept_s > SLEPT_AT_LEAST_S:
            reason = f"the machine slept for {slept_s - last_slept_s:.1f} s, noticed {self._at(time_s)}"
        elif time_s < last_s:
            reason = f"the clock went back by {last_s - time_s:.1f} s {self._at(last_s)}"
        elif time_s - last_s > self._still_s:
            reason = f"nothing was read for {time_s - last_s:.1f} s {self._at(last_s)}: the machine stood still"
        else:
            return
        self.void(min(last_s, time_s), max(last_s, time_s), reason)

    def _judge_bad(self, time_s: float, reading: Reading) -> None:
        """A refusal voids from the last good sample on; errors do when they last too long to bridge."""
        if self._bad is None:
            self._bad = reading
        lasted_s = time_s - self._good_s
        refused = reading.refusal is not None
        reason = f"{reading.refusal or reading.problem} {self._at(time_s)}"
        if (refused or lasted_s > UNREAD_AFTER_S) and self._open is None:
            self._open = Fault(self._good_s, math.inf, reason)
        if self._end is not None:
            return
        if refused and lasted_s > self._patience.refused_s:
            self._end = reason
        elif not refused and lasted_s > self._patience.lost_s:
            self._end = f"the sensor was lost {self._at(time_s)} ({reading.problem})"

    def _judge_packs(self, time_s: float, reading: Reading) -> None:
        """A counter that starts anew is worth nothing across that moment; one that does so over other files than
        before was a pack pulled out or put in, which a gauge cannot bridge either."""
        if self._raw is None or reading.epoch == self._epoch:
            return
        if len(reading.raw) != len(self._raw):
            self.void(self._good_s, time_s, f"the set of batteries changed {self._at(time_s)}")
        elif self._primary == "counter":
            self.void(self._good_s, time_s, f"the counter lost its thread {self._at(time_s)}")

    def _close(self, time_s: float) -> None:
        if self._open is not None:
            self._faults.append(replace(self._open, end_s=time_s))
            self._open = None
