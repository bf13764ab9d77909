"""The thesis' claims on direct visualisation, each with the rule that decides it."""

import math
import statistics
from typing import Any

from joulebox_server.analysis.intervals import exactly
from joulebox_server.thesis.batch import Finding
from joulebox_server.thesis.claims import claims_of
from joulebox_server.thesis.dv_points import (
    BOXES,
    DISTANCE_M,
    ELSEWHERE,
    MOST_PHOTONS,
    REFERENCE_PHOTONS,
    SCENES,
)
from joulebox_server.thesis.judging import (
    between,
    difference,
    every,
    finding,
    largest,
    ratio,
    rises,
    saving,
    share,
    smallest,
    told,
)
from joulebox_server.thesis.results import MissingError, Point, Results, compared


def _at(results: Results, scene: str, **changed: Any) -> Point:
    """The point with these settings, the others the reference's. Raises MissingError without it."""
    return results.point(f"dv-{scene}", scene, **(ELSEWHERE | changed))


def _photons(results: Results, scene: str, *counts: int) -> list[Point]:
    return [_at(results, scene, global_photons=count) for count in counts]


def _steady(results: Results) -> Finding:
    found = results.discharge
    if found is None or len(found.samples) < 8:
        raise MissingError("there is no discharge with eight samples or more")
    watts = [power_w for _, power_w in found.samples]
    later = watts[2:]
    mean, sigma = statistics.fmean(later), statistics.stdev(later)
    half = len(later) // 2
    drift = abs(statistics.fmean(later[:half]) - statistics.fmean(later[half:])) / sigma
    first = min(watts[:2]) - mean > sigma
    verdict = every([between(exactly(drift), high=1.0), "holds" if first else "fails"])
    words = (
        f"{mean:.1f} W with a sigma of {sigma:.2f} W; the halves differ by {drift:.2f} sigma, the first two samples "
    )
    words += "are above" if first else "are not above"
    if found.quality == "replayed":
        why = "the discharge is a scripted trace, which shows that the figure can be drawn and nothing of a device"
        return Finding(exactly(drift), "sigma", "unclear", words, why)
    return Finding(exactly(drift), "sigma", verdict, words)


def _linear(results: Results) -> Finding:
    points = [(row.image.time_s, row.image.on(results.basis)) for row in results.rows if row.purpose == "measure"]
    if len(points) < 3:
        raise MissingError("fewer than three configurations were measured")
    slope = math.fsum(t * e for t, e in points) / math.fsum(t * t for t, _ in points)
    off = statistics.median(abs(e / (slope * t) - 1) for t, e in points)
    words = f"{slope:.3g} {results.unit} a second; half of the configurations are within {100 * off:.1f} % of the line"
    return Finding(exactly(off), "share", between(exactly(off), high=0.05), words)


def _indirect_dominates(results: Results) -> Finding:
    shares, grows = [], []
    for scene in SCENES:
        own = _photons(results, scene, 50_000, 100_000, REFERENCE_PHOTONS)
        shares.append(share(own[-1].stage("indirect"), own[-1].stage("photon_map", "direct", "caustics")))
        grows.append(rises([point.stage("indirect") for point in own]))
    least = smallest(shares)
    words = "the smaller share of indirect in the cost at 250k photons"
    return finding(least, every([between(least, low=0.5), *grows]), words)


def _map_grows(results: Results) -> Finding:
    counts = (50_000, 100_000, 200_000, MOST_PHOTONS)
    boxes, spheres = (_photons(results, scene, *counts) for scene in SCENES)
    both = [rises([point.stage("photon_map") for point in points]) for points in (boxes, spheres)]
    off = [ratio(a.stage("photon_map"), b.stage("photon_map")) for a, b in zip(boxes, spheres, strict=True)]
    worst = max(off, key=lambda one: abs(math.log(one.value)))
    words = "map creation of boxes over spheres, where farthest from 1"
    return finding(worst, every([*both, between(worst, 0.8, 1.25)]), words)


def _direct(results: Results) -> Finding:
    boxes, spheres = (_photons(results, scene, 50_000, 100_000, REFERENCE_PHOTONS, MOST_PHOTONS) for scene in SCENES)
    costs = [point.stage("direct") for point in boxes]
    flat = ratio(largest(costs), smallest(costs))
    rising = rises([point.stage("direct") for point in spheres])
    below = ratio(spheres[0].stage("direct"), boxes[0].stage("direct"))
    verdict = every([between(flat, high=1.1), rising, between(below, high=1.0)])
    words = f"boxes vary by a factor {told(flat)}, spheres {'rise' if rising == 'holds' else 'do not surely rise'}"
    return finding(below, verdict, f"{words}; direct cost of spheres over boxes at 50k photons")


def _no_trade_off(results: Results) -> Finding:
    points = [p for scene in SCENES for p in results.points(f"dv-{scene}") if p.difference and p.difference.value > 0]
    if not points:
        raise MissingError("no picture was compared")
    share = sum(compared(point).value >= 300 for point in points) / len(points)
    middle = statistics.median(compared(point).value for point in points)
    words = f"{share:.0%} of {len(points)} points differ by 300 or more; their median difference is {middle:.3g}"
    return Finding(exactly(share), "share", between(exactly(share), low=0.9), words)


def _modest(results: Results) -> Finding:
    fewer, reference = _photons(results, BOXES, 175_000, REFERENCE_PHOTONS)
    saved = saving(fewer.cost, reference.cost)
    return finding(saved, between(saved, 0.0, 0.25), "share of the cost that 175k photons save, on boxes")


def _photon_cliff(results: Results) -> Finding:
    few, some, more = (compared(point) for point in _photons(results, BOXES, 50_000, 100_000, 175_000))
    step = difference(few, some)
    verdict = every([between(step, low=1000), between(some, high=100), between(more, high=100)])
    words = f"100k photons differ by {told(some)}, 175k by {told(more)}; 50k differ by more than 100k, namely"
    return finding(step, verdict, words)


def _distances(results: Results, scene: str, *factors: float) -> list[Point]:
    return [_at(results, scene, gather_distance_m=factor * DISTANCE_M) for factor in factors]


def _distance_costs(results: Results) -> Finding:
    each = [[point.cost for point in _distances(results, scene, 0.5, 1.0, 1.5, 2.0, 3.0)] for scene in SCENES]
    most = ratio(each[0][-1], each[0][0])
    return finding(most, every([rises(costs) for costs in each]), "cost at 3x the distance over 0.5x, on boxes")


def _distance_spikes(results: Results) -> Finding:
    near, twice, far = (compared(point) for point in _distances(results, BOXES, 0.5, 2.0, 3.0))
    level = ratio(far, twice)
    verdict = every([between(near, low=100), between(twice, low=100), between(level, 0.75, 1.33)])
    words = f"0.5x differs by {told(near)}, 2x by {told(twice)}; difference at 3x over 2x"
    return finding(level, verdict, words)


def _count_is_cheap(results: Results) -> Finding:
    few, many = (_at(results, BOXES, gather_count=count).cost for count in (50, 200))
    more = ratio(many, few)
    return finding(more, between(more, high=1.1), "cost of a count of 200 over 50")


def _count_cliff(results: Results) -> Finding:
    few, *more = (compared(_at(results, BOXES, gather_count=count)) for count in (50, 150, 200, 250))
    above = largest(more)
    verdict = every([between(few, low=100), between(above, high=5)])
    return finding(above, verdict, f"50 differs by {told(few)}; the largest difference above 100")


CLAIMS = claims_of(
    "dv",
    {
        "fig22": _steady,
        "fig29": _linear,
        "fig30": _indirect_dominates,
        "fig32": _map_grows,
        "fig35": _direct,
        "fig38": _no_trade_off,
        "fig39": _modest,
        "fig40": _photon_cliff,
        "fig41": _distance_costs,
        "fig42": _distance_spikes,
        "fig43": _count_is_cheap,
        "fig44": _count_cliff,
    },
)
