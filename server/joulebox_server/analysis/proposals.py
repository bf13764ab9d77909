"""Which settings are worth measuring to improve an answer: the expected improvement.

A candidate's log cost and log difference are known as normal variables. Measuring it helps when it turns out to
fit and to be better than what was chosen; by how much in the mean is known in closed form (constrained expected
improvement: Schonlau, Welch & Jones 1998; Gelbart, Snoek & Adams 2014). So a candidate whose value is a little too
dear, but may well not be, is looked at too, and one that is surely no better is not. Where nothing fits yet, to have
an answer at all is an improvement too: so the best there is, a little above the limit, is measured again.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist, median

from joulebox_server.analysis.candidates import Candidate
from joulebox_server.analysis.intervals import TINY, log_deviation
from joulebox_server.analysis.terms import Terms

MIN_GAIN = 0.005
"""Smaller improvements to be expected, as a share of what is sought, are not worth a run."""
WORTH_OF_AN_ANSWER = 1.0
"""Where there was none; in logs, as if what fits were better by a factor of e: a chance of MIN_GAIN is worth a run."""
_NORMAL = NormalDist()


def worth_measuring(
    terms: Terms, chosen: Candidate | None, known: Sequence[Candidate], confidence: float, count: int
) -> list[Candidate]:
    """Candidates that were not measured, or not surely enough to fit, by the improvement that measuring each promises.

    chosen      the best that was measured and fits; None where nothing is, when whatever would fit is an improvement
    confidence  of each candidate's upper bounds
    """
    margins = _margins(known)
    level = _level(terms, chosen, known, margins)
    worth = WORTH_OF_AN_ANSWER if chosen is None else 0.0
    gains = [
        (_gain(terms, candidate, level, margins, confidence, worth), candidate)
        for candidate in known
        if candidate is not chosen and (candidate.point is None or not terms.fits(candidate))
    ]
    gains.sort(key=lambda each: (-each[0], terms.sought(each[1]).value, each[1].key))
    return [candidate for gain, candidate in gains[:count] if gain >= MIN_GAIN]


def _margins(known: Sequence[Candidate]) -> tuple[float, float]:
    """How far, in logs, the bounds of cost and difference usually are above the values once they are measured."""
    measured = [c for c in known if c.point is not None] or known
    cost, difference = (
        median(_log(i.high) - _log(i.value) for i in intervals)
        for intervals in ([c.cost for c in measured], [c.difference for c in measured])
    )
    return cost, difference


def _level(terms: Terms, chosen: Candidate | None, known: Sequence[Candidate], margins: tuple[float, float]) -> float:
    """What has to be undercut, in logs: the chosen one's value, or what anything that fits does."""
    if chosen is not None:
        return _log(terms.sought(chosen).value)
    if terms.budget is None:
        return max(_log(candidate.cost.value) for candidate in known)
    return _log(terms.limit) - margins[1]


def _gain(
    terms: Terms, candidate: Candidate, level: float, margins: tuple[float, float], confidence: float, worth: float
) -> float:
    """The mean of what it would be better by, in logs, and of `worth` on top if it is, over the chance that it fits."""
    cost_margin, difference_margin = margins
    if terms.budget is None:
        allowed = _log(terms.limit) - difference_margin
    else:
        allowed = _log(terms.budget) - cost_margin
        level = min(level, _log(terms.limit) - difference_margin)
    held, sought = terms.held(candidate), terms.sought(candidate)
    chance = _NORMAL.cdf((allowed - _log(held.value)) / log_deviation(held, confidence))
    deviation = log_deviation(sought, confidence)
    ahead = (level - _log(sought.value)) / deviation
    return chance * (worth * _NORMAL.cdf(ahead) + deviation * (ahead * _NORMAL.cdf(ahead) + _NORMAL.pdf(ahead)))


def _log(value: float) -> float:
    return math.log(max(value, TINY))
