"""Budgets in the units that people have them in, and what they come to per image."""

from dataclasses import dataclass

from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.errors import InvalidError

JOULES_PER_WATT_HOUR = 3600.0


@dataclass(frozen=True)
class Budget:
    """What an image may cost: joules, or seconds, or neither, and never both; `told` says where it came from."""

    joules: float | None = None
    seconds: float | None = None
    told: str | None = None


def make_budget(
    *,
    joules: float | None = None,
    seconds: float | None = None,
    watt_hours: float | None = None,
    battery_percent: float | None = None,
    images: int | None = None,
    battery_full_j: float | None = None,
) -> Budget:
    """The budget an image, of at most one of its kinds.

    joules, seconds     an image
    watt_hours          for all `images`
    battery_percent     of a full battery of `battery_full_j` [J], for all `images`; for one unless given

    Raises InvalidError for more than one kind and for images without what they share or the other way round,
    AnalysisError for a number that makes no sense and for a share of a battery whose capacity is not known.
    """
    given = {
        "budget_j": joules, "budget_s": seconds, "budget_wh": watt_hours, "battery_percent": battery_percent,
    }  # fmt: skip
    named = [name for name, value in given.items() if value is not None]
    if len(named) > 1:
        raise InvalidError(f"give one budget, not {' and '.join(named)}: budget_j, budget_s, budget_wh with images, "
                            "or battery_percent")  # fmt: skip
    for name in named:
        _check_positive(name, given[name])
    if images is not None and named[:1] not in (["budget_wh"], ["battery_percent"]):
        raise InvalidError("images goes with budget_wh or battery_percent, which all of them share")
    if battery_percent is not None:
        return _of_battery(battery_percent, 1 if images is None else images, battery_full_j)
    if watt_hours is not None:
        if images is None:
            raise InvalidError("budget_wh and images belong together: watt-hours for that many images")
        per_image = budget_per_image_j(watt_hours, images)
        return Budget(joules=per_image, told=f"{watt_hours:g} Wh for {images:,} images")
    return Budget(joules=joules, seconds=seconds)


def budget_per_image_j(watt_hours: float, images: int) -> float:
    """Joules an image [J] when a number of images may use an energy [Wh].

    Raises AnalysisError for an energy that is not above 0 or fewer than one image.
    """
    if not 0 < watt_hours < float("inf"):
        raise AnalysisError(f"the budget is {watt_hours} Wh, it must be above 0")
    _check_images(images)
    return watt_hours * JOULES_PER_WATT_HOUR / images


def _of_battery(percent: float, images: int, full_j: float | None) -> Budget:
    if percent > 100:
        raise AnalysisError(f"battery_percent is {percent:g}, it must be at most 100: a full battery")
    _check_images(images)
    if full_j is None or not 0 < full_j < float("inf"):
        raise AnalysisError(
            "the capacity of this device's battery is not known, as no result of it tells one; "
            "give the budget in joules, or in watt-hours for a number of images"
        )
    capacity_wh = full_j / JOULES_PER_WATT_HOUR
    told = f"{percent:g} % of a battery of {capacity_wh:.1f} Wh for {images:,} image{'s' if images > 1 else ''}"
    return Budget(joules=percent / 100 * full_j / images, told=told)


def _check_images(images: int) -> None:
    if images < 1:
        raise AnalysisError(f"the budget is for {images} images, it must be for at least 1")


def _check_positive(name: str, value: float | None) -> None:
    if value is not None and not 0 < value < float("inf"):
        raise AnalysisError(f"{name} is {value}, it must be a number above 0")
