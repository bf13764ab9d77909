"""What single features gain: samplers at equal rays, the shadow test, and our hierarchy against Embree."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from joulebox_render.bench import shadow_test_report
from joulebox_render.intersect import EmbreeScene, Intersector
from joulebox_render.records import F4
from joulebox_render.session import Session
from joulebox_render.settings import make_settings

from .rates import NO_EMBREE
from .table import Row

Say = Callable[[str], None]

SCENE = "cornell-boxes"
SMALL = {"width": 96, "height": 96}
SAMPLED: dict[str, dict[str, Any]] = {
    "direct light, 4 x 4 shadow rays a pixel": {"indirect": "none", "samples_per_pixel": 4, "shadow_rays": 4},
    "final gather, 4 x 16 rays a pixel": {
        "samples_per_pixel": 4, "shadow_rays": 16, "final_gather_rays": 16, "irradiance_cache_tolerance": 0.0,
    },
}  # fmt: skip
# What takes the place of these in the picture that errors are taken to.
FINER = {"samples_per_pixel": 16, "shadow_rays": 64, "final_gather_rays": 144}
SHADOW_SCENES = ("cornell-boxes", "cornell-spheres", "many-lights")
BVH_GOAL, RAYS = 0.25, 200_000


def sampler_rows(say: Say) -> Iterator[Row]:
    """Mean squared error of each sampler at equal rays, relative to independent samples; pixels at edges left out."""
    say("samplers at equal rays")
    for what, values in SAMPLED.items():
        finer = {name: FINER[name] for name in values if name in FINER}
        truth = picture({**values, **finer, "sampler": "sobol", "seed": 1})
        error = {sampler: squared_error(picture({**values, "sampler": sampler}), truth)
                 for sampler in ("independent", "stratified", "sobol")}  # fmt: skip
        stratified, sobol = (error[name] / error["independent"] for name in ("stratified", "sobol"))
        yield Row(f"error of samples, {what}", "sobol < stratified < independent",
                  f"independent 1, stratified {stratified:.2f}, sobol {sobol:.2f}", sobol < stratified < 1)  # fmt: skip


def picture(values: Mapping[str, Any]) -> F4:
    """A picture of the scene."""
    with Session(SCENE, make_settings(SMALL, values)) as session:
        return session.render().pixels


def squared_error(image: F4, truth: F4) -> float:
    """Mean squared error without the worst hundredth of the pixels, which edges own."""
    error = np.sort(((image - truth) ** 2).mean(axis=2).ravel())
    return float(error[: int(0.99 * len(error))].mean())


def shadow_rows(say: Say, size: Mapping[str, Any]) -> Iterator[Row]:
    """What the shadow test saves, net of its own cost, and what it adds of error."""
    for scene in SHADOW_SCENES:
        say(f"shadow test on {scene}")
        layers = ({"shadow_rays": 36, "samples_per_pixel": 4}, SMALL if scene == "many-lights" else size)
        found = shadow_test_report(scene, *layers, repeats=3)
        yield Row(
            f"shadow test, {scene}", "pays, or is off by default",
            f"{100 * found['rays_saved']:.0f} % of rays, {100 * found['cpu_saved']:.0f} % of direct CPU time net, "
            f"{100 * found['pixels_changed']:.2g} % of pixels changed, by {found['largest_change']:.2g} at most", True,
        )  # fmt: skip


def hierarchy_row(say: Say) -> Row:
    """Our hierarchy's rays a second over Embree's: incoherent closest hits and occlusion in the large bunny's box."""
    what, goal = "numba BVH of bare embreex on the bunny (closest, occlusion)", f">= {100 * BVH_GOAL:.0f} %"
    if EmbreeScene is None:
        return Row.not_run(what, goal, NO_EMBREE)
    say("our hierarchy against Embree")
    with Session("cornell-bunny", make_settings({"threads": 1}, SMALL), {"size": "large"}) as session:
        tables = session.context.tables
    random = np.random.default_rng(1)
    low, high = tables.vertices.min(axis=0), tables.vertices.max(axis=0)
    origin = (low + (high - low) * random.random((RAYS, 3))).astype(np.float32)
    direction = random.standard_normal((RAYS, 3))
    direction = (direction / np.linalg.norm(direction, axis=1)[:, None]).astype(np.float32)
    limit = np.full(RAYS, 0.2, np.float32)
    ours, theirs = (Intersector(tables, name) for name in ("bvh", "embree"))
    shares = [
        cpu_s(lambda: theirs.closest(origin, direction)) / cpu_s(lambda: ours.closest(origin, direction)),
        cpu_s(lambda: theirs.occluded(origin, direction, limit))
        / cpu_s(lambda: ours.occluded(origin, direction, limit)),
    ]
    return Row(what, goal, ", ".join(f"{100 * share:.0f} %" for share in shares), min(shares) >= BVH_GOAL)


def cpu_s(query: Callable[[], object], turns: int = 5) -> float:
    """Median CPU time of a query on this thread, after one to warm up [s]."""
    query()
    taken = []
    for _ in range(turns):
        start = time.thread_time()
        query()
        taken.append(time.thread_time() - start)
    return statistics.median(taken)
