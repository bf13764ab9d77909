"""What the thesis wished for and did not have, each beside doing without it."""

import math
from itertools import pairwise

from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.words import figure
from joulebox_server.thesis import figures, quantities
from joulebox_server.thesis.batch import Batch, Figure, Finding, Spec
from joulebox_server.thesis.beyond_points import (
    COMBINED,
    IMPORTANCE_RAYS,
    MAPPED,
    PATHS,
    RAYS,
    SAMPLERS,
    SINGLES,
    THREADS,
    TOLERANCES,
    combined,
    gradients,
    hinted,
    important,
    mapped,
    paths,
    sampled,
    sweeps,
    threaded,
)
from joulebox_server.thesis.claims import claims_of
from joulebox_server.thesis.judging import between, every, finding, ratio, saving, told, told_share
from joulebox_server.thesis.ratings import limit_of
from joulebox_server.thesis.results import MissingError, Point, Results, compared
from joulebox_server.thesis.scatter import COST, DIFFERENCE


def _better(on: Point, off: Point, most_cost: float, least_gain: float, what: str) -> Finding:
    """Whether the picture is better by so much at most so much more cost."""
    # seed by seed: with and without it an image has the same photons
    apart = on.over(off, DIFFERENCE) or ratio(compared(on), compared(off))
    cost = on.over(off, COST) or ratio(on.cost, off.cost)
    verdict = every([between(apart, high=least_gain), between(cost, high=most_cost)])
    return finding(
        apart, verdict, f"{what} costs {told(cost)} times as much as without; its difference over that without"
    )


def _gradients(results: Results) -> Finding:
    tolerance = TOLERANCES[-1]
    on, off = (gradients(results, tolerance, on=value) for value in (True, False))
    return _better(on, off, 1.1, 0.9, f"an image with gradients at tolerance {tolerance}")


def _sobol(results: Results) -> Finding:
    independent, sobol = (sampled(results, name, RAYS[-1]) for name in SAMPLERS)
    return _better(sobol, independent, 1.1, 0.9, "a gather by Sobol's sequence")


def _importance(results: Results) -> Finding:
    on, off = (important(results, on=value) for value in (True, False))
    return _better(on, off, 1.25, 0.9, f"importance sampling of {IMPORTANCE_RAYS} rays")


def _hints(results: Results) -> Finding:
    on, off = (hinted(results, on=value) for value in (True, False))
    apart = on.over(off, DIFFERENCE) or ratio(compared(on), compared(off))
    whole = ratio(on.stage("photon_map"), off.stage("photon_map"))
    stored = [_stored(point) for point in (on, off)]
    each = whole.scaled(stored[1] / stored[0])
    verdict = every([between(each, high=0.5), between(apart, high=1.1)])
    words = f"{figure(stored[0])} caustic photons are stored with hints and {figure(stored[1])} without, and the "
    words += f"difference is {told(apart)} times that without; the cost of map creation a photon over that without"
    return finding(each, verdict, words)


def _stored(point: Point) -> float:
    """Caustic photons stored, on average. Raises MissingError where none is."""
    counts = [float(row.photons.get("caustic_stored", 0)) for row in point.rows]
    if not all(counts):
        raise MissingError("no caustic photon was stored")
    return math.fsum(counts) / len(counts)


def path_cost_at(results: Results, difference: float) -> tuple[Interval, bool]:
    """What path tracing costs for a difference, along its line in logarithms; and whether it is only a lower bound.

    Where no number of paths comes as near, the dearest of them costs less than what it would take. Raises MissingError
    where path tracing was not rendered with two numbers of paths.
    """
    line = [(point.cost, compared(point).value) for _, point in paths(results)]
    if len(line) < 2 or min(d for _, d in line) <= 0:
        raise MissingError("path tracing was not rendered with two numbers of paths that differ from the reference")
    if difference <= line[-1][1]:
        return line[-1][0], True
    if difference >= line[0][1]:
        return line[0][0], False
    for (cost, d), (next_cost, next_d) in pairwise(line):
        if next_d <= difference <= d and next_d < d:
            along = math.log(d / difference) / math.log(d / next_d)
            low, value, high = (
                one ** (1 - along) * other**along
                for one, other in (
                    (cost.low, next_cost.low),
                    (cost.value, next_cost.value),
                    (cost.high, next_cost.high),
                )
            )
            return Interval(value=value, low=low, high=high), False
    raise MissingError("the differences of path tracing do not fall with its paths")


def _against_paths(results: Results) -> Finding:
    point = mapped(results, "final gathering")
    cost, bound = path_cost_at(results, compared(point).value)
    times = ratio(cost, point.cost)
    verdict = between(times, low=2.0)
    if bound and verdict == "fails":
        verdict = "unclear"
    words = f"final gathering differs by {told(compared(point))}; the cost of path tracing of that error over its own"
    return finding(times, verdict, f"{words}, at least" if bound else words)


def _combined(results: Results) -> Finding:
    whole = combined(results, COMBINED)
    singles = [combined(results, changed) for changed in SINGLES.values()]
    cheapest = min((point.cost for point in singles), key=lambda cost: cost.value)
    saved, limit = ratio(whole.cost, cheapest), limit_of(whole)
    verdict = every([between(saved, high=0.8), between(compared(whole), high=limit)])
    words = f"together they differ by {told(compared(whole))} where {limit:.4g} is acceptable"
    return finding(saved, verdict, f"{words}; their cost over that of the cheapest alone")


def _race(results: Results) -> Finding:
    found = dict(threaded(results))
    if len(found) != len(THREADS):
        raise MissingError("not every number of threads was rendered")
    one, two = (found[n] for n in THREADS)
    cost, time = ratio(two.cost, one.cost), ratio(two.time, one.time)
    words = f"the time is {told(time)} times one thread's; the cost in {results.unit} over one thread's"
    verdict = between(cost, high=0.95)
    if results.basis == "time":
        why = "needs joules: CPU seconds tell what threads add, and nothing of what a machine saves by idling sooner"
        made = finding(cost, "unclear", words)
        return Finding(made.value, made.unit, made.verdict, made.words, why)
    return finding(cost, verdict, words)


CLAIMS = claims_of(
    "beyond",
    {
        "gradients": _gradients,
        "sobol": _sobol,
        "importance": _importance,
        "hints": _hints,
        "path-tracing": _against_paths,
        "combined": _combined,
        "race-to-idle": _race,
    },
)


def _gradient_lines(results: Results) -> quantities.Series:
    return {
        name: [(tolerance, gradients(results, tolerance, on=on)) for tolerance in TOLERANCES]
        for name, on in (("with gradients", True), ("without", False))
    }


def _sampler_lines(results: Results) -> quantities.Series:
    return {name: [(f"{rays} rays", sampled(results, name, rays)) for rays in RAYS] for name in SAMPLERS}


def _importance_lines(results: Results) -> quantities.Series:
    return {name: [("", important(results, on=on))] for name, on in (("importance sampling", True), ("cosine", False))}


def _hint_bars(results: Results) -> quantities.Series:
    return {"": [("with hints", hinted(results, on=True)), ("without", hinted(results, on=False))]}


def _path_lines(results: Results) -> quantities.Series:
    traced = [(f"{n} paths a pixel", point) for n, point in paths(results)]
    return {"path tracing": traced} | {name: [("", mapped(results, name))] for name in MAPPED}


def _combined_lines(results: Results) -> quantities.Series:
    alone = {name: [("", combined(results, changed))] for name, changed in SINGLES.items()}
    return alone | {"all together": [("", combined(results, COMBINED))]}


def _threads(results: Results) -> Spec | None:
    rows = [figures.value(str(n), point.cost, f"cost [{results.unit}]") for n, point in threaded(results)]
    rows += [figures.value(str(n), point.time, "time [s]") for n, point in threaded(results)]
    return figures.lines(rows, "threads", f"of an image [{results.unit}; s]")


FIGURES = (
    Figure("beyond-gradients", "Difference over tolerance, with and without irradiance gradients", "",
           quantities.over(quantities.DIFFERENCE, _gradient_lines, "tolerance", "cache")),
    Figure("beyond-samplers", "Cost against difference by sampler", "A gather at every point.",
           quantities.trade_off(_sampler_lines, "sampler", log=False)),
    Figure("beyond-importance", "Cost against difference with and without importance sampling",
           "Behind a door that stands ajar.", quantities.trade_off(_importance_lines, "gather rays", log=False)),
    Figure("beyond-hints", "Stages with and without caustic hints", "Under a mirror ring.",
           quantities.stacked(_hint_bars, "caustic photons")),
    Figure("beyond-paths", "Photon mapping against path tracing",
           f"The reference is path tracing too, with many more paths than {PATHS[-1]} a pixel: it is no friend of "
           "photon mapping's bias.", quantities.trade_off(_path_lines, "method")),
    Figure("beyond-combined", "Settings alone and together", "", quantities.trade_off(_combined_lines, "setting")),
    Figure("beyond-threads", "Cost and time over threads", "The picture is the same. In a quick run another image is "
           "rendered beside it all the time, so a second thread has no core of its own to be faster on.", _threads),
)  # fmt: skip


def advice(results: Results) -> list[str]:
    """What is worth switching on, and what all savings come to together."""
    whole, reference = combined(results, COMBINED), results.reference("beyond-combined")
    limit = limit_of(whole)
    within = "acceptable" if compared(whole).value <= limit else "beyond what is acceptable"
    return [
        f"To begin with: final gathering with {', '.join(SINGLES)}. Together they save "
        f"{told_share(saving(whole.cost, reference.cost))} of what the thesis' reference costs, at a difference of "
        f"{told(compared(whole))} where {figure(limit)} is acceptable: {within}."
    ]


BATCH = Batch(
    "beyond",
    "Beyond the thesis",
    "What its chapters 7 and 8 wish for: irradiance gradients, quasi-Monte Carlo sequences, importance sampling, hints "
    "for caustics, path tracing as a rival at equal error, settings combined, and threads as a setting of energy. Each "
    "is rendered with several seeds beside doing without it.",
    sweeps,
    FIGURES,
    CLAIMS,
    advice,
)
