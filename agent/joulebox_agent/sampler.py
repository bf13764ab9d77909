"""A thread that looks at an energy source at a modest rate and remembers what it saw."""

import json
import threading
import time
from dataclasses import dataclass

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.sources.reading import EnergySource, Reading

SENSOR_LOST_AFTER_S = 15.0
SLEPT_AT_LEAST_S = 0.1


@dataclass(frozen=True)
class Sample:
    """A reading and when it was taken [s on the perf_counter axis]."""

    time_s: float
    reading: Reading


class Sampler:
    """Polls `source` every `source.poll_s`; touches neither disk nor network.

    `trouble()` says what voids a measurement: the source refused (mains appeared), the machine slept,
    or no good sample came for `lost_after_s`.
    """

    def __init__(
        self, source: EnergySource, clock: Clock | None = None, lost_after_s: float = SENSOR_LOST_AFTER_S
    ) -> None:
        self.source = source
        self.clock: Clock = clock or SystemClock()
        self.start_s = self.clock.now_s()
        self._lost_after_s = lost_after_s
        self._slept_before_s = self.clock.slept_s()
        self._samples: list[Sample] = []
        self._last_good_s = self.start_s
        self._trouble: str | None = None
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._poll, name="sampler", daemon=True)
        self._cpu_s = 0.0

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread. Samples stay."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def pause(self, seconds: float) -> None:
        """Waits, or returns at once when the sampler was stopped."""
        self._ended.wait(seconds)

    def sample(self) -> None:
        """Takes one sample now: the poll's own step, and what a caller does at the edge of a window."""
        with self._lock:
            reading = self.source.read()
            now_s = self.clock.now_s()
            self._samples.append(Sample(now_s, reading))
            self._judge(now_s, reading)

    def _judge(self, now_s: float, reading: Reading) -> None:
        if reading.problem is None and reading.refusal is None:
            self._last_good_s = now_s
        if self._trouble is not None:
            return
        at = f"at {now_s - self.start_s:.1f} s"
        slept_s = self.clock.slept_s() - self._slept_before_s
        if slept_s > SLEPT_AT_LEAST_S:
            self._trouble = f"the machine slept for {slept_s:.1f} s, noticed {at}"
        elif reading.refusal is not None:
            self._trouble = f"{reading.refusal} {at}"
        elif now_s - self._last_good_s > self._lost_after_s:
            self._trouble = f"the sensor was lost {at} ({reading.problem})"

    def trouble(self) -> str | None:
        """Why the measurement is void since some moment, or None."""
        return self._trouble

    def samples(self) -> list[Sample]:
        """A copy of all samples so far, oldest first."""
        with self._lock:
            return list(self._samples)

    def cpu_share(self) -> float:
        """CPU time of the sampling thread as a share of one core since the start."""
        elapsed_s = self.clock.now_s() - self.start_s
        return self._cpu_s / elapsed_s if elapsed_s > 0 else 0.0

    def _poll(self) -> None:
        while not self._ended.is_set():
            self.sample()
            self._cpu_s = time.thread_time()
            self._ended.wait(self.source.poll_s)


def samples_ndjson(samples: list[Sample], start_s: float) -> bytes:
    """Samples as one JSON object a line, times relative to `start_s`; the blob a result names."""
    lines = []
    for sample in samples:
        reading = sample.reading
        line: dict[str, object] = {"time_s": round(sample.time_s - start_s, 6), "power_w": reading.power_w}
        if reading.counter_j is not None:
            line |= {"counter_j": reading.counter_j, "epoch": reading.epoch}
        if reading.problem or reading.refusal:
            line["problem"] = reading.refusal or reading.problem
        lines.append(json.dumps(line))
    return ("\n".join(lines) + "\n").encode() if lines else b""
