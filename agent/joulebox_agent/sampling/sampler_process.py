"""Sampling in a process of its own, seen from the process that measures."""

import contextlib
import json
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import IO

from joulebox_agent.clock import SystemClock
from joulebox_agent.errors import SourceUnavailableError
from joulebox_agent.sampling.sampler import SENSOR_LOST_AFTER_S, Sample, SampleLog
from joulebox_agent.sampling.sampler_child import decode
from joulebox_agent.sampling.watch import FaultWatch, Patience
from joulebox_agent.sources.choose import Choice, choose

READY_WITHIN_S = 30.0
ANSWER_WITHIN_S = 2.0
END_WITHIN_S = 5.0
STARTS = 2  # a sampler that dies is started again, once


class SamplerProcess(SampleLog):
    """A sampler behind two pipes. It is started again once if it dies; a second death is trouble.

    choice     what to read; the child makes it anew from its name
    companion  a second source, read along for calibration
    """

    def __init__(
        self,
        choice: Choice,
        sysfs_root: Path = Path("/sys"),
        companion: str | None = None,
        lost_after_s: float = SENSOR_LOST_AFTER_S,
    ) -> None:
        self._clock = SystemClock()
        source, start_s = choice.source, self._clock.now_s()
        watch = FaultWatch(start_s, source.poll_s, source.primary, Patience(lost_s=lost_after_s))
        super().__init__(start_s, watch)
        words = [choice.name, str(sysfs_root), *([companion] if companion else [])]
        self._command = [sys.executable, "-m", "joulebox_agent.sampling.sampler_child", *words]
        self._method = source.method
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        self._news = threading.Condition()
        self._ended = threading.Event()
        self._starts = 0
        self._epoch = 0  # added to the child's own: a counter that was begun anew shares nothing with the last
        self._died: str | None = None
        self._earlier_cpu_s = self._child_cpu_s = self._reader_cpu_s = 0.0

    def start(self) -> None:
        self._launch()
        self.sample()

    def stop(self) -> None:
        self._ended.set()
        process = self._process
        if process is not None:
            assert process.stdin is not None
            try:
                process.stdin.close()
                process.wait(END_WITHIN_S)
            except (OSError, subprocess.TimeoutExpired):
                process.kill()
                process.wait()
        if self._reader is not None:
            self._reader.join(END_WITHIN_S)

    def pause(self, seconds: float) -> None:
        time.sleep(seconds)

    def sample(self) -> None:
        asked_s = self._clock.now_s()
        process = self._process
        if process is None or process.stdin is None:
            return
        try:
            process.stdin.write("\n")
            process.stdin.flush()
        except (OSError, ValueError):
            return  # it died: the reader knows and acts
        with self._news:
            self._news.wait_for(lambda: self._latest_s() >= asked_s or self._died, ANSWER_WITHIN_S)

    def trouble(self) -> str | None:
        return super().trouble() or self._died

    def cpu_share(self) -> float:
        """The child's CPU time and our own for reading its lines, as a share of one core."""
        elapsed_s = self._clock.now_s() - self.start_s
        return self.cpu_s() / elapsed_s if elapsed_s > 0 else 0.0

    def cpu_s(self) -> float:
        """CPU time spent on sampling since the source was made [s]."""
        return self._earlier_cpu_s + self._child_cpu_s + self._reader_cpu_s

    @property
    def pid(self) -> int | None:
        """Of the sampling process."""
        return self._process.pid if self._process is not None else None

    def _latest_s(self) -> float:
        with self._lock:
            return self._samples[-1].time_s if self._samples else -1.0

    def _launch(self) -> None:
        """Starts the child and waits until it has made its source. Raises SourceUnavailableError."""
        self._starts += 1
        try:
            # a session of its own: Ctrl-C is for the agent, which then ends its sampler in order
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                encoding="utf-8", start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise SourceUnavailableError(f"The sampler cannot be started: {error.strerror}.") from error
        assert self._process.stdout is not None
        timer = threading.Timer(READY_WITHIN_S, self._process.kill)
        timer.start()
        try:
            first = self._process.stdout.readline()
        except BaseException:  # Ctrl-C, while the child is still on its way
            _end(self._process)
            raise
        finally:
            timer.cancel()  # no program ends before its timers
        try:
            told = json.loads(first)
        except ValueError:
            told = {"error": f"it left with code {self._process.wait()}"}
        if "error" in told or told["method"] != self._method:
            _end(self._process)
            reason = told.get("error") or f"it found {told['method']} where {self._method} was"
            raise SourceUnavailableError(f"The sampler cannot read {self._method}: {reason}")
        self._reader = threading.Thread(target=self._read, args=(self._process,), name="samples", daemon=True)
        self._reader.start()

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        began_s, before_s = time.thread_time(), self._reader_cpu_s
        with process.stdout as stream:
            self._read_lines(stream, began_s, before_s)
        if not self._ended.is_set():
            code = process.wait()
            _end(process)
            self._restart(code)

    def _read_lines(self, stream: IO[str], began_s: float, before_s: float) -> None:
        for line in stream:
            try:
                index, sample, cpu_s = decode(line)
            except (ValueError, TypeError):
                continue  # a line that a kill cut short
            sample = self._ours(sample)
            if index == 0:
                self._keep(sample)
            else:
                self._keep_companion(sample)
            self._child_cpu_s, self._reader_cpu_s = cpu_s, before_s + time.thread_time() - began_s
            with self._news:
                self._news.notify_all()

    def _ours(self, sample: Sample) -> Sample:
        return replace(sample, reading=replace(sample.reading, epoch=self._epoch + sample.reading.epoch))

    def _restart(self, code: int) -> None:
        """The child died: once it is made anew, and the time without it is void."""
        with self._lock:
            last = self._samples[-1] if self._samples else None
        last_s = last.time_s if last else self.start_s
        self._epoch = (last.reading.epoch if last else 0) + 1
        self._earlier_cpu_s, self._child_cpu_s = self._earlier_cpu_s + self._child_cpu_s, 0.0
        at = f"at {last_s - self.start_s:.1f} s"
        try:
            if self._starts >= STARTS:
                raise SourceUnavailableError(f"the sampler died again {at} (code {code})")
            self._launch()
            if self._ended.is_set() and self._process is not None:  # we were told to stop meanwhile
                _end(self._process)
        except SourceUnavailableError as error:
            with self._news:
                self._died = str(error)
                self._news.notify_all()
            return
        with self._lock:
            self._watch.void(last_s, self._clock.now_s(), f"the sampler died {at} (code {code}) and was started again")


def _end(process: subprocess.Popen[str]) -> None:
    """Ends a child that is of no use, and closes what led to it."""
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with contextlib.suppress(OSError):  # a request for a sample that was never read
                stream.close()


def sampler_cost(name: str = "auto", sysfs_root: Path = Path("/sys"), seconds: float = 2.0) -> float:
    """CPU time that sampling the source takes, as a share of one core, measured over `seconds`.

    Raises SourceUnavailableError, UsageError.
    """
    choice, clock = choose(name, sysfs_root), SystemClock()
    sampler = SamplerProcess(choice, sysfs_root)
    sampler.start()
    try:
        began_s, spent_s = clock.now_s(), sampler.cpu_s()
        sampler.pause(seconds)
        sampler.sample()
        return (sampler.cpu_s() - spent_s) / (clock.now_s() - began_s)
    finally:
        sampler.stop()
