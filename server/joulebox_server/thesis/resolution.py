"""Resolution: four configurations of each method at several sizes, by the pixel."""

from itertools import pairwise
from typing import Any

from joulebox_server.analysis.intervals import Interval
from joulebox_server.thesis import quantities
from joulebox_server.thesis.batch import THESIS, Batch, Figure, Finding, Plan, Sweep, Verdict
from joulebox_server.thesis.claims import claims_of
from joulebox_server.thesis.judging import between, every, finding, largest, ratio, rises, smallest, told
from joulebox_server.thesis.results import MissingError, Point, Results, along, compared

SCENE = "cornell-spheres"
PHOTONS, TOLERANCES = (50_000, 100_000, 175_000, 200_000), (0.05, 0.1, 0.2, 0.3)
NAMES = {"dv": "global_photons", "fg": "irradiance_cache_tolerance"}
REFERENCE: dict[str, Any] = {"dv": 250_000, "fg": 0.02}
BASES: dict[str, dict[str, Any]] = {
    "dv": {"indirect": "direct_visualization", "caustics": False, "global_photons": 250_000},
    "fg": {
        "indirect": "final_gather",
        "caustic_photons": 20_000,
        "global_photons": 100_000,
        "photon_spacing": 4,
        "irradiance_cache_tolerance": 0.02,
    },
}
SIZES = {"dv": (128, 256, 512), "fg": (64, 128, 256)}
"""Of a quick run, where 512x512 by final gathering is too dear."""
REPEATS = (4, 4, 2)
"""Of a quick run at these sizes."""
FULL_SIZES = (128, 256, 512, 1024)


def sweeps(plan: Plan) -> list[Sweep]:
    """A sweep for each method and size, since references are of one size."""
    return [
        {
            "name": f"resolution-{method}-{side}",
            "scenes": [SCENE],
            "settings": {**THESIS, **BASES[method]} | {"width": side, "height": side},
            "rule": "list",
            "configurations": [{NAMES[method]: value} for value in values],
            "controls": 0,
            **({"repeats": REPEATS[SIZES[method].index(side)]} if plan.quick else {}),
            "reference": {"settings": {NAMES[method]: REFERENCE[method]}},
        }
        for method, values in (("dv", PHOTONS), ("fg", TOLERANCES))
        for side in plan.pick(SIZES[method], FULL_SIZES)
    ]


def sizes(results: Results, method: str) -> list[int]:
    """The sizes that a method was rendered at, rising. Raises MissingError for fewer than two."""
    prefix = f"resolution-{method}-"
    found = sorted({int(row.sweep.removeprefix(prefix)) for row in results.rows if row.sweep.startswith(prefix)})
    if len(found) < 2:
        raise MissingError(f"{method} was rendered at fewer than two sizes")
    return found


def at(results: Results, method: str, side: int) -> list[Point]:
    """The four configurations at a size, in order of what they vary. Raises MissingError unless all are there."""
    found = [point for _, point in along(results.points(f"resolution-{method}-{side}"), NAMES[method])]
    if len(found) != len(PHOTONS):
        raise MissingError(f"of the four configurations of {method} at {side}x{side} {len(found)} are there")
    return found


def _a_pixel(point: Point) -> Interval:
    return point.cost.scaled(1 / point.pixels)


def _tolerance(results: Results) -> Finding:
    verdicts, least = [], []
    for side in sizes(results, "fg"):
        costs = [point.cost for point in reversed(at(results, "fg", side))]
        verdicts.append(rises(costs))
        least.append(ratio(costs[-1], costs[0]))
    return finding(smallest(least), every(verdicts), "the least cost of tolerance 0.05 over 0.3")


def _lower_is_dearer(results: Results) -> Finding:
    steps = []
    for method, place in (("dv", -1), ("fg", 1)):
        costs = [_a_pixel(at(results, method, side)[place]) for side in sizes(results, method)]
        steps += [ratio(lower, higher) for lower, higher in pairwise(costs)]
    least = smallest(steps)
    return finding(
        least, every([between(step, low=1.0) for step in steps]), "a pixel of a lower resolution costs at least"
    )


def _alike(method: str) -> Any:
    def judge(results: Results) -> Finding:
        spreads = []
        for place in range(len(PHOTONS)):
            each = [at(results, method, side)[place].per_pixel for side in sizes(results, method)]
            known = [one for one in each if one is not None and one.value > 0]
            spreads.append(ratio(largest(known), smallest(known)))
        verdict = every([between(spread, high=1.5) for spread in spreads])
        return finding(largest(spreads), verdict, "the largest difference a pixel over the smallest, at most")

    return judge


def _spread(results: Results) -> Finding:
    common = sorted(set(sizes(results, "dv")) & set(sizes(results, "fg")))
    verdicts: list[Verdict] = []
    told_of = []
    for side in common:
        own = {}
        for method in ("fg", "dv"):
            costs = [_a_pixel(point) for point in at(results, method, side)]
            own[method] = ratio(largest(costs), smallest(costs))
        verdicts.append(between(ratio(own["fg"], own["dv"]), low=1.0))
        told_of.append((side, own))
    side, last = told_of[-1]
    words = f"at {side}x{side} the dearest over the cheapest: direct visualisation {told(last['dv'])}, final gathering"
    return finding(last["fg"], every(verdicts), words)


def _raw(results: Results) -> Finding:
    ranges = {128: (20.0, 350.0), 512: (400.0, 6500.0)}
    inside: dict[int, list[Verdict]] = {}
    words = []
    for side, (low, high) in ranges.items():
        found = [compared(point) for point in at(results, "dv", side)]
        inside[side] = [between(one, low, high) for one in found]
        words.append(f"at {side}x{side} {smallest(found).value:.3g} to {largest(found).value:.3g}")
    everything = [one for verdicts in inside.values() for one in verdicts]
    verdict: Verdict = "unclear"
    if all(one == "holds" for one in everything):
        verdict = "holds"
    elif any(all(one == "fails" for one in verdicts) for verdicts in inside.values()):
        verdict = "fails"
    least = compared(at(results, "dv", 512)[0])
    return Finding(least, "", verdict, "differences are " + "; ".join(words))


CLAIMS = claims_of(
    "resolution",
    {
        "fig54": _tolerance,
        "fig55": _lower_is_dearer,
        "fig56": _alike("dv"),
        "fig57": _spread,
        "fig58": _alike("fg"),
        "6.4": _raw,
    },
)


def _by_side(method: str, noun: str) -> quantities.Lines:
    def lines(results: Results) -> quantities.Series:
        found: dict[str, list[tuple[Any, Point]]] = {}
        for side in sizes(results, method):
            for point in at(results, method, side):
                found.setdefault(f"{noun} {point.settings[NAMES[method]]:,g}", []).append((side, point))
        return found

    return lines


def _tolerances(results: Results) -> quantities.Series:
    return {f"{side}x{side}": along(at(results, "fg", side), NAMES["fg"]) for side in sizes(results, "fg")}


def _both_methods(results: Results) -> quantities.Series:
    return {**_by_side("dv", "photons")(results), **_by_side("fg", "tolerance")(results)}


SIDE = "width and height [pixels]"
FIGURES = (
    Figure("54", "Cost over tolerance at each resolution", "",
           quantities.over(quantities.COST, _tolerances, "tolerance", "resolution", log_y=True)),
    Figure("55", "Cost a pixel over resolution, final gathering", "",
           quantities.over(quantities.COST_PER_PIXEL, _by_side("fg", "tolerance"), SIDE, "configuration", log_x=True)),
    Figure("56", "Difference a pixel over resolution, direct visualisation", "",
           quantities.over(quantities.DIFFERENCE_PER_PIXEL, _by_side("dv", "photons"), SIDE, "configuration",
                           log_x=True)),
    Figure("57", "Cost a pixel over resolution, both methods",
           "Lines of photons are direct visualisation, lines of tolerance final gathering.",
           quantities.over(quantities.COST_PER_PIXEL, _both_methods, SIDE, "configuration", log_x=True, log_y=True)),
    Figure("58", "Difference a pixel over resolution, final gathering", "",
           quantities.over(quantities.DIFFERENCE_PER_PIXEL, _by_side("fg", "tolerance"), SIDE, "configuration",
                           log_x=True)),
)  # fmt: skip


def advice(results: Results) -> list[str]:
    """What a pixel costs at the ends of the range."""
    own = sizes(results, "fg")
    small, large = (_a_pixel(at(results, "fg", side)[1]) for side in (own[0], own[-1]))
    return [
        f"Resolution: a small picture saves less than its pixels suggest. By final gathering at tolerance 0.1 a pixel "
        f"of {own[0]}x{own[0]} costs {told(ratio(small, large))} times one of {own[-1]}x{own[-1]}."
    ]


BATCH = Batch(
    "resolution",
    "Resolution",
    "Is what was learnt at one size true of others? Four configurations of direct visualisation (50k to 200k photons) "
    "and of final gathering (tolerance 0.05 to 0.3; 100k photons, irradiance at every 4th) are rendered at "
    "several sizes, in a quick run 128 to 512 pixels a side by direct visualisation, 64 to 256 by final gathering.",
    sweeps,
    FIGURES,
    CLAIMS,
    advice,
)
