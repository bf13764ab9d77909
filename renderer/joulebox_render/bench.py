"""What pictures cost and how far they are from the truth: time against error, on this machine.

Error is relMSE, the mean over pixels and channels of (3 a - 3 b)^2 / ((3 b)^2 + 0.01) with the worst 0.1 % of pixels
dropped, against the converged path tracing of another renderer that a scene carries as reference.exr. What a stage
does with its rays is given as the share of its CPU time that bare embreex calls take for the very same rays, in the
same run on one thread, because machines are noisy.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from joulebox_render import __version__
from joulebox_render.clock import Interval, StageClock
from joulebox_render.images import read_exr
from joulebox_render.integrator import render_image
from joulebox_render.pool import usable_cores
from joulebox_render.records import F4, U1, Hits
from joulebox_render.scene import list_scenes
from joulebox_render.session import Image, Session
from joulebox_render.settings import make_settings

CONFIGURATIONS: dict[str, dict[str, object]] = {
    "draft": {"preset": "draft"},
    "balanced": {"preset": "balanced"},
    "fine": {"preset": "fine"},
    "path, 16 samples a pixel": {"indirect": "path", "samples_per_pixel": 16, "shadow_rays": 4},
    "path, 64 samples a pixel": {"indirect": "path", "samples_per_pixel": 64, "shadow_rays": 4},
}
RATE_SCENE = "cornell-boxes"
RATE_SETTINGS: dict[str, object] = {"threads": 1, "samples_per_pixel": 1}


class Query(NamedTuple):
    """Rays of one batch: origin and direction (N, 3) f4; limit (N,) f4 [m] of an occlusion query, else None."""

    origin: F4
    direction: F4
    limit: F4 | None


class RecordingIntersector:
    """Stands in for a session's intersector, answers as it does, and keeps a copy of all rays it was asked for."""

    def __init__(self, intersector: Any) -> None:
        self._intersector = intersector
        self.queries: list[Query] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._intersector, name)

    def closest(self, origin: F4, direction: F4) -> Hits:
        """As the intersector's."""
        self.queries.append(Query(origin.copy(), direction.copy(), None))
        hits: Hits = self._intersector.closest(origin, direction)
        return hits

    def occluded(self, origin: F4, direction: F4, limit: F4) -> U1:
        """As the intersector's."""
        self.queries.append(Query(origin.copy(), direction.copy(), limit.copy()))
        blocked: U1 = self._intersector.occluded(origin, direction, limit)
        return blocked


def relative_mse(image: F4, reference: F4) -> float:
    """relMSE at exposure 3, the worst 0.1 % of pixels dropped."""
    scaled, truth = 3.0 * image.astype(np.float64), 3.0 * reference.astype(np.float64)
    error = np.sort(((scaled - truth) ** 2 / (truth**2 + 0.01)).mean(axis=2).ravel())
    return float(error[: len(error) - len(error) // 1000].mean())


def run_bench(say: Callable[[str], None], quick: bool = False) -> dict[str, Any]:
    """Measure every configuration on every scene that carries a reference, and what stages make of their rays."""
    size = {"width": 64, "height": 64} if quick else {}
    pictures = []
    for entry in list_scenes():
        reference_file = entry.path / "reference.exr"
        if not reference_file.is_file():
            continue
        reference = shrink(read_exr(reference_file), size.get("height"))
        for name, values in CONFIGURATIONS.items():
            say(f"{entry.name}: {name}")
            with Session(entry.path, make_settings(values, size)) as session:
                image = session.render()
            pictures.append({"scene": entry.name, "settings": name, **figures(image, reference)})
    say("what stages make of their rays")
    with Session(RATE_SCENE, make_settings(RATE_SETTINGS, size)) as session:
        rates = [{"scene": RATE_SCENE, "stage": name, **row} for name, row in stage_rates(session).items()]
    return {"version": __version__, "machine": machine(), "pictures": pictures, "rates": rates}


def shadow_test_report(scene: str | Path, *layers: Mapping[str, Any], repeats: int = 5) -> dict[str, float]:
    """What use_shadow_photons saves and costs in direct lighting, under further settings, on one thread.

    Shares: rays_saved, of the direct stage's rays, eye rays among them; cpu_saved, of its CPU time, that of the
    map taken off; pixels_changed. CPU times are medians of pictures taken in turns with and without.
    """
    base = make_settings({"threads": 1, "indirect": "none", "caustics": False}, *layers)
    with (
        Session(scene, base) as session,
        Session(scene, base.model_copy(update={"use_shadow_photons": True})) as testing,
    ):
        turns = [(session.render(), testing.render()) for _ in range(repeats)]
    without, tested = ([image.clock.totals() for image in images] for images in zip(*turns, strict=True))
    off_s = float(np.median([stages["direct"]["cpu_s"] for stages in without]))
    on_s = float(np.median([stages["direct"]["cpu_s"] for stages in tested]))
    map_s = float(np.median([stages["photon_map"]["cpu_s"] for stages in tested]))
    before, after = turns[0][0].pixels, turns[0][1].pixels
    return {
        "rays": without[0]["direct"]["rays"], "rays_with_test": tested[0]["direct"]["rays"],
        "rays_saved": 1 - tested[0]["direct"]["rays"] / without[0]["direct"]["rays"],
        "direct_cpu_s": off_s, "direct_cpu_s_with_test": on_s, "map_cpu_s": map_s,
        "cpu_saved": 1 - (on_s + map_s) / off_s,
        "relmse": relative_mse(after, before), "pixels_changed": float((after != before).any(axis=2).mean()),
        "largest_change": float(np.abs(after - before).max()),
    }  # fmt: skip


def markdown(measured: Mapping[str, Any]) -> str:
    """The document of `run_bench` as tables."""
    lines = [measured["machine"], "", "| scene | settings | CPU s | time s | relMSE | mean brightness |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    lines += [
        f"| {row['scene']} | {row['settings']} | {row['cpu_s']:.2f} | {row['time_s']:.2f} | {row['relmse']:.4f} "
        f"| {100 * row['brightness_error']:+.2f} % |"
        for row in measured["pictures"]
    ]
    lines += ["", f"| stage of {RATE_SCENE}, one thread | Mray per CPU second | of bare embreex on the same rays |",
              "|---|---|---|"]  # fmt: skip
    lines += [
        f"| {row['stage']} | {row['rays'] / row['cpu_s'] / 1e6:.2f} | {row['share_of_bare']:.2f} |"
        for row in measured["rates"]
    ]
    return "\n".join(lines) + "\n"


def figures(image: Image, reference: F4) -> dict[str, float]:
    """What a picture cost and how far it is from the reference; brightness_error is a share of the mean."""
    return {
        "cpu_s": image.cpu_s,
        "time_s": image.time_s,
        "relmse": relative_mse(image.pixels, reference),
        "brightness_error": float(image.pixels.mean()) / float(reference.mean()) - 1,
    }


def stage_key(interval: Interval) -> str:
    """Name of the stage, or of the part of it, that an interval belongs to."""
    return f"{interval.name}, {interval.part}" if interval.part else interval.name


def record_queries(session: Session) -> dict[str, list[Query]]:
    """All rays that each stage of one image asks the intersector for, batch by batch."""
    recorder = RecordingIntersector(session.context.intersector)
    queries: dict[str, list[Query]] = {}

    def sort_in(interval: Interval) -> None:
        queries.setdefault(stage_key(interval), []).extend(recorder.queries)
        recorder.queries = []

    context = replace(session.context, intersector=recorder)  # type: ignore[arg-type]  # a stand-in
    render_image(context, session.scene.camera, StageClock(sort_in))
    return {name: batches for name, batches in queries.items() if batches}


def bare_cpu_s(embree: Any, queries: Sequence[Query]) -> float:
    """This thread's CPU time for bare embreex calls of the queries, batch by batch [s]."""
    limits = [None if query.limit is None else query.limit.copy() for query in queries]  # embreex overwrites them
    start = time.thread_time()
    for query, limit in zip(queries, limits, strict=True):
        if limit is None:
            embree.run(query.origin, query.direction, query="INTERSECT", output=True)
        else:
            embree.run(query.origin, query.direction, dists=limit, query="OCCLUDED")
    return time.thread_time() - start


def stage_rates(session: Session, repeats: int = 3) -> dict[str, dict[str, float]]:
    """For each stage that traces: rays, its cpu_s, and the share of it that bare embreex takes for the same rays.

    session   of one thread, so that a stage's CPU time is that of one thread as well
    The share is the median of ratios from `repeats` turns of picture and bare calls. Empty without embreex.
    """
    embree = getattr(session.context.intersector, "embree", None)
    if embree is None:
        return {}
    queries = record_queries(session)
    turns: dict[str, list[tuple[float, float]]] = {name: [] for name in queries}
    for _ in range(repeats):
        spent: dict[str, float] = {}
        for interval in session.render().clock.intervals:
            spent[stage_key(interval)] = spent.get(stage_key(interval), 0.0) + interval.cpu_s
        for name, batches in queries.items():
            turns[name].append((spent[name], bare_cpu_s(embree, batches)))
    return {
        name: {
            "rays": sum(len(batch.origin) for batch in queries[name]),
            "cpu_s": float(np.median([cpu_s for cpu_s, _ in pairs])),
            "share_of_bare": float(np.median([bare_s / cpu_s for cpu_s, bare_s in pairs])),
        }
        for name, pairs in turns.items()
    }


def shrink(picture: F4, height: int | None) -> F4:
    """Box-filter a picture down to `height` rows, an integral fraction of its own."""
    if height is None or height == len(picture):
        return picture
    step = len(picture) // height
    blocks = picture.reshape(height, step, picture.shape[1] // step, step, 3)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64), np.float32)


def machine() -> str:
    """The machine in a sentence."""
    system = f"{platform.system()}, Python {platform.python_version()}"
    return f"Machine: {processor_name()}, {usable_cores()} cores, {system}."


def processor_name() -> str:
    """The processor's name as the system tells it."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or os.environ.get("PROCESSOR_IDENTIFIER", platform.machine())
