"""Caustic photons: what they cost in map creation and in direct lighting, with and without hints."""

from typing import Any

from joulebox_server.thesis import quantities
from joulebox_server.thesis.batch import THESIS, Batch, Figure, Finding, Plan, Sweep, Tile, again
from joulebox_server.thesis.claims import claims_of
from joulebox_server.thesis.judging import between, every, finding, ratio, told
from joulebox_server.thesis.results import Point, Results, along, only

SCENE = "cornell-spheres"
GLOBAL = (50_000, 100_000, 200_000, 250_000, 500_000)
CAUSTIC = (10_000, 20_000, 30_000)
HINTED = (50_000, 200_000)
BASE: dict[str, Any] = {
    **THESIS,
    "indirect": "direct_visualization",
    "global_photons": 250_000,
    "caustics": True,
    "caustic_photons": 30_000,
}


def sweeps(plan: Plan) -> list[Sweep]:
    """Caustic times global photons without hints, and some with hints; a quick run renders what is compared again."""
    side = plan.pick(128, 256)
    changes: list[dict[str, Any]] = [{"global_photons": count, "caustics": False} for count in GLOBAL]
    changes += [{"global_photons": g, "caustic_photons": c} for c in CAUSTIC for g in GLOBAL]
    changes += [{"global_photons": g, "caustic_photons": c, "caustic_hints": True} for c in CAUSTIC for g in HINTED]
    sweep: Sweep = {
        "name": "caustics",
        "scenes": [SCENE],
        "settings": BASE | {"width": side, "height": side},
        "rule": "list",
        "configurations": changes,
        "reference": {"settings": {"global_photons": 250_000}},
    }
    if not plan.quick:
        return [sweep]
    compared: list[dict[str, Any]] = [{"global_photons": n, "caustics": False} for n in (50_000, 200_000, 250_000)]
    compared += [{"global_photons": n, "caustic_photons": 10_000} for n in (50_000, 200_000)]
    compared += [{"global_photons": 250_000, "caustic_photons": count} for count in CAUSTIC]
    compared += [{"global_photons": 50_000, "caustic_photons": 10_000, "caustic_hints": True}]
    return [sweep, again(sweep, 8, compared)]


def line(results: Results, count: int, *, hints: bool = False) -> list[tuple[float, Point]]:
    """Points with so many caustic photons along the global ones; 0 is without a caustic map."""
    wanted: dict[str, Any] = {"caustics": False}
    if count:
        wanted = {"caustics": True, "caustic_photons": count, "caustic_hints": hints}
    return along(results.points("caustics", SCENE, **wanted), "global_photons")


def _at(results: Results, photons: int, count: int, *, hints: bool = False) -> Point:
    return only([point for x, point in line(results, count, hints=hints) if x == photons])


def _map_creation(results: Results) -> Finding:
    times = {
        photons: ratio(_at(results, photons, 10_000).stage("photon_map"), _at(results, photons, 0).stage("photon_map"))
        for photons in (50_000, 200_000)
    }
    verdict = every([between(times[50_000], low=2.0), between(times[200_000], high=1.15)])
    return finding(
        times[50_000], verdict, f"map creation with 10k over without: at 200k {told(times[200_000])}; at 50k"
    )


def _direct(results: Results) -> Finding:
    alone = _at(results, 250_000, 0).stage("direct")
    times = [ratio(_at(results, 250_000, count).stage("direct"), alone) for count in CAUSTIC]
    worst = max(times, key=lambda one: abs(one.value - 1))
    return finding(
        worst,
        every([between(one, 0.9, 1.1) for one in times]),
        "direct lighting with over without caustics, where farthest from 1",
    )


CLAIMS = claims_of("caustics", {"fig33": _map_creation, "fig37": _direct})


def _lines(results: Results) -> quantities.Series:
    found = {f"{count:,}" if count else "none": line(results, count) for count in (0, *CAUSTIC)}
    return found | {f"{count:,}, hints": line(results, count, hints=True) for count in CAUSTIC}


def _pictures(results: Results) -> list[Tile]:
    points = [("no caustic map", _at(results, 250_000, 0))]
    points += [(f"{count:,} caustic photons", _at(results, 250_000, count)) for count in CAUSTIC]
    points += [("10,000 with hints, 200k global", _at(results, 200_000, 10_000, hints=True))]
    return [Tile(point.rows[0].image_sha256, words) for words, point in points if point.rows[0].image_sha256]


OURS = "The thesis' own drawing of this number is not at hand; this is what ours shows in its place."
FIGURES = (
    Figure("25", "Caustics of more and more photons", OURS, _pictures),
    Figure("33", "Map creation over photons, with caustic photons", "Caustic and global photons share one emission "
           "until both maps are full; with hints the caustic map has an emission of its own.",
           quantities.over(quantities.stage("photon_map"), _lines, "global photons", "caustic photons")),
    Figure("37", "Direct lighting over photons, with caustic photons", "",
           quantities.over(quantities.stage("direct"), _lines, "global photons", "caustic photons")),
)  # fmt: skip


def advice(results: Results) -> list[str]:
    """What hints are worth."""
    plain, hinted = (_at(results, 50_000, 10_000, hints=hints).stage("photon_map") for hints in (False, True))
    times = ratio(hinted, plain)
    advised = {"holds": "set caustic hints", "fails": "leave caustic hints off", "unclear": "hints hardly matter"}
    return [
        f"Caustics: {advised[between(times, high=1.0)]} where a mirror and a glass sphere are as large as in "
        f"{SCENE}; map creation with 10,000 caustic photons costs {told(times)} times as much with them. They are for "
        "mirrors and glass that few photons meet."
    ]


BATCH = Batch(
    "caustics",
    "Caustics",
    "Mirrors and glass focus light. A caustic map of photons of its own shows that sharply; what does it cost to fill "
    "it beside the global map, and does it change what direct lighting costs? Hints (photons aimed at mirrors and "
    "glass) go beyond the thesis.",
    sweeps,
    FIGURES,
    CLAIMS,
    advice,
)
