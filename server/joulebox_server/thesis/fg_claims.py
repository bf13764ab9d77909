"""The thesis' claims on final gathering: the functions that judge them; their words stand in claims.toml."""

from itertools import pairwise
from typing import Any

from joulebox_server.analysis.intervals import Interval
from joulebox_server.thesis.batch import Finding, Verdict
from joulebox_server.thesis.claims import claims_of
from joulebox_server.thesis.fg_points import FEWER_PHOTONS, REFERENCE_PHOTONS, at
from joulebox_server.thesis.judging import (
    between,
    difference,
    every,
    finding,
    largest,
    ratio,
    saving,
    share,
    smallest,
    told,
)
from joulebox_server.thesis.results import Point, Results, at_256


def _both_stages(results: Results) -> Finding:
    shares = [
        share(point.stage("direct", "indirect"), point.stage("photon_map", "caustics"))
        for point in (at(results), at(results, global_photons=FEWER_PHOTONS))
    ]
    least = smallest(shares)
    return finding(least, between(least, low=0.98), "the smaller of the shares of direct and indirect together")


STEPS: dict[str, dict[str, Any]] = {
    "tolerance 0.1": {"irradiance_cache_tolerance": 0.1},
    "every 8th photon": {"photon_spacing": 8},
    "144 rays": {"final_gather_rays": 144},
    "100k photons": {"global_photons": 100_000},
}
"""In the thesis' order of what they save a unit of difference."""


def _saved_per_unit(results: Results, point: Point) -> Interval:
    """Cost saved a unit of difference at 256x256, of the reference's cost; a difference counts as 1 at least."""
    units = at_256(point)
    saved = saving(point.cost, at(results).cost)
    low, high = max(units.low, 1.0), max(units.high, 1.0)
    ends = [bound / unit for bound in (saved.low, saved.high) for unit in (low, high)]
    middle = saved.value / max(units.value, 1.0)
    return Interval(value=middle, low=min(*ends, middle), high=max(*ends, middle))


def _ranking(results: Results) -> Finding:
    found = {name: _saved_per_unit(results, at(results, **changed)) for name, changed in STEPS.items()}
    worths = list(found.values())
    order: list[Verdict] = []
    for one, other in pairwise(worths):
        order.append("holds" if one.low > other.high else "fails" if one.high < other.low else "unclear")
    ranked = sorted(found, key=lambda name: -found[name].value)
    words = "; ".join(f"{name} {100 * found[name].value:.2g} %" for name in ranked)
    return Finding(worths[0], "share a unit", every(order), f"saved a unit of difference: {words}")


def _spacing_cost(results: Results) -> Finding:
    verdicts: list[Verdict] = []
    saved = {}
    for photons in (REFERENCE_PHOTONS, FEWER_PHOTONS):
        none, one, four, eight = (at(results, photon_spacing=n, global_photons=photons).cost for n in (0, 1, 4, 8))
        verdicts += [between(ratio(one, other), low=1.0) for other in (four, eight, none)]
        saved[photons] = saving(eight, none)
        verdicts.append(between(saved[photons], low=0.0))
    words = f"every 8th saves {told(saved[FEWER_PHOTONS])} of the cost at 100k photons, and at 250k"
    return finding(saved[REFERENCE_PHOTONS], every(verdicts), words)


def _spacing_difference(results: Results) -> Finding:
    many = largest([at_256(at(results, photon_spacing=n)) for n in (4, 8)])
    few = [at_256(at(results, photon_spacing=n, global_photons=FEWER_PHOTONS)) for n in (0, 1, 4, 8)]
    spread = ratio(largest(few), smallest(few))
    verdicts = [between(many, high=5), between(spread, high=1.5), between(smallest(few), low=20),
                between(largest(few), high=80)]  # fmt: skip
    words = (
        f"100k photons differ by {told(smallest(few))} to {told(largest(few))}; the larger of spacings 4 and 8 at 250k"
    )
    return finding(many, every(verdicts), words)


def _tolerance_cost(results: Results) -> Finding:
    fine, some, more, most = (at(results, irradiance_cache_tolerance=value).cost for value in (0.02, 0.1, 0.15, 0.3))
    saved = saving(some, fine)
    levels = ratio(difference(more, most), difference(fine, more))
    verdict = every([between(saved, low=1 / 3), between(levels, high=0.2)])
    words = f"0.15 to 0.3 saves {told(levels)} of what 0.02 to 0.15 does; share of the cost that 0.1 saves"
    return finding(saved, verdict, words)


def _tolerance_difference(results: Results) -> Finding:
    found = at_256(at(results, irradiance_cache_tolerance=0.1))
    return finding(found, between(found, 15, 60), "difference of tolerance 0.1")


def _rays_cost(results: Results) -> Finding:
    few, some, many = (at(results, final_gather_rays=count).cost for count in (16, 144, 256))
    times, saved = ratio(many, few), saving(some, many)
    verdict = every([between(times, 3, 5), between(saved, low=0.2)])
    return finding(times, verdict, f"144 rays save {told(saved)} of the cost; cost of 256 over 16")


def _rays_difference(results: Results) -> Finding:
    few, some, more = (at_256(at(results, final_gather_rays=count)) for count in (16, 64, 144))
    spike = ratio(few, some)
    verdict = every([between(more, 10, 40), between(some, 40, 160), between(spike, low=3)])
    return finding(spike, verdict, f"144 rays differ by {told(more)}, 64 by {told(some)}; difference of 16 over 64")


CLAIMS = claims_of(
    "fg",
    {
        "fig31": _both_stages,
        "fig46": _ranking,
        "fig47": _spacing_cost,
        "fig48": _spacing_difference,
        "fig49": _tolerance_cost,
        "fig50": _tolerance_difference,
        "fig51": _rays_cost,
        "fig52": _rays_difference,
    },
)
