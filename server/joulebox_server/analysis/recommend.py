"""Settings for a budget: the choice by upper confidence bounds.

A candidate fits when the upper bound of its cost is within the budget and the upper bound of its difference
within the limit. With a budget, the best picture that fits is chosen (smallest upper bound of the
difference); without one, the cheapest (smallest upper bound of the cost) that is surely acceptable. Measured
points come first: predictions answer where no measured point fits or where they are asked for, and are marked. Among
them the smallest difference to be expected wins, since bounds of different width would prefer what was measured.
"""

import math
from collections.abc import Sequence
from typing import Any

from joulebox_server.analysis.budgets import Budget
from joulebox_server.analysis.candidates import Candidate, Known, candidates
from joulebox_server.analysis.documents import UNITS, Axis, Choice, Recommendation, Tradeoff
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.intervals import TINY, Interval, log_deviation
from joulebox_server.analysis.lines import steps_from
from joulebox_server.analysis.proposals import worth_measuring
from joulebox_server.analysis.ratings import why_fragile
from joulebox_server.analysis.reasons import Case, none_reasons, reasons
from joulebox_server.analysis.scatter import stretch
from joulebox_server.analysis.terms import Terms
from joulebox_server.analysis.words import figure

PROPOSALS = 3
"""Better settings to confirm that an answer names unless more are asked for."""


def recommend(
    tradeoff: Tradeoff,
    budget_j: float | None = None,
    budget_s: float | None = None,
    difference_limit: float | None = None,
    confidence: float | None = None,
    *,
    predict: bool = False,
    proposals: int = PROPOSALS,
    told_budget: str | None = None,
    transferred: Sequence[Candidate] = (),
    known: Known | None = None,
) -> Recommendation:
    """The settings to use, or "none" with the nearest two.

    budget_j, budget_s  per image, not both; without either the cheapest acceptable settings are asked for
    difference_limit    in the trade-off's own unit; its acceptable limit unless given
    confidence          must be the one that the trade-off was built at; None takes that
    predict             rank predictions together with what was measured, rather than after it
    proposals           how many settings to name at most that are worth measuring, as they promise more
    told_budget         where the budget comes from, in words
    transferred         predictions from other devices' runs of configurations that this one has not run
    known               `candidates(tradeoff, axis)` where they have been found for another question already

    Raises AnalysisError for a budget, limit or confidence that makes no sense, for a budget in joules where
    no energy is known, and where no point can be judged at all.
    """
    if confidence is not None and confidence != tradeoff.confidence:
        raise AnalysisError(f"the confidence is {confidence}, but the trade-off was built at {tradeoff.confidence}")
    if not tradeoff.points and not transferred:
        raise AnalysisError(_nothing_to_judge(tradeoff))
    terms = _terms(tradeoff, Budget(budget_j, budget_s), difference_limit)
    measured, predicted = known or candidates(tradeoff, terms.axis)
    predicted = [*transferred, *predicted]
    if not measured and not predicted:
        raise AnalysisError(_nothing_to_judge(tradeoff))
    fitting = _fitting(terms, [*measured, *predicted] if predict else measured, tradeoff.confidence)
    if not fitting and not predict:
        fitting = _fitting(terms, predicted, tradeoff.confidence)
    case = Case(tradeoff, terms.axis, terms.budget, terms.limit, told_budget, fitting, measured, predicted)
    chosen = fitting[0] if fitting else None
    # What is only predicted to be best is the first to be measured: it is no answer to improve on yet.
    sure = next((candidate for candidate in fitting if candidate.point), None)
    promising = worth_measuring(terms, sure, [*measured, *predicted], tradeoff.confidence, proposals)
    proposed = [_choice(tradeoff, candidate, terms) for candidate in promising]
    if chosen is None:
        return _no_answer(case, terms, measured or predicted, proposed)
    best = _choice(tradeoff, chosen, terms)
    return Recommendation(
        answer="settings",
        **_question(tradeoff, terms),
        why=reasons(case),
        steps=steps_from(tradeoff, chosen.point, terms.axis) if chosen.point else [],
        runner_up=_choice(tradeoff, fitting[1], terms) if len(fitting) > 1 else None,
        proposals=proposed,
        **best.model_dump(exclude={"misses"}),
    )


def _nothing_to_judge(tradeoff: Tradeoff) -> str:
    if not tradeoff.device:
        return f"no device works on this sweep of {tradeoff.scene} yet; `joulebox device list` shows those there are"
    measured = len(tradeoff.points)
    have = "configuration was" if measured == 1 else "configurations were"
    so_far = f"; {measured} {have} measured" if measured else ""
    return (
        f"no configuration of {tradeoff.scene} on {tradeoff.device} has been both measured "
        f"and compared to the reference yet{so_far}"
    )


def _terms(tradeoff: Tradeoff, budget: Budget, difference_limit: float | None) -> Terms:
    if budget.joules is not None and budget.seconds is not None:
        raise AnalysisError("a budget in joules and one in seconds are given, it must be one of them")
    given = {"budget_j": budget.joules, "budget_s": budget.seconds, "difference_limit": difference_limit}
    for name, value in given.items():
        if value is not None and not 0 < value < float("inf"):
            raise AnalysisError(f"{name} is {value}, it must be a number above 0")
    if budget.joules is not None and tradeoff.energy_quality == "time_only":
        raise AnalysisError(
            f"no energy is known for {tradeoff.scene} on {tradeoff.device}, the budget must be in seconds (budget_s)"
        )
    axis: Axis = tradeoff.main_axis if budget.seconds is None else "time_s"
    amount = budget.seconds if budget.joules is None else budget.joules
    return Terms(axis, amount, tradeoff.limit if difference_limit is None else difference_limit)


def _fitting(terms: Terms, known: Sequence[Candidate], confidence: float) -> list[Candidate]:
    """What fits, best first; without a budget from the first on that is sure enough to be the cheapest.

    The cheapest that is acceptable is found by going up from cheap ones, and each that may be acceptable has its own
    chance of seeming so. The more of them were passed, the surer the next one has to be (Bonferroni's share of the
    error for each); where none is, what fits by itself answers.
    """
    fitting = sorted(filter(terms.fits, known), key=terms.rank)
    if terms.budget is not None:
        is_measured = all(candidate.point for candidate in fitting)
        return fitting if is_measured else sorted(fitting, key=lambda c: _expected(c.difference, confidence))
    tries, best = 1, math.inf
    for candidate in sorted(known, key=terms.rank):
        found = candidate.difference
        if found.high >= best:
            continue  # something cheaper differs less
        best = found.high
        if found.value + stretch(confidence, tries) * (found.high - found.value) <= terms.limit:
            return fitting[fitting.index(candidate) :]
        tries += found.low <= terms.limit
    return fitting


def _expected(difference: Interval, confidence: float) -> float:
    """Log of the mean of what is normal in logs."""
    return math.log(max(difference.value, TINY)) + log_deviation(difference, confidence) ** 2 / 2


def _question(tradeoff: Tradeoff, terms: Terms) -> dict[str, Any]:
    """What was asked, as every answer repeats it."""
    return {
        "energy_quality": tradeoff.energy_quality,
        "scene": tradeoff.scene,
        "device": tradeoff.device,
        "confidence": tradeoff.confidence,
        "limit": terms.limit,
        "budget_j": terms.budget if terms.axis == "energy_j" else None,
        "budget_s": terms.budget if terms.axis == "time_s" else None,
    }


def _no_answer(case: Case, terms: Terms, judged: Sequence[Candidate], proposed: list[Choice]) -> Recommendation:
    by_overshoot = sorted(judged, key=lambda c: (terms.overshoot(c), c.key))
    nearest = [_choice(case.tradeoff, near, terms, _misses(near, terms)) for near in by_overshoot[:2]]
    return Recommendation(
        answer="none",
        **_question(case.tradeoff, terms),
        why=none_reasons(case),
        nearest=nearest,
        proposals=proposed,
    )


def _choice(tradeoff: Tradeoff, candidate: Candidate, terms: Terms, misses: str | None = None) -> Choice:
    point, reference = candidate.point, tradeoff.reference
    bounds: dict[Axis, Interval | None] = {
        "energy_j": point.energy_j if point else None, "time_s": point.time_s if point else None,
    }  # fmt: skip
    bounds[terms.axis] = candidate.cost
    saves_j, saves_s = (
        _saving(reference.cost(axis) if reference else None, bounds[axis]) for axis in ("energy_j", "time_s")
    )
    saved = saves_j if terms.axis == "energy_j" else saves_s
    full = reference.cost(terms.axis) if reference else None
    return Choice(
        configuration_id=candidate.configuration_id,
        label=candidate.label,
        basis=candidate.basis,
        settings=candidate.settings,
        changed=candidate.changed,
        energy_j=bounds["energy_j"],
        time_s=bounds["time_s"],
        difference=candidate.difference,
        stages_left_out=point.left_out if point else {},
        saves_j=saves_j,
        saves_s=saves_s,
        saves_share=saved / full.value if saved is not None and full and full.value > 0 else None,
        fragile=why_fragile(tradeoff, point, terms.limit) if point else "predicted, not measured: its seeds are unseen",
        misses=misses,
    )


def _saving(reference: Interval | None, chosen: Interval | None) -> float | None:
    return None if reference is None or chosen is None else reference.value - chosen.value


def _misses(candidate: Candidate, terms: Terms) -> str:
    unit, missed = UNITS[terms.axis], []
    if terms.budget is not None and candidate.cost.high > terms.budget:
        missed.append(
            f"it costs {figure(candidate.cost.value)} {unit} (up to {figure(candidate.cost.high)}), "
            f"the budget is {figure(terms.budget)} {unit}"
        )
    difference = candidate.difference
    if difference.high > terms.limit:
        missed.append(
            f"its difference is {figure(difference.value)} (up to {figure(difference.high)}), "
            f"the limit is {figure(terms.limit)}"
        )
    return "; ".join(missed)
