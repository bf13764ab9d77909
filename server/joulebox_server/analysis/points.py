"""Trade-off points from measured repeats: means over repeats and seeds, with intervals."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from joulebox_server.analysis.difference import LIMIT_AT_256
from joulebox_server.analysis.documents import OnFront, OpinionMeans, Point, Quality, SeedPolicy, Shared, StageCost
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.intervals import Interval, exactly, over_repeats, over_values
from joulebox_server.analysis.scatter import DRIFT, SEED_LUCK, Scatter, common_scatter

T = TypeVar("T")

BEST_FIRST: tuple[Quality, ...] = ("measured", "estimated", "replayed")


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
    left_out                stages and maps that its plan left out, with the reasons
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
    left_out: Mapping[str, str] = field(default_factory=dict)
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


@dataclass(frozen=True)
class Common:
    """What all points of a trade-off have in common: how they are judged, and how far repeats scatter."""

    subject: Subject
    base: Mapping[str, Any] | None
    limit: float
    confidence: float
    energy: Scatter | None
    time: Scatter | None
    cpu: Scatter | None
    difference: Scatter | None

    @classmethod
    def of(
        cls,
        subject: Subject,
        groups: Sequence[Sequence[Observation]],
        base: Mapping[str, Any] | None,
        limit: float,
        confidence: float,
    ) -> "Common":
        """Learn the scatter from every configuration's repeats, given one group a configuration."""
        return cls(
            subject,
            base,
            limit,
            confidence,
            energy=common_scatter(
                [by_repeat((o, o.energy_j.value) for o in _metered(g)[1] if o.energy_j) for g in groups], DRIFT
            ),
            time=common_scatter([by_repeat((o, o.time_s.value) for o in g) for g in groups], DRIFT),
            cpu=common_scatter([by_repeat((o, o.cpu_s.value) for o in g) for g in groups], DRIFT),
            difference=common_scatter([_differences(g) for g in groups], SEED_LUCK),
        )

    def shared(self, repeats: int) -> Shared:
        """What the points have in common at so many repeats."""
        known = {"energy_share": self.energy, "time_share": self.time, "difference_share": self.difference}
        return Shared(
            **{name: each.shared_half_width(repeats, self.confidence) for name, each in known.items() if each}
        )


def by_configuration(observations: Sequence[Observation]) -> list[list[Observation]]:
    """Repeats of each configuration together, in the order of repeats."""
    groups: dict[str, list[Observation]] = {}
    for observation in sorted(observations, key=lambda o: (o.repeat, o.seed)):
        groups.setdefault(observation.configuration_id, []).append(observation)
    return list(groups.values())


def by_repeat(found: Iterable[tuple[Observation, T]]) -> dict[int, T]:
    """Values by their repeat's number, for what a session shifts for all points."""
    return _by_number((observation.repeat, value) for observation, value in found)


def by_seed(found: Iterable[tuple[Observation, T]]) -> dict[int, T]:
    """Values by their seed, for what its luck shifts for all points that share it."""
    return _by_number((observation.seed, value) for observation, value in found)


def _by_number(found: Iterable[tuple[int, T]]) -> dict[int, T]:
    """A second result of one number (the first came late) counts as one more."""
    values: dict[int, T] = {}
    for number, value in found:
        values[number if number not in values else -1 - len(values)] = value
    return values


def make_point(group: Sequence[Observation], common: Common) -> Point:
    """The point of one configuration, its standing still open."""
    first, subject, confidence = group[0], common.subject, common.confidence
    quality, metered = _metered(group)
    differences = _differences(group)
    difference = over_values(differences, confidence, common.difference) if differences else None
    per_pixel = 1 / (subject.width * subject.height)
    return Point(
        configuration_id=first.configuration_id,
        label=label_of(first.settings, common.base, subject.axes),
        settings=dict(first.settings),
        changed=changed_settings(first.settings, common.base, subject.axes),
        energy_j=_combined(metered, [o.energy_j for o in metered], confidence, common.energy),
        time_s=_known(_combined(group, [o.time_s for o in group], confidence, common.time)),
        cpu_s=_known(_combined(group, [o.cpu_s for o in group], confidence, common.cpu)),
        difference=difference,
        difference_per_pixel=difference.scaled(per_pixel) if difference else None,
        repeats=len(differences) or len(group),
        acceptable=difference.value <= common.limit if difference else None,
        on_front=OnFront(energy_j=False, time_s=False),
        confirmed=False,
        image_sha256=_first(o.image_sha256 for o in group),
        reference_image_sha256=_first(o.reference_image_sha256 for o in group),
        pixel_sha256=_first(o.pixel_sha256 for o in group),
        stages=_stages(group, metered),
        left_out=dict(first.left_out),
        opinions=_opinions(group),
        quality=quality,
    )


def reference_point(reference: Sequence[Observation], common: Common) -> Point:
    """The reference's own costs; its difference to itself is 0 by definition."""
    point = make_point(reference, common)
    return point.model_copy(
        update={
            "label": "reference",
            "difference": exactly(0.0),
            "difference_per_pixel": exactly(0.0),
            "acceptable": True,
        }
    )


def _differences(group: Sequence[Observation]) -> dict[int, float]:
    """By seed, of those whose picture was compared."""
    return by_seed((o, o.difference) for o in group if o.difference is not None)


def _metered(group: Sequence[Observation]) -> tuple[Quality, Sequence[Observation]]:
    """The repeats whose energy counts: all of the best quality there is, since qualities are not mixed."""
    for quality in BEST_FIRST:
        chosen = [o for o in group if o.quality == quality and o.energy_j is not None]
        if chosen:
            return quality, chosen
    return "none", ()


def _combined(
    group: Sequence[Observation], intervals: Sequence[Interval | None], confidence: float, scatter: Scatter | None
) -> Interval | None:
    known = [(interval, o) for interval, o in zip(intervals, group, strict=True) if interval is not None]
    if not known:
        return None
    windows = [o.windows for _, o in known]
    stated = [o.confidence for _, o in known]
    return over_repeats(by_repeat((o, interval) for interval, o in known), windows, stated, confidence, scatter)


def _known(interval: Interval | None) -> Interval:
    if interval is None:
        raise AnalysisError("a measured repeat has no time, it must have one")
    return interval


def changed_settings(
    settings: Mapping[str, Any], base: Mapping[str, Any] | None, axes: Sequence[str]
) -> dict[str, Any]:
    """Settings that differ from the reference's, or while there is none those that the sweep varies."""
    if base is None:
        return {name: settings[name] for name in axes if name in settings}
    return {name: value for name, value in settings.items() if name != "seed" and base.get(name) != value}


def label_of(settings: Mapping[str, Any], base: Mapping[str, Any] | None, axes: Sequence[str]) -> str:
    named = {name: settings[name] for name in axes if name in settings} or changed_settings(settings, base, axes)
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
