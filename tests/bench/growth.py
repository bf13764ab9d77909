"""What more pixels, more triangles and a fresh start cost: time, memory, and the first compile."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from joulebox_render.bench import bare_cpu_s, record_queries
from joulebox_render.scene import list_scenes
from joulebox_render.session import Image, Session
from joulebox_render.settings import make_settings

from .rates import NO_EMBREE
from .table import Row

Say = Callable[[str], None]

GROWTH_SCENE = "cornell-boxes"
GROWTH_SETTINGS = {"samples_per_pixel": 1}
GROWTH_LIMIT = 1.1
BUNNY = "cornell-bunny"
BUNNY_SETTINGS = {"threads": 1, "samples_per_pixel": 1}
FEW, MANY = "948", "69666"
BUNNY_LIMIT = 1.2
MAP_STAGES = ("photon_map", "precomputed_irradiance")
MEMORY_SCENES = ("cornell-boxes", "cornell-spheres")
START_LIMIT_S, COMPILE_LIMIT_S = 1.5, 60.0
NEEDS_FULL = "not run without --full"

START = f"""
import json, time
from joulebox_render.session import Session
from joulebox_render.settings import make_settings
imported = time.time()
with Session("{BUNNY}", make_settings({{}}), {{"detail": "{MANY}"}}) as session:
    print(json.dumps({{"imported": imported, "ready": time.time(), **session.setup}}))
"""
COMMAND = "from joulebox_render.cli import main; main()"


def cpu_beyond_map(image: Image) -> float:
    """CPU seconds of an image without making the maps, which does not depend on the pixels."""
    totals = image.clock.totals()
    return image.cpu_s - sum(totals[name]["cpu_s"] for name in MAP_STAGES if name in totals)


def pixels_row(say: Say, small: int = 128, factor: int = 8) -> Row:
    """Time of factor^2 times as many pixels over factor^2 times the time."""
    what = f"{GROWTH_SCENE}, t({small * factor}^2) over {factor**2} x t({small}^2) beyond the map"
    say(what)
    spent = {}
    for side, turns in ((small, 5), (small * factor, 1)):
        film = {"width": side, "height": side}
        with Session(GROWTH_SCENE, make_settings(GROWTH_SETTINGS, film)) as session:
            spent[side] = statistics.median(cpu_beyond_map(session.render()) for _ in range(turns))
    share = spent[small * factor] / (factor**2 * spent[small])
    told = f"{share:.2f} ({spent[small * factor]:.2f} and {spent[small]:.3f} CPU s)"
    return Row(what, f"<= {GROWTH_LIMIT}", told, share <= GROWTH_LIMIT)


def triangles_row(say: Say, size: Mapping[str, Any], turns: int = 3) -> Row:
    """Our slow-down from the coarse to the fine bunny over that of bare embreex on the same rays."""
    what = f"bunny of {MANY} triangles against {FEW}: our slow-down over embreex' on the same rays"
    goal = f"<= {BUNNY_LIMIT}"
    if BUNNY not in {entry.name for entry in list_scenes()}:
        return Row.not_run(what, goal, f"there is no scene {BUNNY}")
    say(what)
    settings = make_settings(BUNNY_SETTINGS, size)
    with Session(BUNNY, settings, {"detail": FEW}) as coarse, Session(BUNNY, settings, {"detail": MANY}) as fine:
        embrees = [getattr(session.context.intersector, "embree", None) for session in (coarse, fine)]
        if None in embrees:
            return Row.not_run(what, goal, NO_EMBREE)
        rays = [batch for batches in record_queries(fine).values() for batch in batches]
        ours, bare = [], []
        for _ in range(turns):
            ours.append(fine.render().cpu_s / coarse.render().cpu_s)
            few, many = (bare_cpu_s(embree, rays) for embree in embrees)
            bare.append(many / few)
    share = statistics.median(ours) / statistics.median(bare)
    told = f"{share:.2f} ({statistics.median(ours):.2f}x, embreex {statistics.median(bare):.2f}x)"
    return Row(what, goal, told, share <= BUNNY_LIMIT)


def run_python(code: str, *arguments: str, cache: str = "") -> str:
    """Standard output of a fresh Python; RuntimeError with its last words when it fails."""
    environment = {**os.environ, **({"JOULEBOX_CACHE_DIR": cache} if cache else {})}
    child = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True, encoding="utf-8"
    )
    if child.returncode:
        raise RuntimeError(f"a fresh Python failed: {child.stderr.strip().splitlines()[-1:]}")
    return child.stdout


def peak_rss_bytes(scene: str, *assignments: str) -> int:
    """Peak memory of a fresh process that renders one picture."""
    options = [option for assignment in assignments for option in ("--set", assignment)]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        run_python(COMMAND, "render", scene, "--report", str(report), *options)
        return int(json.loads(report.read_text(encoding="utf-8"))["peak_rss_bytes"])


def memory_rows(say: Say, full: bool) -> list[Row]:
    """Peak memory at the thesis' size, and at a big one."""
    say("memory at 256x256")
    # Compiling takes more memory than rendering, and happens once.
    run_python(COMMAND, "warm-up")
    peaks = {scene: peak_rss_bytes(scene, "width=256", "height=256") for scene in MEMORY_SCENES}
    rows = [_memory_row("256x256", 500e6, peaks)]
    if full:
        say("memory at 3840x2160, 4 samples a pixel: minutes")
        large = peak_rss_bytes(GROWTH_SCENE, "width=3840", "height=2160", "samples_per_pixel=4")
        return [*rows, _memory_row("3840x2160, 4 samples a pixel", 2e9, {GROWTH_SCENE: large})]
    return [*rows, Row.not_run("peak memory at 3840x2160, 4 samples a pixel", "< 2000 MB", NEEDS_FULL)]


def _memory_row(size: str, limit_bytes: float, peaks: Mapping[str, int]) -> Row:
    told = ", ".join(f"{scene} {peak / 1e6:.0f} MB" for scene, peak in peaks.items())
    return Row(f"peak memory at {size}", f"< {limit_bytes / 1e6:.0f} MB", told, max(peaks.values()) < limit_bytes)


def start_row(say: Say) -> Row:
    """From starting Python to the large bunny ready to be traced, kernels compiled before."""
    what, goal = f"start: import, load, BVH of {BUNNY} with {MANY} triangles", f"< {START_LIMIT_S} s once compiled"
    if BUNNY not in {entry.name for entry in list_scenes()}:
        return Row.not_run(what, goal, f"there is no scene {BUNNY}")
    say(what)
    run_python(START)
    turns = []
    for _ in range(3):
        begun = time.time()
        told = json.loads(run_python(START))
        parts = {"import": told["imported"] - begun, "load": told["load_s"], "BVH": told["bvh_s"]}
        turns.append((sum(parts.values()), parts, told["ready"] - begun))
    total, parts, ready = sorted(turns, key=lambda turn: turn[0])[1]
    words = ", ".join(f"{name} {seconds:.2f}" for name, seconds in parts.items())
    return Row(what, goal, f"{total:.2f} s ({words}); first photon after {ready:.2f} s", total < START_LIMIT_S)


def compile_row(say: Say, full: bool) -> Row:
    """The first compile, into an empty cache folder."""
    what, goal = "first compile of all kernels", f"< {COMPILE_LIMIT_S:.0f} s, then cached on disk"
    if not full:
        return Row.not_run(what, goal, NEEDS_FULL)
    say("compiling into an empty folder")
    with tempfile.TemporaryDirectory() as folder:
        seconds = []
        for _ in range(2):
            begun = time.perf_counter()
            run_python(COMMAND, "warm-up", cache=folder)
            seconds.append(time.perf_counter() - begun)
    told = f"{seconds[0]:.0f} s; {seconds[1]:.1f} s the second time"
    return Row(what, goal, told, seconds[0] < COMPILE_LIMIT_S)
