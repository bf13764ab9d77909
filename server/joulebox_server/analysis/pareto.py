"""Pareto fronts of cost against difference, and whether they hold under the intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

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
    pairs = [(c, d) if c is not None and d is not None else None for c, d in zip(costs, differences, strict=True)]
    return [_standing(index, pairs, repeats) for index in range(len(pairs))]


def _standing(index: int, pairs: Sequence[tuple[Interval, Interval] | None], repeats: Sequence[int]) -> Standing:
    here = pairs[index]
    if here is None:
        return Standing(on_front=False, confirmed=False)
    others = [pair for place, pair in enumerate(pairs) if pair is not None and place != index]
    # only others that were repeated can prove a point dominated
    proven = [pair for place, pair in enumerate(pairs) if pair and place != index and repeats[place] > 1]
    dominated = any(_dominates(other, here) for other in others)
    if repeats[index] < 2:
        holds = False
    elif dominated:
        holds = any(_surely_dominates(other, here) for other in proven)
    else:
        holds = not any(_may_dominate(other, here) for other in others)
    return Standing(on_front=not dominated, confirmed=holds)


def _dominates(other: tuple[Interval, Interval], here: tuple[Interval, Interval]) -> bool:
    no_worse = all(o.value <= h.value for o, h in zip(other, here, strict=True))
    return no_worse and any(o.value < h.value for o, h in zip(other, here, strict=True))


def _surely_dominates(other: tuple[Interval, Interval], here: tuple[Interval, Interval]) -> bool:
    return all(o.high < h.low for o, h in zip(other, here, strict=True))


def _may_dominate(other: tuple[Interval, Interval], here: tuple[Interval, Interval]) -> bool:
    return all(o.low <= h.high for o, h in zip(other, here, strict=True))
