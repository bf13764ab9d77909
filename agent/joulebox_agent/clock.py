"""Time as both ends of a pipe see it, and the check whether the machine slept.

`perf_counter` is CLOCK_MONOTONIC on Linux, the same in every process, so the renderer's times and the
agent's samples share one axis. Wall time is never used.
"""

import sys
import time
from typing import Protocol


class Clock(Protocol):
    """What measuring needs to know about time; tests hand in a scripted one."""

    def now_s(self) -> float:
        """Seconds on the axis of `time.perf_counter_ns()`."""

    def slept_s(self) -> float:
        """Seconds the machine has been suspended since boot, or 0.0 where that cannot be known."""


class SystemClock:
    """The clocks of this machine. Suspension is the difference of a clock that ticks through it and one that stops."""

    def now_s(self) -> float:
        return time.perf_counter_ns() / 1e9

    def slept_s(self) -> float:
        return _slept_s()


if sys.platform == "win32":
    import ctypes

    _realtime = ctypes.WinDLL("api-ms-win-core-realtime-l1-1-1.dll")

    def _slept_s() -> float:
        """QueryInterruptTime counts sleep, QueryUnbiasedInterruptTime does not; both in units of 100 ns."""
        biased, unbiased = ctypes.c_ulonglong(), ctypes.c_ulonglong()
        _realtime.QueryUnbiasedInterruptTime(ctypes.byref(unbiased))
        _realtime.QueryInterruptTime(ctypes.byref(biased))
        return (biased.value - unbiased.value) / 1e7
elif sys.platform == "darwin":

    def _slept_s() -> float:
        """mach_continuous_time counts sleep, mach_absolute_time does not; these are their names in POSIX."""
        return (time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW) - time.clock_gettime_ns(time.CLOCK_UPTIME_RAW)) / 1e9
else:

    def _slept_s() -> float:
        """CLOCK_BOOTTIME counts sleep, CLOCK_MONOTONIC does not."""
        boot_clock = getattr(time, "CLOCK_BOOTTIME", None)
        if boot_clock is None:
            return 0.0
        return (time.clock_gettime_ns(boot_clock) - time.clock_gettime_ns(time.CLOCK_MONOTONIC)) / 1e9
