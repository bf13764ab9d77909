"""The renderer as a subprocess that renders again and again and tells when each stage began and ended.

Protocol 1: one JSON object a line on stdout (`ready`, `stage`, `image`, `done`), times in seconds of
`time.perf_counter_ns()`; one sentence on stderr and exit code 1 or 2 when something is wrong. Any program
that speaks this can be measured.
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.errors import RendererError, UsageError
from joulebox_agent.process import STOP_WITHIN_S, RendererProcess, program_words

RENDERER = "joulebox-render"
CLOCKS_AGREE_S = 30.0  # an event cannot arrive before it happened; this much later is another clock
Finite = Annotated[float, Field(allow_inf_nan=False)]
Duration = Annotated[float, Field(allow_inf_nan=False, ge=0)]


class _Event(BaseModel):
    # fields that a newer renderer adds are not ours to refuse
    model_config = ConfigDict(frozen=True, extra="ignore")


class Build(_Event):
    name: str
    version: str
    intersector: str = ""
    isa: str = ""
    threads: int = 0


class ReadyEvent(_Event):
    event: Literal["ready"]
    protocol: Literal[1]
    scene: str
    scene_sha256: str
    settings: dict[str, Any]
    build: Build
    plan: dict[str, Any] = {}


class StageEvent(_Event):
    event: Literal["stage"]
    image: int
    name: str
    start_s: Finite
    end_s: Finite
    cpu_s: Duration = 0.0
    rays: Duration = 0.0
    through_specular: bool = False  # work on what is seen through mirrors and glass


class ImageEvent(_Event):
    event: Literal["image"]
    image: int
    start_s: Finite
    end_s: Finite
    time_s: Duration
    cpu_s: Duration
    pixel_sha256: str
    photons: dict[str, Any] = {}


class DoneEvent(_Event):
    event: Literal["done"]
    images: int


Event = Annotated[ReadyEvent | StageEvent | ImageEvent | DoneEvent, Field(discriminator="event")]
_EVENT: TypeAdapter[ReadyEvent | StageEvent | ImageEvent | DoneEvent] = TypeAdapter(Event)


def renderer_command(given: str | None) -> list[str]:
    """The program to run: what the user gave, else joulebox-render beside this Python, else on PATH."""
    if given:
        return program_words(given, "renderer", "--renderer")
    beside = shutil.which(RENDERER, path=str(Path(sys.executable).parent))
    found = beside or shutil.which(RENDERER)
    if found is None:
        raise UsageError(f"{RENDERER} is neither beside {sys.executable} nor on PATH; install it or give --renderer.")
    return [found]


def ask_renderer(command: Sequence[str], *arguments: str, timeout_s: float = 120.0) -> str:
    """Runs the renderer once and returns what it printed. Raises RendererError with its own sentence."""
    try:
        done = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=timeout_s, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RendererError(f"{' '.join([*command, *arguments])} gave no answer: {error}.") from error
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or ["(nothing on stderr)"]
        raise RendererError(f"{command[0]} {' '.join(arguments)} left with code {done.returncode}: {lines[-1]}")
    return done.stdout


class RendererLoop:
    """One job of a renderer, in a process of its own. Use as a context manager: the process never outlives the block.

    on_words  called with each line the renderer writes to stderr (progress of its set-up)
    """

    def __init__(
        self,
        command: Sequence[str],
        arguments: Sequence[str],
        clock: Clock | None = None,
        on_words: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._command = [*command, "loop", *arguments]
        self._clock = clock or SystemClock()
        self._on_words = on_words
        self._number = 0

    def __enter__(self) -> "RendererLoop":
        self._process = RendererProcess(self._command, self._clock, self._on_words)
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.stop()

    def next_event(self, timeout_s: float) -> ReadyEvent | StageEvent | ImageEvent | DoneEvent | None:
        """The next event, None when none came within `timeout_s`.

        Raises RendererError when the process ended or wrote something else, RendererRefusedError for code 2.
        """
        item = self._process.next_line(timeout_s)
        if item is None:
            return None
        self._number += 1
        return self._parse(*item)

    def _parse(self, arrived_s: float, line: str) -> ReadyEvent | StageEvent | ImageEvent | DoneEvent:
        where = f"line {self._number} of the renderer's output"
        try:
            event = _EVENT.validate_python(json.loads(line))
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"]) or "event"
            raise RendererError(f"L{where[1:]} breaks the loop protocol: {place}: {first['msg']}.") from error
        except (ValueError, RecursionError) as error:
            raise RendererError(f"L{where[1:]} is not JSON: {line.strip()[:80]!r}.") from error
        if isinstance(event, StageEvent | ImageEvent):
            self._check_times(event, arrived_s, where)
        return event

    def _check_times(self, event: StageEvent | ImageEvent, arrived_s: float, where: str) -> None:
        if event.end_s < event.start_s:
            raise RendererError(f"L{where[1:]} ends before it starts ({event.start_s} to {event.end_s} s).")
        if not -0.1 < arrived_s - event.end_s < CLOCKS_AGREE_S:
            raise RendererError(
                f"L{where[1:]} says {event.end_s:.3f} s and arrived at {arrived_s:.3f} s: "
                "times must be time.perf_counter_ns() of this machine and lines must be flushed."
            )

    def stop(self, within_s: float = STOP_WITHIN_S) -> None:
        """Asks the renderer to end, and makes it after `within_s`. Safe to call again."""
        self._process.stop(within_s)
