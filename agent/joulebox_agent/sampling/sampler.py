"""What is read from an energy source over time, who reads it, and what voids it."""

import json
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.sampling.watch import FaultWatch, Patience
from joulebox_agent.sources.reading import EnergySource, Reading

SENSOR_LOST_AFTER_S = Patience().lost_s
HIGHEST_CPU_SHARE = 0.005  # of one core, for a sampler that does not disturb what it measures


@dataclass(frozen=True)
class Sample:
    """A reading and when it was taken [s on the perf_counter axis]; slept_s: suspended since boot, by then."""

    time_s: float
    reading: Reading
    slept_s: float = 0.0


class Sampling(Protocol):
    """Whoever reads a source while something else runs.

    start_s  when it was made: the zero of every sentence about time
    """

    start_s: float

    def start(self) -> None:
        """Begins to read. Raises SourceUnavailableError when the source cannot be read."""

    def stop(self) -> None:
        """Ends the reading; samples stay. Safe to call again."""

    def pause(self, seconds: float) -> None:
        """Waits, whether it reads meanwhile or not: a charge takes hours, in which nothing is sampled."""

    def sample(self) -> None:
        """One sample now, there when this returns: a fast counter is to be known at a window's edge."""

    def samples(self) -> list[Sample]:
        """All samples so far, oldest first."""

    def companion_samples(self) -> list[Sample]:
        """Samples of the second source that is read along for calibration; empty without one."""

    def void_reason(self, start_s: float, end_s: float) -> str | None:
        """Why a stretch of time must not be used, or None."""

    def trouble(self) -> str | None:
        """Why nothing more can be measured, or None."""

    def cpu_share(self) -> float:
        """CPU time of the sampling as a share of one core since it began."""


class SampleLog:
    """Samples with what the watch makes of them; one thread writes, any may ask."""

    def __init__(self, start_s: float, watch: FaultWatch) -> None:
        self.start_s = start_s
        self._samples: list[Sample] = []
        self._companions: list[Sample] = []
        self._watch = watch
        self._lock = threading.Lock()

    def samples(self) -> list[Sample]:
        with self._lock:
            return list(self._samples)

    def companion_samples(self) -> list[Sample]:
        with self._lock:
            return list(self._companions)

    def void_reason(self, start_s: float, end_s: float) -> str | None:
        with self._lock:
            return self._watch.over(start_s, end_s)

    def trouble(self) -> str | None:
        with self._lock:
            return self._watch.end()

    def _keep(self, sample: Sample) -> None:
        with self._lock:
            self._samples.append(sample)
            self._watch.add(sample.time_s, sample.slept_s, sample.reading)

    def _keep_companion(self, sample: Sample) -> None:
        with self._lock:
            self._companions.append(sample)


class Sampler(SampleLog):
    """Polls `source` every `source.poll_s` in a thread of this process; touches neither disk nor network.

    For sources that exist in this process only and for clocks that are not the machine's; a measurement of
    this machine samples in a process of its own (`SamplerProcess`).
    """

    def __init__(
        self, source: EnergySource, clock: Clock | None = None, lost_after_s: float = SENSOR_LOST_AFTER_S
    ) -> None:
        self.source = source
        self.clock: Clock = clock or SystemClock()
        start_s = self.clock.now_s()
        super().__init__(start_s, FaultWatch(start_s, source.poll_s, source.primary, Patience(lost_s=lost_after_s)))
        self._reading = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._poll, name="sampler", daemon=True)
        self._cpu_s = 0.0

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def pause(self, seconds: float) -> None:
        time.sleep(seconds)

    def sample(self) -> None:
        """Takes one sample now: the poll's own step, and what a caller does at the edge of a window."""
        with self._reading:
            reading = self.source.read()
            self._keep(Sample(self.clock.now_s(), reading, self.clock.slept_s()))

    def cpu_share(self) -> float:
        elapsed_s = self.clock.now_s() - self.start_s
        return self._cpu_s / elapsed_s if elapsed_s > 0 else 0.0

    def _poll(self) -> None:
        while not self._ended.is_set():
            self.sample()
            self._cpu_s = time.thread_time()
            self._ended.wait(self.source.poll_s)


def samples_ndjson(samples: Sequence[Sample], start_s: float) -> bytes:
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
