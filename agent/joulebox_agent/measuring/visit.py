"""One run of the renderer for one configuration: a warm-up image, then windows."""

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from joulebox_agent.clock import Clock
from joulebox_agent.conditions import Conditions
from joulebox_agent.errors import RendererError
from joulebox_agent.estimates.windows import Window
from joulebox_agent.loop import DoneEvent, ImageEvent, ReadyEvent, RendererLoop, StageEvent
from joulebox_agent.measuring.meter import LOOK_EVERY_S, Meter, StoppedError
from joulebox_agent.measuring.recording import Recording, VoidWindow
from joulebox_agent.measuring.rule import SLOWEST_REFRESH_S, MeasureRule
from joulebox_agent.process import STOP_WITHIN_S

LOOK_AT_REFRESH_S = 10.0
MOST_VOID = 10  # void windows in a row, after which a configuration is not measurable here and now
# Rendering before the first and after the last window: a gauge shows a mean of the past and a counter is read between
# its updates, and what they say at a window's edge should be of the same load. At most this share of a window.
LEAD_REFRESHES, LEAD_SHARE = 4, 0.25
Ending = Literal["enough", "time", "void", "trouble", "over", "low charge"]
"""void: the configuration is at fault; trouble: the source is, ask `Meter.trouble`."""


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


class Loop(Protocol):
    """A renderer that runs; `RendererLoop` is the real one."""

    def next_event(self, timeout_s: float) -> ReadyEvent | StageEvent | ImageEvent | DoneEvent | None: ...
    def stop(self, within_s: float = STOP_WITHIN_S) -> None: ...


LoopFactory = Callable[[Sequence[str], Sequence[str], Clock, Callable[[str], None]], AbstractContextManager["Loop"]]


class Visit:
    """Runs the renderer until `enough()`, the time limit, or trouble. `run()` may be called once.

    enough     asked after every window whether to go on
    on_window  called after every window, good or void, outside of any: it may write to disk
    low        whether the battery has to be charged before another window
    block      number of the block these windows belong to
    """

    def __init__(
        self,
        job: Job,
        rule: MeasureRule,
        meter: Meter,
        record: Recording,
        enough: Callable[[], bool],
        on_window: Callable[[], bool] = lambda: False,
        low: Callable[[], bool] = lambda: False,
        progress: Callable[[float], None] = lambda elapsed_s: None,
        block: int = 0,
        make_loop: LoopFactory = RendererLoop,
    ) -> None:
        self._job, self._rule, self._meter, self._record = job, rule, meter, record
        self._enough, self._on_window, self._low, self._progress = enough, on_window, low, progress
        self._block, self._make_loop = block, make_loop
        self._clock = meter.clock
        self._pending: list[StageEvent] = []
        self._open: Window | None = None  # None: the next image's end opens one
        self._state: Conditions = {}
        self._warm = False
        self._void_in_a_row = 0
        self._ready_s: float | None = None
        self._ending: Ending | None = None
        self._then: Ending | None = None  # how it ends once the load has lasted until `_edge_s`
        self._lead_s = self._edge_s = 0.0
        self._load_from_s = math.inf
        self._looked_s, self._refresh_s = -math.inf, SLOWEST_REFRESH_S

    def run(self) -> Ending:
        """Adds windows to the recording. Raises RendererError, StoppedError."""
        arguments = [*self._job.arguments, "-o", str(self._job.image_file)]
        if not self._rule.meter:
            arguments += ["--max-seconds", f"{self._rule.timed_s:g}"]
        words = self._meter.listener.words
        try:
            self._meter.load_changed()
            with self._make_loop(self._job.command, arguments, self._clock, words) as loop:
                heard_s = self._clock.now_s()
                while self._ending is None and not self._finished():
                    event = loop.next_event(LOOK_EVERY_S)
                    if event is not None:
                        heard_s = self._clock.now_s()
                        self._hear(event, heard_s)
                    elif self._clock.now_s() - heard_s > self._rule.silence_s:
                        raise RendererError(f"The renderer said nothing for {self._rule.silence_s:g} s; it was ended.")
                loop.stop(self._patience_s())
        finally:
            self._meter.load_changed()
            if self._ready_s is not None:
                self._record.spent_s += self._clock.now_s() - self._ready_s
        self._tell_trails()
        self._record.rest = self._open if self._open is not None and self._open.images else None
        return self._ending or "enough"

    def _patience_s(self) -> float:
        """How long the renderer may take to finish its image and write it; a void one is not waited for."""
        last = self._record.last_image
        return STOP_WITHIN_S if last is None or self._record.void else STOP_WITHIN_S + 2 * last.time_s

    def _hear(self, event: ReadyEvent | StageEvent | ImageEvent | DoneEvent, now_s: float) -> None:
        record = self._record
        if isinstance(event, ReadyEvent):
            self._ready_s = now_s
            if record.ready is None:
                self._meter.listener.note(f"rendering {event.scene} with {event.build.name} {event.build.version}")
            record.ready = event
        elif self._ready_s is None:
            raise RendererError(f"The renderer sent {event.event!r} before 'ready'.")
        elif isinstance(event, DoneEvent):
            self._ending = "over"
        elif isinstance(event, StageEvent):
            self._pending.append(event)
        else:
            self._take(event)
            self._progress(now_s - self._ready_s)

    def _take(self, image: ImageEvent) -> None:
        """An image with its stages: the warm-up, part of the open window, or what follows a void one."""
        stages = [stage for stage in self._pending if stage.image == image.image]
        self._pending = [stage for stage in self._pending if stage.image > image.image]
        record = self._record
        if record.last_image is not None and record.last_image.pixel_sha256 != image.pixel_sha256:
            at = f"image {image.image} at {image.end_s - record.start_s:.1f} s"
            record.make_void(f"the picture changed between images ({at}): same settings must give same pixels", False)
            self._ending = "void"
        record.last_image = image
        if not self._rule.meter:
            record.images.append(image)
            self._open = self._open or Window(image.start_s)
            self._open.add(image, stages)
            return
        if not self._warm:
            self._warm = True
            if record.warm_up is None:
                record.warm_up, record.warm_up_stages = image, stages
            self._lead_s = self._needed_lead_s()
            self._load_from_s = image.start_s
            self._edge_s = image.start_s + self._lead_s
            if image.end_s >= self._edge_s:
                self._begin(image.end_s)
            return
        record.images.append(image)
        if self._then is not None:
            self._ending = self._then if image.end_s >= self._edge_s else None
            return
        if self._open is None:
            if self._meter.passing_fault(image.end_s, self._clock.now_s() + LOOK_EVERY_S) is not None:
                self._edge_s = image.end_s + self._lead_s  # what the gauge shows next is still of the fault
            elif image.end_s >= self._edge_s:
                self._begin(image.end_s)
            return
        self._open.add(image, stages)
        if self._open.wall_s >= self._needed_s():
            self._close(self._open)

    def _begin(self, start_s: float) -> None:
        self._meter.sample()  # so that a fast counter is known at the window's edge
        self._state = self._meter.conditions()
        self._open = self._window_from(start_s)

    def _window_from(self, start_s: float) -> Window:
        return Window(start_s, lead_s=start_s - self._load_from_s)

    def _tell_trails(self) -> None:
        """How long the load went on after each window is known when the visit is over."""
        last = self._record.last_image
        for window in self._record.windows:
            if last is not None and window.start_s >= self._load_from_s:
                window.trail_s = max(0.0, last.end_s - window.end_s)

    def _needed_s(self) -> float:
        """Length of a window: what was asked for, and room for enough refreshes of the gauge as measured."""
        refreshes = self._rule.refreshes_a_window
        if not refreshes or self._meter.choice.source.quality == "none" or not self._rule.meter:
            return self._rule.window_s
        now_s = self._clock.now_s()
        if now_s - self._looked_s > LOOK_AT_REFRESH_S:
            self._looked_s, self._refresh_s = now_s, self._meter.refresh_s() or SLOWEST_REFRESH_S
        return max(self._rule.window_s, refreshes * self._refresh_s)

    def _close(self, window: Window) -> None:
        """Judges a window that is long enough, and opens the next where it ended."""
        self._meter.sample()
        before, self._state = self._state, self._meter.conditions()
        (reason,) = self._meter.void_reasons([(window.start_s, window.end_s)])
        reason = reason or self._meter.state_change(before, self._state)
        if reason is not None:
            self._make_void(window, reason)
        else:
            self._record.windows.append(window)
            self._record.blocks.append(self._block)
            self._void_in_a_row = 0
            self._open = self._window_from(window.end_s)
        wrote = self._on_window()
        if reason is None and self._enough():
            self._leave(window.end_s, "enough")
        elif self._low():
            self._leave(window.end_s, "low charge")
        elif wrote:
            self._open = None  # that took a moment: the image in progress is not worth its risk

    def _leave(self, end_s: float, ending: Ending) -> None:
        """Ends the visit, after a few more refreshes of the same load for the sake of the last window's edge."""
        self._open = None
        if self._lead_s > 0:
            self._then, self._edge_s = ending, end_s + self._lead_s
        else:
            self._ending = ending

    def _needed_lead_s(self) -> float:
        if self._meter.choice.source.quality == "none" or not self._rule.meter:
            return 0.0
        return min(LEAD_REFRESHES * (self._meter.refresh_s() or SLOWEST_REFRESH_S), LEAD_SHARE * self._rule.window_s)

    def _make_void(self, window: Window, reason: str) -> None:
        """Lists the window as void; the next begins at the end of a later image."""
        end_s = max(window.end_s, window.start_s)
        self._record.voided.append(VoidWindow(window.start_s, end_s, window.images, reason))
        self._meter.listener.note(f"window void: {reason}")
        self._open = None
        self._edge_s = self._clock.now_s() + self._lead_s
        self._void_in_a_row += 1
        if self._void_in_a_row >= MOST_VOID:
            self._record.make_void(f"{MOST_VOID} windows in a row were void, the last because {reason}", True)
            self._ending = "void"

    def _finished(self) -> bool:
        """Whether trouble or the time limit ends the visit; a fault in the open window is found here early."""
        trouble = self._meter.trouble()
        if trouble:
            self._end_by(trouble)
            return True
        if self._open is not None and self._rule.meter:
            reason = self._meter.passing_fault(self._open.start_s, self._clock.now_s())
            if reason is not None:
                self._make_void(self._open, reason)
        return self._ready_s is not None and self._time_up(self._ready_s)

    def _end_by(self, trouble: str) -> None:
        if self._open is not None and self._open.images:
            self._record.voided.append(VoidWindow(self._open.start_s, self._open.end_s, self._open.images, trouble))
            self._open = None
        self._ending = "trouble"

    def _leaving(self) -> bool:
        """Whether to end with the windows there are. Raises StoppedError when more than one is missing for an answer;
        one that is under way is waited for."""
        if not self._meter.leaving():
            return False
        missing = self._rule.min_windows - len(self._record.windows)
        if missing > 1 or not self._rule.meter:
            raise StoppedError("The measurement was asked to stop long before it had an answer.")
        return missing <= 0

    def _time_up(self, ready_s: float) -> bool:
        """Whether the time limit, or the wish to leave, ends the loop: never before one image exists, which a hung
        renderer's silence limit bounds."""
        spent_s = self._record.spent_s + self._clock.now_s() - ready_s
        if self._then is not None:
            return False
        if (spent_s <= self._rule.max_seconds and not self._leaving()) or self._record.last_image is None:
            return False
        self._ending = "time"
        return True
