"""Render again and again and say when each stage ran: the contract that an energy meter measures against.

One JSON object a line on standard output; times are perf_counter_ns times in seconds. `run_jobs` does that for one job
after the other, so that a short job does not pay for the start of a process.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

import psutil

from joulebox_render.clock import Interval
from joulebox_render.errors import RenderError, SettingsError, StoppedError
from joulebox_render.images import write_exr
from joulebox_render.session import Session

PROTOCOL = 1
MOST_KEPT_BYTES = 2 << 30
"""Resident memory from which on a process does no further job: what freed arrays hold is not given back while it
lives."""


class StopSignals:
    """SIGTERM and SIGINT ask for an end; a context manager, after which they mean what they did before."""

    def __init__(self) -> None:
        self.asked = False
        self._session: Session | None = None
        self._before: dict[signal.Signals, Any] = {}

    def ends(self, session: Session) -> None:
        """From now on an image under way is given up as well."""
        self._session = session
        if self.asked:
            session.stop()

    def __enter__(self) -> StopSignals:
        self._before = {number: signal.signal(number, self._ask) for number in (signal.SIGTERM, signal.SIGINT)}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: object) -> None:
        self.asked = True
        if self._session is not None:
            self._session.stop()


def run_loop(
    session: Session,
    out: TextIO,
    max_images: int | None,
    max_seconds: float | None,
    image_file: Path | None,
    stopped: Callable[[], bool],
) -> None:
    """Write `ready`, then `stage` lines and an `image` line for each image, and `done`.

    Ends after max_images, or before the image that would start later than max_seconds, or when `stopped()`; an
    image under way is then given up.
    image_file, where given, gets the last image before `done`. Raises RenderError if two images of the same
    settings differ.
    """
    write_line(out, {"event": "ready", "protocol": PROTOCOL, **session.header(), "time_s": time.perf_counter()})
    start = time.perf_counter()
    images = 0
    first_hash = ""
    image = None
    while not stopped() and (max_images is None or images < max_images):
        if max_seconds is not None and images and time.perf_counter() - start >= max_seconds:
            break
        try:
            image = session.render(listener=_stage_writer(out, images))
        except StoppedError:
            break
        first_hash = first_hash or image.pixel_sha256
        write_line(
            out,
            {
                "event": "image", "image": images, "start_s": image.start_ns * 1e-9, "end_s": image.end_ns * 1e-9,
                "time_s": image.time_s, "cpu_s": image.cpu_s, "width": session.settings.width,
                "height": session.settings.height, "pixel_sha256": image.pixel_sha256,
                "photons": image.photons, "notes": image.notes,
            },
        )  # fmt: skip
        if image.pixel_sha256 != first_hash:
            raise RenderError(f"image {images} differs from the first of the same settings: the renderer is at fault")
        images += 1
    if image_file and image:
        write_exr(image_file, image.pixels, {"joulebox:pixel_sha256": image.pixel_sha256})
    write_line(
        out,
        {
            "event": "done", "images": images, "image_file": str(image_file) if image_file and image else None,
            "end_s": time.perf_counter(),
        },
    )  # fmt: skip


def run_jobs(jobs: TextIO, out: TextIO, loop: Callable[[list[str]], bool]) -> None:
    """Do each line of `jobs`, a JSON array of the loop command's arguments; `waiting` is written before each is read.

    loop   runs one, and says whether it came to its own end; after one that was stopped nothing more is done
    Raises SettingsError for a line that is no such array, and what `loop` raises.
    """
    while psutil.Process().memory_info().rss < MOST_KEPT_BYTES:
        write_line(out, {"event": "waiting", "protocol": PROTOCOL})
        line = jobs.readline()
        if not line or not loop(_words_of(line)):
            return


def _words_of(line: str) -> list[str]:
    try:
        words = json.loads(line)
    except ValueError:
        words = None
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise SettingsError(
            f"a job is a JSON array of the arguments of `loop`, all of them texts, not {line.strip()[:80]!r}"
        )
    return words


def _stage_writer(out: TextIO, image: int) -> Callable[[Interval], None]:
    def write(interval: Interval) -> None:
        line: dict[str, Any] = {
            "event": "stage", "image": image, "name": interval.name, "start_s": interval.start_ns * 1e-9,
            "end_s": interval.end_ns * 1e-9, "cpu_s": interval.cpu_s, "rays": interval.rays,
        }  # fmt: skip
        if interval.part:
            line["part"] = interval.part
        if interval.through_specular:
            line["through_specular"] = True
        write_line(out, line)

    return write


def write_line(out: TextIO, line: dict[str, Any]) -> None:
    """One JSON object on a line of its own, sent at once."""
    out.write(json.dumps(line) + "\n")
    out.flush()
