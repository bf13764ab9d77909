"""One measurement: a renderer looping in a subprocess, a sampler beside it, windows as Stein's rule asks."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.conditions import read_conditions, throttled
from joulebox_agent.energies import window_energies
from joulebox_agent.errors import AgentError, RendererError
from joulebox_agent.estimate import two_stage_interval, windows_needed
from joulebox_agent.loop import STOP_WITHIN_S, DoneEvent, ImageEvent, ReadyEvent, RendererLoop, StageEvent
from joulebox_agent.recording import Recording
from joulebox_agent.rule import MeasureRule
from joulebox_agent.sampler import SENSOR_LOST_AFTER_S, Sampler
from joulebox_agent.series import PowerSeries
from joulebox_agent.sources.choose import Choice, choose
from joulebox_agent.windows import WindowSplitter

LOOK_EVERY_S = 0.25  # how soon a plugged cable or a request to stop is noticed


class StoppedError(AgentError):
    """The measurement was asked to stop before it had an answer."""


class Listener(Protocol):
    """Who wants to know how a measurement goes."""

    def note(self, text: str) -> None:
        """A line of news."""

    def words(self, text: str) -> None:
        """What the renderer writes to stderr while it prepares."""

    def progress(self, elapsed_s: float, windows: int, wanted: int, estimate: str) -> None:
        """After every image: windows so far, windows wanted, the running estimate in words."""


class Silent:
    """A listener that wants to know nothing."""

    def note(self, text: str) -> None: ...
    def words(self, text: str) -> None: ...
    def progress(self, elapsed_s: float, windows: int, wanted: int, estimate: str) -> None: ...


@dataclass(frozen=True)
class Job:
    """What to render and with what.

    command    the renderer's program
    arguments  scene, settings and defines as the loop command takes them
    image_file where the renderer leaves its last picture (EXR)
    """

    command: Sequence[str]
    arguments: Sequence[str]
    image_file: Path


class Measurement:
    """Runs one job under one rule. `run()` may be called once."""

    def __init__(
        self,
        job: Job,
        rule: MeasureRule,
        choice: Choice,
        listener: Listener | None = None,
        stop: threading.Event | None = None,
        sysfs_root: Path = Path("/sys"),
        clock: Clock | None = None,
        lost_after_s: float = SENSOR_LOST_AFTER_S,
    ) -> None:
        self._job, self._rule = job, rule
        self._choice = choice if rule.meter else choose("none")
        self._listener: Listener = listener or Silent()
        self._stop = stop or threading.Event()
        self._sysfs_root = sysfs_root
        self._clock: Clock = clock or SystemClock()
        self._sampler = Sampler(self._choice.source, self._clock, lost_after_s)
        self._wanted = rule.min_windows if rule.meter else 1
        self._decided = False
        self._estimate = ""
        self._pending: list[StageEvent] = []
        self.recording = Recording(self._choice.source, self._choice.report, self._sampler.start_s)

    def run(self) -> Recording:
        """Measures. Raises RendererError, StoppedError; a void measurement is returned as such."""
        record = self.recording
        record.before = read_conditions(self._sysfs_root)
        self._sampler.start()
        try:
            self._idle()
            if record.void is None:
                self._loop()
            if record.void is None:
                self._idle()
            self._fetch_image()
        finally:
            self._sampler.stop()
            record.samples = self._sampler.samples()
            record.sampler_cpu_share = self._sampler.cpu_share()
        record.after = read_conditions(self._sysfs_root)
        hot = throttled(record.before, record.after)
        if hot:
            record.make_void(hot, environment=True)
        return record

    def _idle(self) -> None:
        """Lets the machine rest for the asked time and marks the stretch."""
        if not self._rule.idle_s or self._choice.source.quality == "none":
            return
        self._listener.note(f"measuring idle power for {self._rule.idle_s:g} s")
        self._sampler.sample()
        start_s = self._clock.now_s()
        while (left_s := start_s + self._rule.idle_s - self._clock.now_s()) > 0:
            self._check_surroundings()
            if self.recording.void:
                return
            self._sampler.pause(min(LOOK_EVERY_S, left_s))
        self._sampler.sample()
        self.recording.idle.append((start_s, self._clock.now_s()))

    def _loop(self) -> None:
        """Runs the renderer until there are windows enough, time is up, or the measurement is void."""
        arguments = [*self._job.arguments, "-o", str(self._job.image_file)]
        if not self._rule.meter:
            arguments += ["--max-images", "1"]
        with RendererLoop(self._job.command, arguments, self._clock, self._listener.words) as loop:
            ready_s: float | None = None
            heard_s = self._clock.now_s()
            while not self._finished(ready_s):
                event = loop.next_event(LOOK_EVERY_S)
                now_s = self._clock.now_s()
                if event is None:
                    if now_s - heard_s > self._rule.silence_s:
                        raise RendererError(f"The renderer said nothing for {self._rule.silence_s:g} s; it was ended.")
                    continue
                heard_s = now_s
                if isinstance(event, ReadyEvent):
                    ready_s = now_s
                    self.recording.ready = event
                    self._listener.note(f"rendering {event.scene} with {event.build.name} {event.build.version}")
                elif ready_s is None:
                    raise RendererError(f"The renderer sent {event.event!r} before 'ready'.")
                elif isinstance(event, DoneEvent):
                    break
                else:
                    self._take(event, now_s - ready_s)
            loop.stop(self._patience_s())

    def _patience_s(self) -> float:
        """How long the renderer may take to finish its image and write it; a void one is not waited for."""
        last = self.recording.last_image
        return STOP_WITHIN_S if last is None or self.recording.void else STOP_WITHIN_S + 2 * last.time_s

    def _take(self, event: StageEvent | ImageEvent, elapsed_s: float) -> None:
        if isinstance(event, StageEvent):
            self._pending.append(event)
            return
        stages = [stage for stage in self._pending if stage.image == event.image]
        self._pending = [stage for stage in self._pending if stage.image > event.image]
        record = self.recording
        if record.last_image is not None and record.last_image.pixel_sha256 != event.pixel_sha256:
            at = f"image {event.image} at {event.end_s - record.start_s:.1f} s"
            record.make_void(f"the picture changed between images ({at}): same settings must give same pixels", False)
        record.last_image = event
        if record.warm_up is None:
            record.warm_up, record.warm_up_stages = event, stages
            record.splitter = WindowSplitter(event.end_s, self._rule.window_s)
            self._sampler.sample()
            return
        assert record.splitter is not None
        record.images.append(event)
        window = record.splitter.add(event, stages)
        if window is not None:
            self._sampler.sample()  # so that a fast counter is known at the window's edge
            record.windows.append(window)
            self._decide()
        self._listener.progress(elapsed_s, len(record.windows), self._wanted, self._estimate)

    def _decide(self) -> None:
        """The running estimate after every window, and when the pilot is complete, Stein's second stage."""
        values, unit, widening = self._values()
        if len(values) < 2:
            return
        interval = two_stage_interval(values, self._rule.min_windows, widening=widening)
        self._estimate = f"{interval.value:.4g} {unit} an image ± {interval.half_width:.2g}"
        if not self._decided and len(self.recording.windows) >= self._wanted:
            self._decided = True
            pilot = values[: max(2, self._rule.min_windows)]
            needed = windows_needed(pilot, self._rule.half_width, widening=widening)
            self._wanted = min(self._rule.max_windows, max(self._wanted, needed))

    def _values(self) -> tuple[list[float], str, float]:
        """What decides the number of windows: joules an image, seconds an image where no energy is known;
        their unit; how much drift widens their interval."""
        record = self.recording
        series = PowerSeries(self._sampler.samples())
        found = window_energies(
            series, record.source, record.windows, record.source_report.resolution_j, self._rule.min_windows
        )
        joules = [g / w.images for g, w in zip(found.gross_j, record.windows, strict=True) if g is not None]
        if joules:
            return joules, "J", found.widening
        return [w.image_time_s / w.images for w in record.windows], "s", 1.0

    def _finished(self, ready_s: float | None) -> bool:
        self._check_surroundings()
        record = self.recording
        if record.void is not None:
            return True
        if ready_s is None:
            return False
        if len(record.windows) >= min(self._wanted, self._rule.max_windows) and self._rule.meter:
            return True
        return self._clock.now_s() - ready_s > self._rule.max_seconds and self._time_up()

    def _time_up(self) -> bool:
        """Whether the time limit ends the loop: never before one image exists, which a hung renderer's
        silence limit bounds."""
        if self.recording.last_image is None:
            return False
        if self._rule.meter:
            done = len(self.recording.windows)
            self.recording.notes.append(
                f"the limit of {self._rule.max_seconds:g} s ended it after {done} of {self._wanted} windows"
            )
        return True

    def _check_surroundings(self) -> None:
        if self._stop.is_set():
            raise StoppedError("The measurement was stopped before it had an answer.")
        trouble = self._sampler.trouble()
        if trouble:
            self.recording.make_void(trouble, environment=True)

    def _fetch_image(self) -> None:
        """Makes sure the last picture is on disk: a renderer that was stopped may not have written it."""
        record = self.recording
        if record.void is not None or record.last_image is None or self._job.image_file.exists():
            return
        arguments = [*self._job.arguments, "-o", str(self._job.image_file), "--max-images", "1"]
        with RendererLoop(self._job.command, arguments, self._clock) as loop:
            heard_s = self._clock.now_s()
            while not isinstance(event := loop.next_event(LOOK_EVERY_S), DoneEvent):
                if self._stop.is_set():
                    raise StoppedError("The measurement was stopped before it had an answer.")
                heard_s = heard_s if event is None else self._clock.now_s()
                if self._clock.now_s() - heard_s > self._rule.silence_s:
                    raise RendererError(f"The renderer said nothing for {self._rule.silence_s:g} s; it was ended.")
                if isinstance(event, ImageEvent) and event.pixel_sha256 != record.last_image.pixel_sha256:
                    record.make_void("the picture changed when it was rendered once more to keep it", False)
        if not self._job.image_file.exists():
            record.notes.append("the renderer wrote no picture")
