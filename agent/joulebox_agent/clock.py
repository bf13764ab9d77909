"""Time as both ends of a pipe see it, and the check whether the machine slept.

`perf_counter` is CLOCK_MONOTONIC on Linux, the same in every process, so the renderer's times and the
agent's samples share one axis. Wall time is never used.
"""

import time
from typing import Protocol


class Clock(Protocol):
    """What measuring needs to know about time; tests hand in a scripted one."""

    def now_s(self) -> float:
        """Seconds on the axis of `time.perf_counter_ns()`."""

    def slept_s(self) -> float:
        """Seconds the machine has been suspended since boot, or 0.0 where that cannot be known."""


class SystemClock:
    """The clocks of this machine.

    Suspension shows as CLOCK_BOOTTIME running ahead of CLOCK_MONOTONIC on Linux. macOS has the pair
    mach_continuous_time / mach_absolute_time and Windows QueryInterruptTime / QueryUnbiasedInterruptTime;
    they belong here when those platforms get a source.
    """

    def now_s(self) -> float:
        return time.perf_counter_ns() / 1e9

    def slept_s(self) -> float:
        boot_clock = getattr(time, "CLOCK_BOOTTIME", None)
        if boot_clock is None:
            return 0.0
        return (time.clock_gettime_ns(boot_clock) - time.clock_gettime_ns(time.CLOCK_MONOTONIC)) / 1e9
