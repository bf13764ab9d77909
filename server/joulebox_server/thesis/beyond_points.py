"""Beyond the thesis: the sweeps that set each of its wishes beside doing without it."""

from collections.abc import Mapping, Sequence
from typing import Any

from joulebox_server.thesis.batch import THESIS, Plan, Sweep
from joulebox_server.thesis.fg_points import ELSEWHERE
from joulebox_server.thesis.results import Point, Results, only
from joulebox_server.thesis.stability_points import GOOD

TOLERANCES = (0.8, 1.6)
SAMPLERS = ("independent", "sobol")
RAYS = (16, 64)
IMPORTANCE_RAYS = 64
CAUSTIC: Mapping[str, Any] = {"caustic_photons": 20_000, "indirect": "none"}
"""A caustic map alone, since the scene cannot fill a global one."""
PATHS = (4, 16, 64, 256)
THREADS = (1, 2)
SINGLES: Mapping[str, Mapping[str, Any]] = {
    "tolerance 0.3": {"irradiance_cache_tolerance": 0.3},
    "64 rays": {"final_gather_rays": 64},
    "every 8th photon": {"photon_spacing": 8},
    "100k photons": {"global_photons": 100_000},
}
"""Each saves something against the thesis' reference of final gathering."""
COMBINED: Mapping[str, Any] = {name: value for changed in SINGLES.values() for name, value in changed.items()}
MAPPED: Mapping[str, Mapping[str, Any]] = {
    "final gathering": {},
    "final gathering, 16 rays": {"final_gather_rays": 16},
    "direct visualisation": {"indirect": "direct_visualization"},
}
"""Photon mapping that is set beside path tracing: the renderer's defaults but for these."""
LONGER = {"window_s": 1.0, "min_windows": 1, "max_windows": 1, "meter": "none"}
"""How a quick run times threads: over a second of images, since what they add is small."""


def sweeps(plan: Plan) -> list[Sweep]:
    """One sweep a question; all but the threads' compare seeds with a reference at another seed."""
    repeats = plan.pick(5, 8)
    paths = plan.pick(512, 4096)
    everywhere: dict[str, Any] = {"irradiance_cache_tolerance": 0.0}
    gather: list[dict[str, Any]] = [
        {"irradiance_cache_tolerance": t, "irradiance_gradients": on} for t in TOLERANCES for on in (True, False)
    ]
    gather += [{**everywhere, "sampler": name, "final_gather_rays": n} for n in RAYS for name in SAMPLERS]
    importance = [
        {"importance_sampling": on, "final_gather_rays": IMPORTANCE_RAYS, **everywhere} for on in (True, False)
    ]
    hints = [{"caustic_hints": on, **CAUSTIC} for on in (True, False)]
    path = {"indirect": "path"}
    witness = [{**path, "samples_per_pixel": n} for n in PATHS] + [dict(changed) for changed in MAPPED.values()]
    singles: list[dict[str, Any]] = [dict(changed) for changed in [*SINGLES.values(), COMBINED]]
    threads = _sweep(plan, "beyond-threads", "cornell-boxes", [{"threads": n} for n in THREADS], {}, repeats)
    thesis = {name: value for name, value in THESIS.items() if name != "preset"}
    return [
        _sweep(plan, "beyond-gather", "cornell-boxes", gather, GOOD, 8),
        _sweep(plan, "beyond-importance", "veach-door", importance, GOOD, 10),
        _sweep(plan, "beyond-hints", "caustic-ring", hints, {**GOOD, "indirect": "none"}, 10),
        _sweep(plan, "beyond-path", "cornell-boxes", witness, {**path, "samples_per_pixel": paths}, repeats),
        _sweep(plan, "beyond-combined", "cornell-boxes", singles, ELSEWHERE, repeats, {**thesis, **ELSEWHERE,
               "preset": "reference"}),
        threads | ({"measure": LONGER} if plan.quick else {}),
    ]  # fmt: skip


def _sweep(
    plan: Plan,
    name: str,
    scene: str,
    changes: Sequence[Mapping[str, Any]],
    reference: Mapping[str, Any],
    repeats: int,
    base: Mapping[str, Any] | None = None,
) -> Sweep:
    side = plan.pick(64, 256)
    return {
        "name": name,
        "scenes": [scene],
        "settings": {**(base or {}), "width": side, "height": side},
        "rule": "list",
        "configurations": [dict(changed) for changed in changes],
        "repeats": repeats,
        "controls": 0,
        "reference": {"settings": {**reference, "global_photons": reference.get("global_photons", 100_000)},
                      "seed_policy": "other"},
    }  # fmt: skip


def gathered(results: Results, **settings: Any) -> Point:
    """A point of the sweep of gradients and samplers. Raises MissingError without it."""
    return only(results.points("beyond-gather", **settings))


def gradients(results: Results, tolerance: float, *, on: bool) -> Point:
    """With or without irradiance gradients. Raises MissingError without it."""
    return gathered(results, irradiance_cache_tolerance=tolerance, irradiance_gradients=on, final_gather_rays=256)


def sampled(results: Results, sampler: str, rays: int) -> Point:
    """A gather at every point with one sampler. Raises MissingError without it."""
    return gathered(results, sampler=sampler, final_gather_rays=rays, irradiance_cache_tolerance=0.0)


def important(results: Results, *, on: bool) -> Point:
    """With or without importance sampling. Raises MissingError without it."""
    return only(results.points("beyond-importance", importance_sampling=on))


def hinted(results: Results, *, on: bool) -> Point:
    """With or without caustic hints. Raises MissingError without it."""
    return only(results.points("beyond-hints", caustic_hints=on))


def paths(results: Results) -> list[tuple[int, Point]]:
    """Path tracing by its paths a pixel."""
    found = [(n, results.points("beyond-path", indirect="path", samples_per_pixel=n)) for n in PATHS]
    return [(n, points[0]) for n, points in found if len(points) == 1]


def mapped(results: Results, name: str) -> Point:
    """Photon mapping beside path tracing. Raises MissingError without it."""
    wanted: dict[str, Any] = {"indirect": "final_gather", "final_gather_rays": 256, **MAPPED[name]}
    return only(results.points("beyond-path", **wanted))


def combined(results: Results, changed: Mapping[str, Any]) -> Point:
    """The thesis' reference with some settings changed. Raises MissingError without it."""
    return only(results.points("beyond-combined", **{**ELSEWHERE, **changed}))


def threaded(results: Results) -> list[tuple[int, Point]]:
    """The same picture by threads."""
    found = [(n, results.points("beyond-threads", threads=n)) for n in THREADS]
    return [(n, points[0]) for n, points in found if len(points) == 1]
