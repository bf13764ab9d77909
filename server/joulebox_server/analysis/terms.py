"""What a recommendation is asked for, and what a candidate comes to by it."""

from dataclasses import dataclass

from joulebox_server.analysis.candidates import Candidate
from joulebox_server.analysis.documents import Axis
from joulebox_server.analysis.intervals import Interval


@dataclass(frozen=True)
class Terms:
    """What a recommendation is asked for; budget per image in the axis' unit, None for as cheap as can be."""

    axis: Axis
    budget: float | None
    limit: float

    def fits(self, candidate: Candidate) -> bool:
        """Whether both upper bounds are within."""
        within_budget = self.budget is None or candidate.cost.high <= self.budget
        return within_budget and candidate.difference.high <= self.limit

    def rank(self, candidate: Candidate) -> tuple[float, float, float, float, str]:
        """Smaller is better; of two points one dominates, the dominated one ranks behind."""
        first, second = self.sought(candidate), self.held(candidate)
        return first.high, second.high, first.value, second.value, candidate.key

    def sought(self, candidate: Candidate) -> Interval:
        """What is to be small: the difference, or without a budget the cost."""
        return candidate.cost if self.budget is None else candidate.difference

    def held(self, candidate: Candidate) -> Interval:
        """What is only to stay within: the cost, or without a budget the difference."""
        return candidate.difference if self.budget is None else candidate.cost

    def overshoot(self, candidate: Candidate) -> float:
        """By what factor the worse of the two upper bounds exceeds what is allowed."""
        cost = 0.0 if self.budget is None else candidate.cost.high / self.budget
        return max(cost, candidate.difference.high / self.limit)
