"""What pictures cost and how far they are from the truth: time against error, on this machine.

Error is relMSE, the mean over pixels and channels of (3 a - 3 b)^2 / ((3 b)^2 + 0.01) with the worst 0.1 % dropped,
against the converged path tracing of another renderer that a scene carries as reference.exr. Rates of rays are
given as a ratio to bare embreex, measured in the same run on one thread, because machines are noisy.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from joulebox_render.images import read_exr
from joulebox_render.pool import usable_cores
from joulebox_render.records import F4
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


def relative_mse(image: F4, reference: F4) -> float:
    """relMSE at exposure 3, the worst 0.1 % of values dropped."""
    scaled, truth = 3.0 * image.astype(np.float64), 3.0 * reference.astype(np.float64)
    error = np.sort(((scaled - truth) ** 2 / (truth**2 + 0.01)).ravel())
    return float(error[: int(len(error) * 0.999)].mean())


def run_bench(say: Callable[[str], None], quick: bool = False) -> str:
    """Measure every configuration on every scene that carries a reference; returns a Markdown report."""
    lines = [
        f"Machine: {machine_name()}, {usable_cores()} cores, {platform.system()}, Python {platform.python_version()}.",
        "", "| scene | settings | CPU s | time s | relMSE | mean brightness |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    size = {"width": 64, "height": 64} if quick else {}
    for entry in list_scenes():
        reference_file = entry.path / "reference.exr"
        if not reference_file.is_file():
            continue
        reference = shrink(read_exr(reference_file), size.get("height"))
        for name, values in CONFIGURATIONS.items():
            say(f"{entry.name}: {name}")
            with Session(entry.path, make_settings(values, size)) as session:
                image = session.render()
            lines.append(f"| {entry.name} | {name} | " + " | ".join(figures(image, reference)) + " |")
    say("rates of rays")
    lines += ["", "| stage of cornell-boxes, one thread | Mray per CPU second | of bare embreex |", "|---|---|---|"]
    lines += [f"| {name} | {rate:.2f} | {rate / bare:.2f} |" for name, rate, bare in ray_rates(size)]
    return "\n".join(lines) + "\n"


def figures(image: Image, reference: F4) -> Iterator[str]:
    """Cells of one row."""
    yield f"{image.cpu_s:.2f}"
    yield f"{image.time_s:.2f}"
    yield f"{relative_mse(image.pixels, reference):.4f}"
    yield f"{100 * (float(image.pixels.mean()) / float(reference.mean()) - 1):+.2f} %"


def ray_rates(size: dict[str, int]) -> Iterator[tuple[str, float, float]]:
    """(stage, its rays per CPU second, those of bare embreex queries of its kind), in millions."""
    with Session("cornell-boxes", make_settings({"threads": 1, "samples_per_pixel": 1}, size)) as session:
        origin, direction = interior_rays(session, 400_000)
        embree = session.context.intersector.embree
        closest = bare_rate(lambda: embree.run(origin, direction, query="INTERSECT", output=True), len(origin))
        limit = np.full(len(origin), 0.2, np.float32)
        occluded = bare_rate(lambda: embree.run(origin, direction, dists=limit.copy(), query="OCCLUDED"), len(origin))
        stages = session.render().clock.totals()
    for name, bare in (("direct", occluded), ("indirect", closest)):
        yield name, stages[name]["rays"] / stages[name]["cpu_s"] / 1e6, bare


def interior_rays(session: Session, count: int) -> tuple[F4, F4]:
    """Incoherent rays from points inside the scene's box into all directions."""
    random = np.random.default_rng(1)
    low, high = session.scene.vertices.min(axis=0), session.scene.vertices.max(axis=0)
    origin = (low + (high - low) * random.random((count, 3))).astype(np.float32)
    direction = random.standard_normal((count, 3))
    return origin, (direction / np.linalg.norm(direction, axis=1)[:, None]).astype(np.float32)


def bare_rate(query: Callable[[], object], count: int, repeats: int = 5) -> float:
    """Median rate of a query of `count` rays [millions a second]."""
    rates = []
    for _ in range(repeats):
        start = time.thread_time()
        query()
        rates.append(count / (time.thread_time() - start) / 1e6)
    return float(np.median(rates))


def shrink(picture: F4, height: int | None) -> F4:
    """Box-filter a picture down to `height` rows, an integral fraction of its own."""
    if height is None or height == len(picture):
        return picture
    step = len(picture) // height
    blocks = picture.reshape(height, step, picture.shape[1] // step, step, 3)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64), np.float32)


def machine_name() -> str:
    """The processor's name as the system tells it."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or os.environ.get("PROCESSOR_IDENTIFIER", platform.machine())
