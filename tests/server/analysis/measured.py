"""Repeats and points made by hand, for the tests of trade-offs, recommendations and charts."""

from typing import Any

from joulebox_server.analysis.documents import OnFront, Point, StageCost, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.points import Observation, Subject
from joulebox_server.analysis.tradeoff import build_tradeoff

SUBJECT = Subject("sweep-1", "cornell-boxes", "laptop", 256, 256, axes=["photons"], exposure=3)


def interval(value: float, half_width: float = 0.0) -> Interval:
    return Interval(value=value, low=max(0.0, value - half_width), high=value + half_width)


def observation(configuration_id: str, energy_j: float | None, difference: float | None, **given: Any) -> Observation:
    """A repeat; time is a tenth of the energy unless given, intervals are 1 % wide."""
    repeat = given.pop("repeat", 0)
    seed = given.pop("seed", repeat)
    changes = given.pop("settings", {"photons": 1000})
    time_s = given.pop("time_s", 0.1 * (energy_j or 10.0))
    quality = given.pop("quality", "none" if energy_j is None else "measured")
    stages = {
        "direct": StageCost(time_s=0.4 * time_s, energy_j=None if energy_j is None else 0.4 * energy_j),
        "indirect": StageCost(time_s=0.5 * time_s, energy_j=None if energy_j is None else 0.5 * energy_j),
    }
    return Observation(
        configuration_id=configuration_id,
        settings={"photons": 1000, "rays": 16, "seed": seed} | changes,
        repeat=repeat,
        seed=seed,
        time_s=interval(time_s, 0.01 * time_s),
        cpu_s=interval(2 * time_s, 0.02 * time_s),
        energy_j=None if energy_j is None else interval(energy_j, 0.01 * energy_j),
        quality=quality,
        windows=given.pop("windows", 5),
        difference=difference,
        **{"stages": stages, "image_sha256": f"image-{configuration_id}", **given},
    )


def repeats(configuration_id: str, energies: list[float], differences: list[float], **given: Any) -> list[Observation]:
    pairs = zip(energies, differences, strict=True)
    return [observation(configuration_id, e, d, repeat=r, **given) for r, (e, d) in enumerate(pairs)]


def small_sweep(quality: str = "measured", count: int = 3, **subject: Any) -> Tradeoff:
    """Four values of photons, more of them costing more and differing less, and a reference."""
    energy = quality != "time_only"
    found: list[Observation] = []
    for place, photons in enumerate([1000, 2000, 5000, 10000]):
        for repeat in range(count):
            found.append(
                observation(
                    f"c{place}",
                    (10 + 5 * place) * (1 + 0.01 * repeat) if energy else None,
                    240 / (1 + place) ** 1.5 * (1 + 0.02 * repeat),
                    time_s=(1 + 0.5 * place) * (1 + 0.01 * repeat),
                    settings={"photons": photons},
                    repeat=repeat,
                    quality=quality if energy else "none",
                )
            )
    base = {"photons": 10000, "rays": 64}
    kind = quality if energy else "none"
    full = observation("ref", 60.0 if energy else None, None, time_s=6.0, settings=base, seed=1000, quality=kind)
    made = SUBJECT if not subject else Subject(**{**vars(SUBJECT), **subject})
    return build_tradeoff(made, found, [full], noise_floor=6.0)


def point(configuration_id: str, cost: Interval, difference: Interval | None, **given: Any) -> Point:
    """A point with energy and time of one value."""
    return Point(
        **{
            "configuration_id": configuration_id,
            "label": configuration_id,
            "settings": {"name": configuration_id},
            "changed": {"name": configuration_id},
            "energy_j": cost,
            "time_s": cost,
            "cpu_s": cost,
            "difference": difference,
            "difference_per_pixel": difference.scaled(1 / 65536) if difference else None,
            "repeats": 3,
            "acceptable": None,
            "on_front": OnFront(energy_j=False, time_s=False),
            "confirmed": False,
            "image_sha256": None,
            "reference_image_sha256": None,
            "pixel_sha256": None,
            "stages": {},
            "opinions": None,
            "quality": "measured",
            **given,
        }
    )


def tradeoff_of(points: list[Point], reference: Point | None = None, **changes: Any) -> Tradeoff:
    """A trade-off of points as they are, limit 100."""
    empty = build_tradeoff(SUBJECT, [])
    return empty.model_copy(update={"points": points, "reference": reference, "energy_quality": "measured", **changes})
