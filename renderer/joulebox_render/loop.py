"""Render again and again and say when each stage ran: the contract that an energy meter measures against.

One JSON object a line on standard output; times are perf_counter_ns times in seconds.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from joulebox_render.clock import Interval
from joulebox_render.errors import RenderError, StoppedError
from joulebox_render.images import write_exr
from joulebox_render.session import Session

PROTOCOL = 1


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
