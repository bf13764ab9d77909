"""A discharge trace played through the code path of a real gauge: for demonstrations and tests.

What it yields is labelled "replayed" everywhere and never accepted as a measurement.
"""

import csv
import json
import math
from bisect import bisect_right
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.errors import UsageError
from joulebox_agent.sources.packs import LOWEST_W
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport

BUNDLED_TRACE = "scripted_laptop_48wh.csv"
SHORTEST_POLL_S, LONGEST_POLL_S = 0.05, 0.5
SHORTEST_REFRESH_S, LONGEST_S = 0.001, 1e12  # a trace may well count its seconds from 1970
HIGHEST_W = 10_000.0


@dataclass(frozen=True)
class Trace:
    """Gauge readings over time: times_s ascending from 0, power_w >= 0, both of one length >= 2."""

    name: str
    times_s: tuple[float, ...]
    power_w: tuple[float, ...]

    @property
    def period_s(self) -> float:
        """Length of one round; the last reading is held as long as the one before it."""
        return self.times_s[-1] + (self.times_s[-1] - self.times_s[-2])


def read_trace(path: Path) -> Trace:
    """Reads t_s,power_w rows as CSV (with that header) or as NDJSON (.ndjson, .jsonl). Raises UsageError."""
    try:
        if path.exists() and not path.is_file():  # a device may never end
            raise UsageError(f"The trace {path} is no file; give one with rows of t_s,power_w.")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise UsageError(f"The trace {path} cannot be read: {getattr(error, 'strerror', None) or error}.") from error
    return parse_trace(text, path.name, as_json=path.suffix in (".ndjson", ".jsonl"))


def bundled_trace() -> Trace:
    """The trace that travels in the package: scripted after the thesis' laptop, see its first lines."""
    text = (files("joulebox_agent") / "traces" / BUNDLED_TRACE).read_text(encoding="utf-8")
    return parse_trace(text, BUNDLED_TRACE, as_json=False)


def parse_trace(text: str, name: str, as_json: bool) -> Trace:
    """The trace in `text`; lines that start with # are comments. Raises UsageError naming the row."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    times_s: list[float] = []
    power_w: list[float] = []
    start_s = 0.0
    try:
        rows = [json.loads(line, parse_int=float) for line in lines] if as_json else list(csv.DictReader(lines))
    except (ValueError, RecursionError, csv.Error) as error:
        raise UsageError(f"The trace {name} is not {'NDJSON' if as_json else 'CSV'}: {error}.") from error
    for number, row in enumerate(rows, start=1):
        try:
            t_s, p_w = float(row["t_s"]), float(row["power_w"])
        except (KeyError, TypeError, ValueError):
            raise UsageError(f"Row {number} of the trace {name} needs numbers t_s and power_w, not {row}.") from None
        if not (abs(t_s) <= LONGEST_S and 0 <= p_w <= HIGHEST_W):
            right = f"t_s must be within {LONGEST_S:g} s and power_w from 0 to {HIGHEST_W:g}"
            raise UsageError(f"Row {number} of the trace {name}: {right}.")
        if times_s and t_s - start_s <= times_s[-1]:
            raise UsageError(f"Row {number} of the trace {name}: t_s must grow from row to row.")
        start_s = start_s if times_s else t_s
        times_s.append(t_s - start_s)
        power_w.append(p_w)
    if len(times_s) < 2:
        raise UsageError(f"The trace {name} needs at least two rows of t_s,power_w.")
    return Trace(name, tuple(times_s), tuple(power_w))


class Replay:
    """Plays a trace in a loop from the moment it is first read.

    refresh_s  None: the trace's own rows are the gauge's refreshes. A number: the gauge refreshes that
               often, with the trace interpolated in between.
    """

    method = "replay"
    scope = "replayed"
    quality: Quality = "replayed"
    primary: Primary = "power"

    def __init__(self, trace: Trace, refresh_s: float | None = None, clock: Clock | None = None) -> None:
        if refresh_s is not None and not SHORTEST_REFRESH_S <= refresh_s <= LONGEST_S:
            raise UsageError(f"The refresh of a replay must be {SHORTEST_REFRESH_S:g} s or more, not {refresh_s:g}.")
        self.trace = trace
        self.refresh_s = refresh_s
        self._clock = clock or SystemClock()
        self._start_s: float | None = None
        shortest_s = refresh_s or min(b - a for a, b in zip(trace.times_s, trace.times_s[1:], strict=False))
        self.poll_s = min(LONGEST_POLL_S, max(SHORTEST_POLL_S, shortest_s / 2))

    def report(self) -> SourceReport:
        reason = f"plays {self.trace.name}; never accepted as a measurement"
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=True,
            power_w=self.trace.power_w[0],
            files=(self.trace.name,),
            reason=reason,
        )

    def read(self) -> Reading:
        now_s = self._clock.now_s()
        self._start_s = now_s if self._start_s is None else self._start_s
        elapsed_s = now_s - self._start_s
        if self.refresh_s is None:
            rounds, at_s = divmod(elapsed_s, self.trace.period_s)
            row = bisect_right(self.trace.times_s, at_s) - 1
            return _reading(self.trace.power_w[row], (rounds, row))
        tick = math.floor(elapsed_s / self.refresh_s)
        return _reading(self._interpolated(tick * self.refresh_s), (tick,))

    def _interpolated(self, elapsed_s: float) -> float:
        trace = self.trace
        at_s = elapsed_s % trace.period_s
        row = bisect_right(trace.times_s, at_s) - 1
        if row == len(trace.times_s) - 1:
            return trace.power_w[row]
        share = (at_s - trace.times_s[row]) / (trace.times_s[row + 1] - trace.times_s[row])
        return trace.power_w[row] + share * (trace.power_w[row + 1] - trace.power_w[row])


def _reading(power_w: float, raw: tuple[int | float, ...]) -> Reading:
    """What was recorded, judged as a gauge's own rate is: 0 W is a gauge that did not know."""
    if power_w < LOWEST_W:
        return Reading(raw=raw, problem=f"the recording says {power_w:.3g} W, which no machine draws")
    return Reading(power_w=power_w, raw=raw)
