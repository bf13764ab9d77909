"""Pareto fronts of cost against difference, and whether they hold under the intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulebox_server.analysis.intervals import Interval


@dataclass(frozen=True)
class Standing:
    """Where a point stands: on the front by its values, and whether that holds within the intervals."""

    on_front: bool
    confirmed: bool


def standings(
    costs: Sequence[Interval | None], differences: Sequence[Interval | None], repeats: Sequence[int]
) -> list[Standing]:
    """Standing of every point; both coordinates count as better when smaller.

    By values: a point is off the front when another is no worse in both coordinates and better in one.
    Confirmed, on the front: no other could be better or equal in both, the worst of its intervals taken
    for the point and the best for the other. Confirmed, off the front: some other surely dominates it, the
    best taken for the point and the worst for the other. A point that lacks a coordinate is on no front
    and not confirmed, nor is one of a single repeat, of whose scatter nothing is known.
    """
    known = [(c, d) if c is not None and d is not None else None for c, d in zip(costs, differences, strict=True)]
    counts = [count for count, pair in zip(repeats, known, strict=True) if pair is not None]
    others = _Others.of([pair for pair in known if pair is not None], counts)
    places = iter(range(len(repeats)))
    return [_NOWHERE if pair is None else others.standing(next(places)) for pair in known]


_NOWHERE = Standing(on_front=False, confirmed=False)
_Bounds = NDArray[np.float64]


@dataclass(frozen=True)
class _Others:
    """All points as arrays (2, N), cost above difference; and which of them were repeated."""

    value: _Bounds
    low: _Bounds
    high: _Bounds
    repeated: NDArray[np.bool_]

    @classmethod
    def of(cls, pairs: Sequence[tuple[Interval, Interval]], repeats: Sequence[int]) -> "_Others":
        value, low, high = (
            np.array([[getattr(interval, bound) for interval in pair] for pair in pairs]).reshape(-1, 2).T
            for bound in ("value", "low", "high")
        )
        return cls(value, low, high, np.array(repeats) > 1)

    def standing(self, place: int) -> Standing:
        value, low, high = (bound[:, place, None] for bound in (self.value, self.low, self.high))
        dominated = bool(((self.value <= value).all(axis=0) & (self.value < value).any(axis=0)).any())
        if not self.repeated[place]:
            return Standing(on_front=not dominated, confirmed=False)
        if dominated:
            # only others that were repeated can prove a point dominated; none surely dominates itself
            return Standing(on_front=False, confirmed=bool(((self.high < low).all(axis=0) & self.repeated).any()))
        may_dominate = int((self.low <= high).all(axis=0).sum())  # the point itself among them
        return Standing(on_front=True, confirmed=may_dominate == 1)
