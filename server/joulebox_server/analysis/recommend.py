"""Settings for a budget: the choice among measured points, by their upper confidence bounds.

A point fits when the upper bound of its cost is within the budget and the upper bound of its difference
within the limit. With a budget, the best picture that fits is chosen (smallest upper bound of the
difference); without one, the cheapest (smallest upper bound of the cost).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from joulebox_server.analysis.documents import UNITS, Axis, Choice, Point, Recommendation, Tradeoff
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.reasons import none_reasons, reasons
from joulebox_server.analysis.words import figure

JOULES_PER_WATT_HOUR = 3600.0


@dataclass(frozen=True)
class Candidate:
    """A point that has both a cost and a difference."""

    point: Point
    cost: Interval
    difference: Interval


@dataclass(frozen=True)
class Terms:
    """What a recommendation is asked for; budget per image in the axis' unit, None for as cheap as can be."""

    axis: Axis
    budget: float | None
    limit: float

    def fits(self, candidate: Candidate) -> bool:
        """Whether both upper bounds are within."""
        affordable = self.budget is None or candidate.cost.high <= self.budget
        return affordable and candidate.difference.high <= self.limit

    def rank(self, candidate: Candidate) -> tuple[float, float, float, float, str]:
        """Smaller is better; of two points one dominates, the dominated one ranks behind."""
        cost, difference = candidate.cost, candidate.difference
        first, second = (cost, difference) if self.budget is None else (difference, cost)
        return first.high, second.high, first.value, second.value, candidate.point.configuration_id

    def overshoot(self, candidate: Candidate) -> float:
        """By what factor the worse of the two upper bounds exceeds what is allowed."""
        cost = 0.0 if self.budget is None else candidate.cost.high / self.budget
        return max(cost, candidate.difference.high / self.limit)


def recommend(
    tradeoff: Tradeoff,
    budget_j: float | None = None,
    budget_s: float | None = None,
    difference_limit: float | None = None,
    confidence: float | None = None,
) -> Recommendation:
    """The settings to use, or "none" with the nearest two.

    budget_j, budget_s  per image, not both; without either the cheapest acceptable settings are asked for
    difference_limit    in the trade-off's own unit; its acceptable limit unless given
    confidence          must be the one that the trade-off was built at; None takes that

    Raises AnalysisError for a budget, limit or confidence that makes no sense, for a budget in joules where
    no energy is known, and where no point can be judged at all.
    """
    if confidence is not None and confidence != tradeoff.confidence:
        raise AnalysisError(f"the confidence is {confidence}, but the trade-off was built at {tradeoff.confidence}")
    terms = _terms(tradeoff, budget_j, budget_s, difference_limit)
    candidates = _candidates(tradeoff, terms.axis)
    fitting = sorted(filter(terms.fits, candidates), key=terms.rank)
    if not fitting:
        return _no_answer(tradeoff, terms, candidates)
    best = _choice(tradeoff, fitting[0], terms)
    return Recommendation(
        answer="settings",
        **_question(tradeoff, terms),
        why=reasons(tradeoff, terms.axis, terms.budget, terms.limit, [c.point for c in fitting], len(candidates)),
        runner_up=_choice(tradeoff, fitting[1], terms) if len(fitting) > 1 else None,
        **best.model_dump(exclude={"misses"}),
    )


def budget_per_image_j(watt_hours: float, images: int) -> float:
    """Joules an image [J] when a number of images may use an energy [Wh].

    Raises AnalysisError for an energy that is not above 0 or fewer than one image.
    """
    if not 0 < watt_hours < float("inf"):
        raise AnalysisError(f"the budget is {watt_hours} Wh, it must be above 0")
    if images < 1:
        raise AnalysisError(f"the budget is for {images} images, it must be for at least 1")
    return watt_hours * JOULES_PER_WATT_HOUR / images


def _terms(tradeoff: Tradeoff, budget_j: float | None, budget_s: float | None, difference_limit: float | None) -> Terms:
    if budget_j is not None and budget_s is not None:
        raise AnalysisError("a budget in joules and one in seconds are given, it must be one of them")
    for name, value in (
        ("budget_j", budget_j),
        ("budget_s", budget_s),
        ("difference_limit", difference_limit),
    ):
        if value is not None and not 0 < value < float("inf"):
            raise AnalysisError(f"{name} is {value}, it must be a number above 0")
    if budget_j is not None and tradeoff.energy_quality == "time_only":
        raise AnalysisError(
            f"no energy is known for {tradeoff.scene} on {tradeoff.device}, the budget must be in seconds (budget_s)"
        )
    axis: Axis = tradeoff.main_axis
    if budget_s is not None:
        axis = "time_s"
    budget = budget_j if budget_j is not None else budget_s
    return Terms(axis, budget, tradeoff.limit if difference_limit is None else difference_limit)


def _candidates(tradeoff: Tradeoff, axis: Axis) -> list[Candidate]:
    candidates = [
        Candidate(point, cost, point.difference)
        for point in tradeoff.points
        if (cost := point.cost(axis)) is not None and point.difference is not None
    ]
    if not candidates:
        raise AnalysisError(
            f"no configuration of {tradeoff.scene} on {tradeoff.device} has been both measured "
            "and compared to the reference yet"
        )
    return candidates


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


def _no_answer(tradeoff: Tradeoff, terms: Terms, candidates: Sequence[Candidate]) -> Recommendation:
    by_overshoot = sorted(candidates, key=lambda c: (terms.overshoot(c), c.point.configuration_id))
    nearest = [_choice(tradeoff, candidate, terms, _misses(candidate, terms)) for candidate in by_overshoot[:2]]
    return Recommendation(
        answer="none",
        **_question(tradeoff, terms),
        why=none_reasons(tradeoff, terms.axis, terms.budget, terms.limit, len(candidates)),
        nearest=nearest,
    )


def _choice(tradeoff: Tradeoff, candidate: Candidate, terms: Terms, misses: str | None = None) -> Choice:
    point, reference = candidate.point, tradeoff.reference
    saves_j = _saving(reference.energy_j if reference else None, point.energy_j)
    saves_s = _saving(reference.time_s if reference else None, point.time_s)
    saved = saves_j if terms.axis == "energy_j" else saves_s
    full = reference.cost(terms.axis) if reference else None
    return Choice(
        configuration_id=point.configuration_id,
        label=point.label,
        settings=point.settings,
        changed=point.changed,
        energy_j=point.energy_j,
        time_s=point.time_s,
        difference=candidate.difference,
        saves_j=saves_j,
        saves_s=saves_s,
        saves_share=saved / full.value if saved is not None and full and full.value > 0 else None,
        fragile=_fragile(point, candidate.difference, terms.limit, tradeoff.confidence),
        misses=misses,
    )


def _saving(reference: Interval | None, chosen: Interval | None) -> float | None:
    return None if reference is None or chosen is None else reference.value - chosen.value


def _fragile(point: Point, difference: Interval, limit: float, confidence: float) -> str | None:
    """Why the difference may not stay within the limit; null where the evidence says that it does."""
    if point.repeats < 2:
        return (
            f"rendered with one seed only: its difference of {figure(difference.value)} may be larger with "
            "another seed, and nothing is known of by how much"
        )
    if difference.value <= limit < difference.high:
        return (
            f"its difference is {figure(difference.value)} on average over {point.repeats} seeds, but its "
            f"{confidence:.0%} interval reaches {figure(difference.high)}, beyond the limit {figure(limit)}"
        )
    return None


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
