"""How one configuration varies over its seeds: mean, spread, the worst of them, and how often it is not acceptable.

Whether that makes it fragile is said by `ratings.why_fragile`, of the same seeds: a study of where methods fail and a
recommendation judge alike.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy import stats

from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.intervals import Interval


@dataclass(frozen=True)
class Stability:
    """Of a configuration over its seeds.

    mean, worst     of the differences
    spread          standard deviation over the mean, with its interval
    share_beyond    of the seeds whose difference is beyond the limit
    """

    seeds: int
    mean: float
    worst: float
    spread: Interval
    share_beyond: float


def over_seeds(differences: Sequence[float], limit: float, confidence: float = 0.95) -> Stability:
    """Stability of differences, one a seed. Raises AnalysisError for fewer than two."""
    mean = math.fsum(differences) / max(len(differences), 1)
    return Stability(
        seeds=len(differences),
        mean=mean,
        worst=max(differences, default=0.0),
        spread=relative_spread(differences, confidence),
        share_beyond=sum(value > limit for value in differences) / len(differences),
    )


def relative_spread(values: Sequence[float], confidence: float = 0.95) -> Interval:
    """Standard deviation of values over their mean, with the interval that chi-square gives for normal scatter.

    0 where all values are alike. Raises AnalysisError for fewer than two values, or a mean that is not above 0.
    """
    if len(values) < 2:
        raise AnalysisError(f"{len(values)} seed says nothing of a spread, two or more are needed")
    mean = math.fsum(values) / len(values)
    freedom = len(values) - 1
    deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / freedom)
    if mean <= 0:
        if deviation == 0:
            return Interval(value=0.0, low=0.0, high=0.0)
        raise AnalysisError(f"the mean is {mean}, a spread relative to it needs one above 0")
    ends = [
        math.sqrt(freedom / float(stats.chi2.ppf(p, freedom))) for p in ((1 + confidence) / 2, (1 - confidence) / 2)
    ]
    share = deviation / mean
    return Interval(value=share, low=share * ends[0], high=share * ends[1])
