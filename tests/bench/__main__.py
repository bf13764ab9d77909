"""`make bench`: every goal with what is measured, as one Markdown table.

    python -m tests.bench [--full] [--quick] [--only GROUP ...] [-o FILE]

--full adds what takes long: a picture of 3840x2160 pixels and a compile from nothing. --quick measures on 64x64
pixels with Mitsuba stopped early; its figures only show that everything runs, and it writes no file unless told.
"""

from __future__ import annotations

import argparse
import functools
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from joulebox_render.bench import machine, shrink
from joulebox_render.errors import RenderError

from . import difference_speed, gains, growth, mitsuba_side, rates, rivals, threads
from .candidates import Measured, cost_ratio, is_preset, measure_front
from .references import load_reference
from .table import Row, goals, markdown_table

TARGET = Path(__file__).resolve().parents[2] / "docs" / "bench.md"
QUICK_SIZE = 64
BUSY_LOAD = 0.5
GROUPS = ("rivals", "rates", "gains", "threads", "growth", "start", "difference")
NOTE = (
    "CPU seconds of a warm picture, 256x256 pixels, all in one run. FLIP: mean at 67 pixels per degree of "
    "clip(3 x linear) as sRGB. relMSE: mean of (3 a - 3 b)^2 / ((3 b)^2 + 0.01), the worst 0.1 % of pixels dropped."
)


class Run(NamedTuple):
    """How this run measures: the film's side, 0 for the scene's own, and where it says what it does."""

    size: int
    full: bool
    say: Callable[[str], None]

    @property
    def film(self) -> dict[str, int]:
        """The film as settings."""
        return {"width": self.size, "height": self.size} if self.size else {}


def rival_rows(run: Run) -> tuple[list[Row], list[Measured]]:
    """Goals of time to an error, and all that was measured for them."""
    rows, all_ours = [], []
    has_llvm = mitsuba_side.variant() == mitsuba_side.LLVM
    if not has_llvm:
        run.say(mitsuba_side.NO_LLVM)
    for scene in dict.fromkeys(goal.scene for goal in rivals.GOALS):
        reference = load_reference(scene)
        assert reference, f"{scene} carries its reference"
        truth = shrink(reference.pixels, run.size or None)
        ours = measure_front(scene, truth, run.say, run.film)
        flips = [goal.flip for goal in rivals.GOALS if goal.scene == scene]
        until = 0.2 if run.size else min(flips)
        theirs = rivals.mitsuba_curve(scene, truth, until, run.say, run.size) if has_llvm else []
        rows += [rivals.ratio_row(goal, ours, theirs) for goal in rivals.GOALS if goal.scene == scene]
        rows += [rivals.relmse_row(*goal, ours) for goal in rivals.RELMSE_GOALS if goal[0] == scene]
        rows.append(rivals.front_row(scene, ours, functools.partial(cost_ratio, scene, size=run.film)))
        all_ours += ours
    return rows, all_ours


def measure(run: Run, groups: Sequence[str]) -> tuple[list[Row], list[Measured]]:
    """Every row of the groups, in the table's order."""
    rows, ours = rival_rows(run) if "rivals" in groups else ([], [])
    if "rates" in groups:
        rows += [*rates.share_rows(run.say, run.film), rates.gather_row(run.say, run.film)]
    if "gains" in groups:
        rows += [*gains.sampler_rows(run.say), *gains.shadow_rows(run.say, run.film), gains.hierarchy_row(run.say)]
    if "threads" in groups:
        rows.append(threads.threads_row(run.say, run.film))
    if "growth" in groups:
        rows.append(growth.pixels_row(run.say, *((16, 4) if run.size else ())))
        rows.append(growth.triangles_row(run.say, run.film))
        rows += growth.memory_rows(run.say, run.full)
    if "start" in groups:
        rows += [growth.start_row(run.say), growth.compile_row(run.say, run.full)]
    if "difference" in groups:
        rows += difference_speed.difference_rows(run.say)
    return rows, ours


def document(rows: Sequence[Row], ours: Sequence[Measured]) -> str:
    """The report as Markdown."""
    lines = [machine(), f"Rival: {mitsuba_side.describe()}.", NOTE, "", *goals(rows)]
    if not ours:
        return "\n".join(lines) + "\n"
    lines.append("")
    head = ("scene", "preset", "CPU s", "relMSE", "FLIP", "mean brightness")
    lines += markdown_table(head, [
        (each.scene, each.name, f"{each.cpu_s:.2f}", f"{each.relmse:.4f}", f"{each.flip:.4f}",
         f"{100 * each.brightness:+.2f} %")
        for each in ours if is_preset(each)
    ])  # fmt: skip
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="bench", description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="also what takes many minutes")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_SIZE}x{QUICK_SIZE} pixels, to see that it runs")
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS, help="groups of rows")
    parser.add_argument("-o", "--output", type=Path, help=f"file to write (default {TARGET.name} of the docs)")
    given = parser.parse_args()
    start = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - start:5.0f} s] {text}", file=sys.stderr, flush=True)

    if hasattr(os, "getloadavg") and os.getloadavg()[0] > BUSY_LOAD:
        say("this machine is busy with other work: times, those of threads above all, will be worse than they should")
    try:
        rows, ours = measure(Run(QUICK_SIZE if given.quick else 0, given.full, say), given.only)
    except RenderError as error:
        print(f"bench: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("bench: interrupted; nothing was written", file=sys.stderr)
        return 130
    text = document(rows, ours)
    print(text)
    whole = not given.quick and tuple(given.only) == GROUPS
    target = given.output or (TARGET if whole else None)
    if target:
        target.write_text(text, encoding="utf-8")
    say(f"done{f', written to {target.name}' if target else ''}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
