"""Why a recommendation is what it is, in sentences with figures."""

from collections.abc import Sequence

from joulebox_server.analysis.documents import UNITS, Axis, Point, Tradeoff
from joulebox_server.analysis.words import figure, setting, settings, share

MAX_PAID = 4
"""Most settings whose share in the saving is told."""

_QUALITY_WORDS = {
    "estimated": "The joules are estimated from another reading, not measured at the battery.",
    "replayed": "The joules are replayed from a trace, not measured on this device: compare "
    "settings by them, but do not take them as its consumption.",
    "time_only": "This device has no energy source, so time stands in for energy.",
}


def reasons(
    tradeoff: Tradeoff,
    axis: Axis,
    budget: float | None,
    limit: float,
    fitting: Sequence[Point],
    judged: int,
) -> list[str]:
    """Sentences for the first of the fitting points, which come best first.

    judged      number of points that have a cost and a difference
    """
    chosen = fitting[0]
    told = [
        _fits(chosen, axis, budget, limit, tradeoff.confidence),
        _rank(budget, axis, len(fitting), judged),
    ]
    told += _against_reference(tradeoff, chosen, axis)
    told += _what_paid(tradeoff, chosen, axis)
    if len(fitting) > 1:
        told += _close_call(chosen, fitting[1], axis, by_cost=budget is None)
    return told + caveats(tradeoff)


def none_reasons(tradeoff: Tradeoff, axis: Axis, budget: float | None, limit: float, judged: int) -> list[str]:
    """Sentences for an answer of "none"."""
    within = f"a difference of {figure(limit)}"
    if budget is not None:
        within = f"a budget of {figure(budget)} {UNITS[axis]} and {within}"
    who = (
        "The one measured configuration does not stay"
        if judged == 1
        else (f"None of the {judged} measured configurations stays")
    )
    return [f"{who} within {within} at its {tradeoff.confidence:.0%} upper bounds.", *caveats(tradeoff)]


def caveats(tradeoff: Tradeoff) -> list[str]:
    """What weakens every statement on this trade-off."""
    told = []
    if tradeoff.energy_quality in _QUALITY_WORDS:
        told.append(_QUALITY_WORDS[tradeoff.energy_quality])
    floor = tradeoff.noise_floor
    if floor is not None and floor.too_noisy:
        told.append(
            f"The reference is too noisy to judge by: against itself at another seed it differs by "
            f"{figure(floor.value)}, {share(floor.share_of_limit)} of the limit."
        )
    if tradeoff.seed_policy == "same":
        told.append("The reference was rendered with the same seeds, which understates how far the pictures differ.")
    return told


def _fits(point: Point, axis: Axis, budget: float | None, limit: float, confidence: float) -> str:
    cost, difference = point.cost(axis), point.difference
    assert cost is not None, "only points with a cost fit"
    assert difference is not None, "only points with a difference fit"
    text = (
        f"Its difference is {figure(difference.value)}, at most {figure(difference.high)} with "
        f"{confidence:.0%} confidence, within the limit of {figure(limit)}"
    )
    unit = UNITS[axis]
    spent = f"{figure(cost.value)} {unit} an image, at most {figure(cost.high)} {unit}"
    if budget is None:
        return f"{text}, for {spent}."
    return f"{text}, and it costs {spent}, within the budget of {figure(budget)} {unit}."


def _rank(budget: float | None, axis: Axis, fitting: int, judged: int) -> str:
    what = (
        "the smallest difference" if budget is not None else f"the lowest {'energy' if axis == 'energy_j' else 'time'}"
    )
    if fitting == 1:
        return f"It is the only one of {judged} measured configurations that fits."
    return f"It has {what} of the {fitting} that fit, out of {judged} measured configurations."


def _against_reference(tradeoff: Tradeoff, point: Point, axis: Axis) -> list[str]:
    reference = tradeoff.reference
    full, cost = reference.cost(axis) if reference else None, point.cost(axis)
    if full is None or cost is None or full.value <= 0:
        return ["There is no measured reference to say what it saves against."]
    unit, saved = UNITS[axis], full.value - cost.value
    amount = f"{figure(abs(saved))} {unit} ({share(abs(saved) / full.value)})"
    verdict = f"saves {amount}" if saved >= 0 else f"costs {amount} more"
    return [f"Against the reference, {figure(full.value)} {unit} an image, it {verdict}."]


def _what_paid(tradeoff: Tradeoff, chosen: Point, axis: Axis) -> list[str]:
    """What each setting did: pairs of measured points that differ from the chosen in that one setting."""
    reference = tradeoff.reference
    others = [*tradeoff.points, *([reference] if reference else [])]
    told: list[tuple[float, str]] = []
    for name in chosen.settings:
        pairs = [other for other in others if _differs_only_in(chosen, other, name)]
        if not pairs:
            continue
        wanted = reference.settings.get(name) if reference else None
        best = min(pairs, key=lambda other: (other.settings[name] != wanted, _difference(other)))
        cost, other_cost = chosen.cost(axis), best.cost(axis)
        if cost is None or other_cost is None or other_cost.value <= cost.value:
            continue
        saved = other_cost.value - cost.value
        told.append((saved, _paid(name, chosen, best, saved, other_cost.value, UNITS[axis])))
    told.sort(key=lambda item: -item[0])
    return [sentence for _, sentence in told[:MAX_PAID]]


def _paid(name: str, chosen: Point, other: Point, saved: float, other_cost: float, unit: str) -> str:
    sentence = (
        f"{name} {setting(chosen.settings[name])} instead of {setting(other.settings[name])} saves "
        f"{figure(saved)} {unit} ({share(saved / other_cost)})"
    )
    if chosen.difference is None or other.difference is None:
        return sentence + "."
    change = f"from {figure(other.difference.value)} to {figure(chosen.difference.value)}"
    overlap = chosen.difference.low <= other.difference.high and other.difference.low <= chosen.difference.high
    return f"{sentence}; the difference goes {change}{', within its interval' if overlap else ''}."


def _differs_only_in(one: Point, other: Point, name: str) -> bool:
    names = {n for n in {*one.settings, *other.settings} if one.settings.get(n) != other.settings.get(n)}
    return names - {"seed"} == {name}


def _difference(point: Point) -> float:
    return point.difference.value if point.difference else float("inf")


def _close_call(chosen: Point, runner_up: Point, axis: Axis, by_cost: bool) -> list[str]:
    """Say so where the intervals do not tell the first from the second."""
    one, other = chosen.cost(axis), runner_up.cost(axis)
    if not by_cost:
        one, other = chosen.difference, runner_up.difference
    if one is None or other is None or one.high < other.low:
        return []
    what = "cost" if by_cost else "difference"
    return [
        f"The runner-up, {settings(runner_up.changed) or runner_up.label}, cannot be told from it by {what}: "
        f"{figure(other.value)} ({figure(other.low)} to {figure(other.high)}) against {figure(one.value)} "
        f"({figure(one.low)} to {figure(one.high)})."
    ]
