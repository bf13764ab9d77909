"""Predictions for a device with few runs, from another device's times and its own stage powers.

The other device has run a configuration that this one has not. How fast this device is at each stage is told by
the configurations that both have run, and what power a stage draws by its own runs; so

    time_s = sum over stages of speed[stage] x the other's time_s[stage],   energy_j likewise x power_w[stage].

The picture, and so the difference, is the other's: pixels agree across devices, energy does not.
"""

import math
from collections.abc import Sequence

import numpy as np

from joulebox_server.analysis.candidates import Candidate, bounds
from joulebox_server.analysis.documents import Axis, Point, StageCost, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.scatter import DRIFT, factor

MIN_SHARED = 2
"""Configurations that both devices must have run."""
UNKNOWN_SHARE = 0.1
"""Standard deviation of a transferred cost where too few runs are shared to tell, as a share."""
UNKNOWN_FREEDOM = 4.0

Pairs = list[tuple[Point, Point]]


def transferred(own: Tradeoff, others: Sequence[Tradeoff], axis: Axis) -> list[Candidate]:
    """A candidate for every configuration that the best known other device has run and this one has not.

    The best known is the one that shares most runs; where no device shares two there are none.
    """
    best: Pairs = []
    chosen: Tradeoff | None = None
    for other in others:
        pairs = _pairs(own, other)
        if len(pairs) >= max(MIN_SHARED, len(best) + 1):
            best, chosen = pairs, other
    if chosen is None:
        return []
    known = {point.configuration_id for point in own.points if point.difference is not None}
    half = _half_width(best, axis, own.confidence)
    found = []
    for point in chosen.points:
        cost = _carried(best, point, axis)
        if point.configuration_id in known or cost is None or point.difference is None:
            continue
        interval = Interval(value=cost, low=cost * math.exp(-half), high=cost * math.exp(half))
        found.append(
            Candidate(
                point.configuration_id,
                point.label,
                point.settings,
                point.changed,
                bounds(interval, own.confidence),
                bounds(point.difference, own.confidence),
                None,
            )
        )
    return found


def _pairs(own: Tradeoff, other: Tradeoff) -> Pairs:
    """What both devices have run, the reference among it: this device's point, the other's."""
    theirs = {point.configuration_id: point for point in [*other.points, *_listed(other.reference)]}
    mine = [*own.points, *_listed(own.reference)]
    return [(p, theirs[p.configuration_id]) for p in mine if p.stages and p.configuration_id in theirs]


def _listed(point: Point | None) -> list[Point]:
    return [] if point is None else [point]


def _carried(pairs: Pairs, point: Point, axis: Axis) -> float | None:
    """What a configuration of the other device would cost here; None where this device's energy is not known."""
    total = 0.0
    for name, stage in point.stages.items():
        time_s = stage.time_s * _speed(pairs, name)
        if axis == "time_s":
            total += time_s
            continue
        power_w = _power_w([mine for mine, _ in pairs], name)
        if power_w is None:
            return None
        total += time_s * power_w
    return total if total > 0 else None


def _speed(pairs: Pairs, stage: str) -> float:
    """This device's time over the other's at a stage (geometric mean), or overall where no shared run has it."""
    at_stage = [(mine.stages.get(stage), theirs.stages.get(stage)) for mine, theirs in pairs]
    ratios = [m.time_s / t.time_s for m, t in at_stage if m and t and m.time_s > 0 and t.time_s > 0]
    if not ratios:
        ratios = [m.time_s.value / t.time_s.value for m, t in pairs if m.time_s.value > 0 and t.time_s.value > 0]
    return math.exp(float(np.mean(np.log(ratios)))) if ratios else 1.0


def _power_w(own: Sequence[Point], stage: str) -> float | None:
    """Joules over seconds of a stage in all runs of this device; of all stages where it never ran that one."""
    return _ratio([p.stages[stage] for p in own if stage in p.stages]) or _ratio(
        [cost for point in own for cost in point.stages.values()]
    )


def _ratio(costs: Sequence[StageCost]) -> float | None:
    known = [(cost.energy_j, cost.time_s) for cost in costs if cost.energy_j is not None]
    time_s = math.fsum(seconds for _, seconds in known)
    return math.fsum(joules for joules, _ in known) / time_s if time_s > 0 else None


def _half_width(pairs: Pairs, axis: Axis, confidence: float) -> float:
    """Half-width in logs: what shared runs miss by when each is carried over by the others."""
    misses = []
    for place, (mine, theirs) in enumerate(pairs):
        rest = pairs[:place] + pairs[place + 1 :]
        carried, cost = _carried(rest, theirs, axis), mine.cost(axis)
        if carried is not None and cost is not None and cost.value > 0:
            misses.append(math.log(cost.value / carried))
    freedom = UNKNOWN_FREEDOM + len(misses)
    variance = (UNKNOWN_FREEDOM * UNKNOWN_SHARE**2 + math.fsum(m * m for m in misses)) / freedom
    return factor(confidence, freedom) * math.sqrt(variance + DRIFT.share**2)
