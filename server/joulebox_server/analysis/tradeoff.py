"""Trade-off points from measured repeats: means, intervals, Pareto fronts."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from joulebox_server.analysis.difference import LIMIT_AT_256, acceptable_limit
from joulebox_server.analysis.documents import (
    Axis,
    EnergyQuality,
    NoiseFloor,
    OnFront,
    OpinionMeans,
    Point,
    Quality,
    SeedPolicy,
    StageCost,
    Tradeoff,
)
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.intervals import (
    Interval,
    check_confidence,
    exactly,
    over_repeats,
    over_values,
)
from joulebox_server.analysis.pareto import Standing, standings

MAX_NOISE_SHARE = 0.1
"""A reference whose noise floor exceeds this share of the limit is too noisy to judge by."""

_BEST_FIRST: tuple[Quality, ...] = ("measured", "estimated", "replayed")


@dataclass(frozen=True)
class Observation:
    """One measured repeat of one configuration: costs per image with intervals over its windows.

    seed                    settings["seed"] of this repeat; the seed is no part of the configuration
    energy_j                [J] or None where there was no energy source
    time_s, cpu_s           [s]
    windows                 windows behind the intervals
    difference              to the reference, None where it was not computed
    confidence              of the intervals
    stages                  by the renderer's stage names
    opinions                `opinions.Opinions.document()` or None
    """

    configuration_id: str
    settings: Mapping[str, Any]
    repeat: int
    seed: int
    time_s: Interval
    cpu_s: Interval
    energy_j: Interval | None
    quality: Quality
    windows: int
    difference: float | None = None
    confidence: float = 0.95
    image_sha256: str | None = None
    reference_image_sha256: str | None = None
    pixel_sha256: str | None = None
    stages: Mapping[str, StageCost] = field(default_factory=dict)
    opinions: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Subject:
    """What a trade-off is of: a scene on a device of a sweep, the picture's size, how it was judged.

    width, height   [px] of the reference
    limit_at_256    acceptable difference at 65,536 pixels, scaled to this size
    axes            names of the settings that the sweep varies
    """

    sweep_id: str
    scene: str
    device: str
    width: int
    height: int
    scenes: Sequence[str] = ()
    devices: Sequence[str] = ()
    axes: Sequence[str] = ()
    exposure: float = 1.0
    seed_policy: SeedPolicy = "other"
    limit_at_256: float = LIMIT_AT_256


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
    points = [_point(group, base, subject, limit, confidence) for group in _by_configuration(observations)]
    quality = _energy_quality(points)
    points = _with_standings(points, by_energy=quality != "time_only")
    points.sort(key=lambda p: ((p.energy_j or p.time_s).value, p.configuration_id))
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
        reference=_reference_point(reference, subject, limit, confidence) if reference else None,
        points=points,
        axes=list(subject.axes),
    )


def _by_configuration(observations: Sequence[Observation]) -> list[list[Observation]]:
    groups: dict[str, list[Observation]] = {}
    for observation in sorted(observations, key=lambda o: (o.repeat, o.seed)):
        groups.setdefault(observation.configuration_id, []).append(observation)
    return list(groups.values())


def _point(
    group: Sequence[Observation],
    base: Mapping[str, Any] | None,
    subject: Subject,
    limit: float,
    confidence: float,
) -> Point:
    """The point of one configuration, its standing still open."""
    first = group[0]
    quality, metered = _metered(group)
    differences = [o.difference for o in group if o.difference is not None]
    difference = over_values(differences, confidence) if differences else None
    per_pixel = 1 / (subject.width * subject.height)
    return Point(
        configuration_id=first.configuration_id,
        label=_label(first.settings, base, subject.axes),
        settings=dict(first.settings),
        changed=_changed(first.settings, base, subject.axes),
        energy_j=_combined(metered, [o.energy_j for o in metered], confidence),
        time_s=_known(_combined(group, [o.time_s for o in group], confidence)),
        cpu_s=_known(_combined(group, [o.cpu_s for o in group], confidence)),
        difference=difference,
        difference_per_pixel=difference.scaled(per_pixel) if difference else None,
        repeats=len(differences) or len(group),
        acceptable=difference.value <= limit if difference else None,
        on_front=OnFront(energy_j=False, time_s=False),
        confirmed=False,
        image_sha256=_first(o.image_sha256 for o in group),
        reference_image_sha256=_first(o.reference_image_sha256 for o in group),
        pixel_sha256=_first(o.pixel_sha256 for o in group),
        stages=_stages(group, metered),
        opinions=_opinions(group),
        quality=quality,
    )


def _reference_point(reference: Sequence[Observation], subject: Subject, limit: float, confidence: float) -> Point:
    """The reference's own costs; its difference to itself is 0 by definition."""
    point = _point(reference, reference[0].settings, subject, limit, confidence)
    return point.model_copy(
        update={
            "label": "reference",
            "difference": exactly(0.0),
            "difference_per_pixel": exactly(0.0),
            "acceptable": True,
        }
    )


def _metered(group: Sequence[Observation]) -> tuple[Quality, Sequence[Observation]]:
    """The repeats whose energy counts: all of the best quality there is, since qualities are not mixed."""
    for quality in _BEST_FIRST:
        chosen = [o for o in group if o.quality == quality and o.energy_j is not None]
        if chosen:
            return quality, chosen
    return "none", ()


def _combined(group: Sequence[Observation], intervals: Sequence[Interval | None], confidence: float) -> Interval | None:
    known = [(interval, o) for interval, o in zip(intervals, group, strict=True) if interval is not None]
    if not known:
        return None
    windows = [o.windows for _, o in known]
    stated = [o.confidence for _, o in known]
    return over_repeats([interval for interval, _ in known], windows, stated, confidence)


def _known(interval: Interval | None) -> Interval:
    if interval is None:
        raise AnalysisError("a measured repeat has no time, it must have one")
    return interval


def _changed(settings: Mapping[str, Any], base: Mapping[str, Any] | None, axes: Sequence[str]) -> dict[str, Any]:
    """Settings that differ from the reference's, or while there is none those that the sweep varies."""
    if base is None:
        return {name: settings[name] for name in axes if name in settings}
    return {name: value for name, value in settings.items() if name != "seed" and base.get(name) != value}


def _label(settings: Mapping[str, Any], base: Mapping[str, Any] | None, axes: Sequence[str]) -> str:
    named = {name: settings[name] for name in axes if name in settings} or _changed(settings, base, axes)
    return ", ".join(f"{name}={value}" for name, value in named.items()) or "reference settings"


def _first(values: Iterable[str | None]) -> str | None:
    return next((value for value in values if value is not None), None)


def _stages(group: Sequence[Observation], metered: Sequence[Observation]) -> dict[str, StageCost]:
    """Means over repeats; a repeat without a stage did not spend anything on it."""
    names = dict.fromkeys(name for observation in group for name in observation.stages)
    stages = {}
    for name in names:
        time_s = math.fsum(o.stages[name].time_s for o in group if name in o.stages) / len(group)
        energies = [o.stages[name].energy_j for o in metered if name in o.stages]
        known = [energy for energy in energies if energy is not None]
        energy_j = math.fsum(known) / len(metered) if known and len(known) == len(energies) else None
        stages[name] = StageCost(time_s=time_s, energy_j=energy_j)
    return stages


def _opinions(group: Sequence[Observation]) -> OpinionMeans | None:
    given = [o.opinions for o in group if o.opinions is not None]
    if not given:
        return None
    return OpinionMeans(**{n: math.fsum(o[n] for o in given) / len(given) for n in OpinionMeans.model_fields})


def _energy_quality(points: Sequence[Point]) -> EnergyQuality:
    """The least good quality among the points: a chart of mixed points claims no more than its weakest."""
    found = {point.quality for point in points if point.energy_j is not None}
    for quality in reversed(_BEST_FIRST):
        if quality in found and quality != "none":
            return quality
    return "time_only"


def _with_standings(points: Sequence[Point], by_energy: bool) -> list[Point]:
    energy, time = front_of(points, "energy_j"), front_of(points, "time_s")
    return [
        point.model_copy(
            update={
                "on_front": OnFront(energy_j=e.on_front, time_s=t.on_front),
                "confirmed": e.confirmed if by_energy else t.confirmed,
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
