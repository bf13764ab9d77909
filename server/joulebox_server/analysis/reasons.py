"""Why a recommendation is what it is, in sentences with figures."""

from collections.abc import Sequence
from dataclasses import dataclass

from joulebox_server.analysis.candidates import Candidate, pictures_agree
from joulebox_server.analysis.documents import UNITS, Axis, Tradeoff
from joulebox_server.analysis.lines import NO_SETTINGS
from joulebox_server.analysis.stages import stage_reasons
from joulebox_server.analysis.words import figure, setting, settings, share

MAX_PAID = 4
"""Most settings whose share in the saving is told."""

_QUALITY_WORDS = {
    "estimated": "The joules are estimated from another reading, not measured at the battery.",
    "replayed": "The joules are replayed from a trace, not measured on this device: compare "
    "settings by them, but do not take them as its consumption.",
    "time_only": "This device has no energy source, so time stands in for energy.",
}


@dataclass(frozen=True)
class Case:
    """All that an answer rests on: the question, what fits (best first), and what was to choose from."""

    tradeoff: Tradeoff
    axis: Axis
    budget: float | None
    limit: float
    told_budget: str | None
    fitting: Sequence[Candidate]
    measured: Sequence[Candidate]
    predicted: Sequence[Candidate]

    @property
    def unit(self) -> str:
        """Of the cost."""
        return UNITS[self.axis]


def reasons(case: Case) -> list[str]:
    """Sentences for the first of the fitting candidates."""
    chosen = case.fitting[0]
    told = [*_where_from(case), _fits(case, chosen), _rank(case)]
    if chosen.point is None:
        told.append(_predicted(case))
    told += _against_reference(case, chosen)
    told += _what_paid(case, chosen)
    told += stage_reasons(chosen, case.measured, case.axis)
    if len(case.fitting) > 1:
        told += _close_call(case, chosen, case.fitting[1])
    return told + caveats(case.tradeoff)


def none_reasons(case: Case) -> list[str]:
    """Sentences for an answer of "none"."""
    within = f"a difference of {figure(case.limit)}"
    if case.budget is not None:
        within = f"a budget of {figure(case.budget)} {case.unit} and {within}"
    judged = len(case.measured)
    who = (
        "The one measured configuration does not stay"
        if judged == 1
        else f"None of the {judged} measured configurations stays"
    )
    bounds = f"{case.tradeoff.confidence:.0%} upper bounds"
    nor = f", nor does any of {len(case.predicted):,} predicted ones" if case.predicted else ""
    return [*_where_from(case), f"{who} within {within} at its {bounds}{nor}.", *caveats(case.tradeoff)]


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


def _where_from(case: Case) -> list[str]:
    if case.told_budget is None or case.budget is None:
        return []
    return [f"The budget, {case.told_budget}, is {figure(case.budget)} {case.unit} an image."]


def _fits(case: Case, chosen: Candidate) -> str:
    cost, difference = chosen.cost, chosen.difference
    text = (
        f"Its difference is {figure(difference.value)}, at most {figure(difference.high)} with "
        f"{case.tradeoff.confidence:.0%} confidence, within the limit of {figure(case.limit)}"
    )
    spent = f"{figure(cost.value)} {case.unit} an image, at most {figure(cost.high)} {case.unit}"
    if case.budget is None:
        return f"{text}, for {spent}."
    return f"{text}, and it costs {spent}, within the budget of {figure(case.budget)} {case.unit}."


def _rank(case: Case) -> str:
    cheapest = f"the lowest {'energy' if case.axis == 'energy_j' else 'time'}"
    what = cheapest if case.budget is None else "the smallest difference"
    with_predictions = any(c.point is None for c in case.fitting)
    judged = f"{len(case.measured)} measured configurations"
    if with_predictions:
        judged += f" and {len(case.predicted):,} predicted ones"
    if len(case.fitting) == 1:
        return f"It is the only one of {judged} that fits."
    return f"It has {what} of the {len(case.fitting)} that fit, out of {judged}."


def _predicted(case: Case) -> str:
    return (
        f"These settings were never measured: both figures are predicted from {len(case.measured)} configurations "
        "that were, and their intervals are as wide as leaving those out in turn shows."
    )


def _against_reference(case: Case, chosen: Candidate) -> list[str]:
    reference = case.tradeoff.reference
    full = reference.cost(case.axis) if reference else None
    if full is None or full.value <= 0:
        return ["There is no measured reference to say what it saves against."]
    saved = full.value - chosen.cost.value
    amount = f"{figure(abs(saved))} {case.unit} ({share(abs(saved) / full.value)})"
    verdict = f"saves {amount}" if saved >= 0 else f"costs {amount} more"
    return [f"Against the reference, {figure(full.value)} {case.unit} an image, it {verdict}."]


def _what_paid(case: Case, chosen: Candidate) -> list[str]:
    """What each setting did: pairs of configurations that differ from the chosen in that one setting."""
    reference = case.tradeoff.reference
    others = case.measured if chosen.point else [*case.measured, *case.predicted]
    told: list[tuple[float, str]] = []
    for name in chosen.settings:
        pairs = [other for other in others if _differs_only_in(chosen, other, name)]
        if not pairs:
            continue
        wanted = reference.settings.get(name) if reference else None
        best = min(pairs, key=lambda other: (other.settings[name] != wanted, other.difference.value))
        saved = best.cost.value - chosen.cost.value
        if saved > 0:
            told.append((saved, _paid(case, name, chosen, best)))
    told.sort(key=lambda item: -item[0])
    return [sentence for _, sentence in told[:MAX_PAID]]


def _paid(case: Case, name: str, chosen: Candidate, other: Candidate) -> str:
    saved = other.cost.value - chosen.cost.value
    sentence = (
        f"{name} {setting(chosen.settings[name])} instead of {setting(other.settings[name])} saves "
        f"{figure(saved)} {case.unit} ({share(saved / other.cost.value)})"
    )
    if pictures_agree(chosen, other):
        return f"{sentence} for the very same picture."
    change = f"from {figure(other.difference.value)} to {figure(chosen.difference.value)}"
    overlap = chosen.difference.low <= other.difference.high and other.difference.low <= chosen.difference.high
    return f"{sentence}; the difference goes {change}{', within its interval' if overlap else ''}."


def _differs_only_in(one: Candidate, other: Candidate, name: str) -> bool:
    names = {n for n in {*one.settings, *other.settings} if one.settings.get(n) != other.settings.get(n)}
    return names - NO_SETTINGS == {name} and name in other.settings


def _close_call(case: Case, chosen: Candidate, runner_up: Candidate) -> list[str]:
    """Say so where the intervals do not tell the first from the second."""
    others = {n: v for n, v in runner_up.settings.items() if n not in NO_SETTINGS and chosen.settings.get(n) != v}
    named = settings(others) or runner_up.label
    if pictures_agree(chosen, runner_up):
        return [f"The runner-up, {named}, gives the very same picture: what tells them apart does nothing here."]
    what, one, other = "difference", chosen.difference, runner_up.difference
    if case.budget is None:
        what, one, other = "cost", chosen.cost, runner_up.cost
    if one.high < other.low:
        return []
    return [
        f"The runner-up, {named}, cannot be told from it by {what}: "
        f"{figure(other.value)} ({figure(other.low)} to {figure(other.high)}) against {figure(one.value)} "
        f"({figure(one.low)} to {figure(one.high)})."
    ]
