"""Trade-off points from measured repeats: intervals, Pareto fronts, ratings, cliffs."""

import math
from collections.abc import Sequence

from joulebox_server.analysis import ratings
from joulebox_server.analysis.difference import acceptable_limit
from joulebox_server.analysis.documents import Axis, EnergyQuality, NoiseFloor, OnFront, Point, Tradeoff
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.intervals import check_confidence
from joulebox_server.analysis.pareto import Standing, standings
from joulebox_server.analysis.points import (
    BEST_FIRST,
    Common,
    Observation,
    Subject,
    by_configuration,
    make_point,
    reference_point,
)

MAX_NOISE_SHARE = 0.1
"""A reference whose noise floor exceeds this share of the limit is too noisy to judge by."""


def build_tradeoff(
    subject: Subject,
    observations: Sequence[Observation],
    reference: Sequence[Observation] = (),
    noise_floor: float | None = None,
    confidence: float = 0.95,
) -> Tradeoff:
    """The trade-off of a sweep's measured repeats, points in order of their main cost.

    reference       repeats of the reference settings; empty while it has not been rendered
    noise_floor     difference of the reference to itself at another seed, None while unknown
    confidence      of every interval given out

    Raises AnalysisError for a confidence or a limit out of range.
    """
    check_confidence(confidence)
    if not (math.isfinite(subject.limit_at_256) and subject.limit_at_256 > 0):
        raise AnalysisError(f"the limit is {subject.limit_at_256}, it must be a number above 0")
    limit = acceptable_limit(subject.width, subject.height, subject.limit_at_256)
    base = reference[0].settings if reference else None
    groups = by_configuration(observations)
    common = Common.of(subject, groups, base, limit, confidence)
    points = [make_point(group, common) for group in groups]
    quality = _energy_quality(points)
    axis: Axis = "time_s" if quality == "time_only" else "energy_j"
    points = _with_standings(points, axis, limit)
    points.sort(key=lambda p: ((p.energy_j or p.time_s).value, p.configuration_id))
    full = reference_point(reference, common) if reference else None
    return Tradeoff(
        sweep_id=subject.sweep_id,
        scene=subject.scene,
        device=subject.device,
        scenes=list(subject.scenes) or [subject.scene],
        devices=list(subject.devices) or [subject.device],
        energy_quality=quality,
        limit=limit,
        limit_per_pixel=limit / (subject.width * subject.height),
        width=subject.width,
        height=subject.height,
        exposure=subject.exposure,
        seed_policy=subject.seed_policy,
        confidence=confidence,
        noise_floor=_noise_floor(noise_floor, limit),
        reference=full,
        points=points,
        axes=list(subject.axes),
        shared=common.shared(max((len(group) for group in groups), default=1)),
        ratings=ratings.rate(points, full, axis, limit),
    )


def _energy_quality(points: Sequence[Point]) -> EnergyQuality:
    """The least good quality among the points: a chart of mixed points claims no more than its weakest."""
    found = {point.quality for point in points if point.energy_j is not None}
    for quality in reversed(BEST_FIRST):
        if quality in found and quality != "none":
            return quality
    return "time_only"


def _with_standings(points: Sequence[Point], axis: Axis, limit: float) -> list[Point]:
    """The points with what they are among the others: on a front or not, near a cliff or not."""
    energy, time = front_of(points, "energy_j"), front_of(points, "time_s")
    fragile = ratings.fragility(points, limit)
    return [
        point.model_copy(
            update={
                "on_front": OnFront(energy_j=e.on_front, time_s=t.on_front),
                "confirmed": e.confirmed if axis == "energy_j" else t.confirmed,
                "fragile": fragile.get(point.configuration_id),
            }
        )
        for point, e, t in zip(points, energy, time, strict=True)
    ]


def front_of(points: Sequence[Point], axis: Axis) -> list[Standing]:
    """Standing of every point on the front of one cost against the difference."""
    return standings([p.cost(axis) for p in points], [p.difference for p in points], [p.repeats for p in points])


def _noise_floor(value: float | None, limit: float) -> NoiseFloor | None:
    if value is None:
        return None
    share = value / limit
    return NoiseFloor(value=value, share_of_limit=share, too_noisy=share > MAX_NOISE_SHARE)
