"""An estimate, not a measurement: CPU seconds times watts per CPU second that the user states, with their range.

Opt-in only, labelled "estimated" everywhere, never chosen by auto and never ranked with measurements.
"""

import math
from collections.abc import Callable

import psutil

from joulebox_agent.errors import UsageError
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport

NAME = "estimate_cpu_time"
USAGE = "needs watts per CPU second with their range, low,value,high, as in estimate_cpu_time:6,10,15"
IDLE_TIMES = ("idle", "iowait", "steal", "guest", "guest_nice")  # guest is inside user, steal is another machine's


def busy_cpu_s() -> float:
    """CPU seconds that all processes of this machine have used since it started."""
    times = psutil.cpu_times()
    return float(sum(times) - sum(getattr(times, name, 0.0) for name in IDLE_TIMES))


class EstimateCpuTime:
    """Joules from CPU seconds.

    low_w, value_w, high_w  watts per CPU second [W], 0 < low <= value <= high; None: nothing was stated
    busy_s                  CPU seconds of the whole machine so far
    """

    method = NAME
    scope = "CPU work of all processes"
    quality: Quality = "estimated"
    primary: Primary = "counter"
    poll_s = 0.5

    def __init__(
        self, watts: tuple[float, float, float] | None = None, busy_s: Callable[[], float] = busy_cpu_s
    ) -> None:
        self.watts = watts
        self._busy_s = busy_s
        self._first_s: float | None = None

    def report(self) -> SourceReport:
        if self.watts is None:
            return SourceReport(method=NAME, scope=self.scope, available=False, reason=USAGE, remedy="opt-in only")
        low_w, value_w, high_w = self.watts
        return SourceReport(
            method=NAME,
            scope=self.scope,
            available=True,
            scale_range=(low_w / value_w, high_w / value_w),
            resolution_j=0.01 * value_w,  # systems count CPU time in hundredths of a second
            files=("psutil.cpu_times()",),
            reason=f"an estimate: {value_w:g} W per CPU second as stated, {low_w:g} to {high_w:g}",
        )

    def read(self) -> Reading:
        if self.watts is None:
            return Reading(problem=USAGE)
        now_s = self._busy_s()
        self._first_s = now_s if self._first_s is None else self._first_s
        return Reading(counter_j=max(0.0, now_s - self._first_s) * self.watts[1], raw=(now_s,))


def parse_estimate(name: str) -> EstimateCpuTime:
    """`estimate_cpu_time:LOW,VALUE,HIGH` in watts per CPU second. Raises UsageError."""
    text = name.removeprefix(NAME).removeprefix(":")
    if not text:
        return EstimateCpuTime()
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)) or not 0 < numbers[0] <= numbers[1] <= numbers[2]:
        raise UsageError(f"{name!r} {USAGE}.")
    return EstimateCpuTime((numbers[0], numbers[1], numbers[2]))
