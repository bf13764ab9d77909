"""Direct lighting's own trade-off, which the thesis' chapter 8 asks for: shadow rays, direct photons, their test."""

from typing import Any

from joulebox_server.thesis import quantities
from joulebox_server.thesis.batch import THESIS, Batch, Figure, Finding, Plan, Sweep, again
from joulebox_server.thesis.claims import claims_of
from joulebox_server.thesis.judging import between, every, finding, largest, ratio, saving, told, told_share
from joulebox_server.thesis.ratings import limit_of
from joulebox_server.thesis.results import Point, Results, along, compared, only

SCENE = "cornell-boxes"
RAYS = (16, 64, 144, 256)
PHOTONS = (1_000, 10_000, 100_000)
BASE: dict[str, Any] = {**THESIS, "indirect": "none", "shadow_rays": 144, "use_shadow_photons": False}


def sweeps(plan: Plan) -> list[Sweep]:
    """Shadow rays without the test, and times direct photons with it; indirect light is left out.

    A quick run renders again what is compared, which is all at 144 rays, and all without the test.
    """
    changes: list[dict[str, Any]] = [{"shadow_rays": rays, "use_shadow_photons": False} for rays in RAYS]
    changes += [
        {"shadow_rays": rays, "use_shadow_photons": True, "direct_photons": count} for count in PHOTONS for rays in RAYS
    ]
    sweep: Sweep = {
        "name": "direct",
        "scenes": [SCENE],
        "settings": BASE | {"width": 256, "height": 256},
        "rule": "list",
        "configurations": changes,
        "reference": {"settings": {"shadow_rays": 144}},
    }
    compared = [changed for changed in changes if changed["shadow_rays"] == 144 or not changed["use_shadow_photons"]]
    return [sweep, again(sweep, 8, compared)] if plan.quick else [sweep]


def line(results: Results, photons: int) -> list[tuple[float, Point]]:
    """Points along shadow rays: with the test by so many direct photons, 0 being without it."""
    wanted: dict[str, Any] = {"use_shadow_photons": bool(photons)}
    if photons:
        wanted["direct_photons"] = photons
    return along(results.points("direct", SCENE, **wanted), "shadow_rays")


def at(results: Results, photons: int, rays: int) -> Point:
    """One of them. Raises MissingError without it."""
    return only([point for x, point in line(results, photons) if x == rays])


def _rays(results: Results) -> Finding:
    times = ratio(at(results, 0, 256).stage("direct"), at(results, 0, 16).stage("direct"))
    fewer = [at(results, 0, rays) for rays in RAYS if rays < 144]
    least = min((compared(point) for point in fewer), key=lambda one: one.value)
    verdict = every([between(times, low=2.0), between(least, high=limit_of(fewer[0]))])
    return finding(times, verdict, f"the best number below 144 differs by {told(least)}; direct cost of 256 over 16")


def _saves(results: Results) -> Finding:
    # both bookings of it: the test is paid for in map creation
    costs = [at(results, photons, 144).stage("direct") for photons in (10_000, 0)]
    whole = ratio(at(results, 10_000, 144).cost, at(results, 0, 144).cost)
    left = ratio(*costs)
    return finding(
        left, between(left, high=0.5), f"the image with the test over without {told(whole)}; direct lighting alone"
    )


def _picture(results: Results) -> Finding:
    points = [at(results, photons, 144) for photons in PHOTONS]
    worst = largest([compared(point) for point in points])
    verdict = every([between(compared(point), high=limit_of(point)) for point in points])
    return finding(worst, verdict, "the largest difference")


CLAIMS = claims_of("direct", {"ch8-rays": _rays, "ch8-photons": _saves, "ch8-picture": _picture})


def _lines(results: Results) -> quantities.Series:
    return {f"{count:,} photons" if count else "no test": line(results, count) for count in (0, *PHOTONS)}


def _limit_lines(results: Results) -> quantities.Series:
    return {name: [(x, p) for x, p in points if p.difference] for name, points in _lines(results).items()}


FIGURES = (
    Figure("direct-cost", "Cost over shadow rays, with and without the shadow test", "Direct light alone.",
           quantities.over(quantities.COST, _lines, "shadow rays", "shadow test")),
    Figure("direct-difference", "Difference over shadow rays, with and without the shadow test", "Direct light alone.",
           quantities.over(quantities.LIMITED, _lines, "shadow rays", "shadow test")),
    Figure("direct-trade-off", "Cost against difference of direct lighting", "",
           quantities.trade_off(_limit_lines, "shadow test", log=False)),
)  # fmt: skip


def advice(results: Results) -> list[str]:
    """The cheapest acceptable way to light directly."""
    reference = results.reference("direct", SCENE)
    fit = [
        (p.cost.value, rays, name, p)
        for name, points in _limit_lines(results).items()
        for rays, p in points
        if compared(p).value <= limit_of(p)
    ]
    if not fit:
        return []
    _, rays, name, best = min(fit, key=lambda one: one[0])
    return [
        f"Direct lighting: {rays:.0f} shadow rays, {name}, is the cheapest within the acceptable difference; it saves "
        f"{told_share(saving(best.cost, reference.cost))} of what 144 rays cost without the shadow test."
    ]


BATCH = Batch(
    "direct",
    "Direct lighting",
    "The thesis left direct lighting as it was and asked in its chapter 8 what it could save. Shadow rays, direct "
    "photons and the shadow test are varied in the box with two boxes; indirect light is left out.",
    sweeps,
    FIGURES,
    CLAIMS,
    advice,
)
