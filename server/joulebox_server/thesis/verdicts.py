"""Claims judged: each rule applied to the results, and what is said where it does not hold."""

from dataclasses import dataclass, replace
from typing import Any

from joulebox_server.analysis.intervals import Interval
from joulebox_server.thesis.batch import Claim, Finding
from joulebox_server.thesis.judging import bounded
from joulebox_server.thesis.results import MissingError, Results

BY_CONSTRUCTION = "on a time basis this is true by construction, so it says nothing"
UNDECIDED = "the interval reaches over a bound of the rule; more renders, on a quieter machine, decide it"


@dataclass(frozen=True)
class Judged:
    """A claim with what was found on it."""

    claim: Claim
    basis: str
    finding: Finding

    def document(self) -> dict[str, Any]:
        """The claim's entry in claims.json."""
        found = self.finding
        return {
            "id": self.claim.id,
            "claim": self.claim.claim,
            "thesis": self.claim.thesis,
            "rule": self.claim.rule,
            "ours": {
                **_numbers(found.value),
                "unit": found.unit,
                "words": found.words,
            },
            "basis": self.basis,
            "verdict": found.verdict,
            "why": self.why,
        }

    @property
    def why(self) -> str:
        """Why it does not hold; nothing where it does."""
        if self.finding.verdict == "holds":
            return ""
        if self.finding.verdict == "unclear":
            return self.finding.why or self.claim.undecided or UNDECIDED
        return self.finding.why or self.claim.explanation


def _numbers(value: Interval | None) -> dict[str, float | None]:
    """For JSON, which has no infinity: a bound that is none is null."""
    if value is None:
        return {"value": None, "low": None, "high": None}
    return {"value": value.value, "low": value.low, "high": value.high if bounded(value) else None}


def judge(claim: Claim, results: Results) -> Judged:
    """Apply a claim's rule; what cannot be judged is unclear and says why."""
    basis = "replayed" if claim.replayed and results.basis != "measured" else results.basis
    try:
        found = claim.judge(results)
    except MissingError as error:
        found = Finding(None, "", "unclear", f"not judged: {error}", why="the points that it needs were not rendered")
    if claim.about_energy and results.basis == "time" and not claim.replayed:
        found = replace(found, verdict="unclear", why=BY_CONSTRUCTION)
    return Judged(claim, basis, found)
