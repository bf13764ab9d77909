"""Configurations drawn from ranges: at random, or by a Sobol sequence that fills the space evenly."""

import math
import random
from collections.abc import Iterator
from typing import Any

from joulebox_server.schemas.base import Scalar
from joulebox_server.schemas.sweep import Range, SweepDefinition

TRIES = 20
"""Draws for each wanted configuration before a space is taken to hold no more."""
DIGITS = 6


def drawn(definition: SweepDefinition) -> Iterator[dict[str, Any]]:
    """`samples` configurations, each different; fewer when the axes hold no more."""
    wanted = definition.samples or 0
    seen: set[tuple[Scalar, ...]] = set()
    for point in _points(definition, wanted):
        values = tuple(_value(axis, u) for axis, u in zip(definition.axes.values(), point, strict=True))
        if values not in seen:
            seen.add(values)
            yield dict(zip(definition.axes, values, strict=True))
        if len(seen) == wanted:
            return


def _points(definition: SweepDefinition, wanted: int) -> Iterator[list[float]]:
    """Points of the unit cube, as many as it may take."""
    dimensions = len(definition.axes)
    if definition.rule == "random":
        generator = random.Random(definition.sample_seed)
        for _ in range(TRIES * wanted):
            yield [generator.random() for _ in range(dimensions)]
        return
    from scipy.stats import qmc  # takes a second to import, and only this rule needs it

    sobol = qmc.Sobol(dimensions, scramble=True, rng=definition.sample_seed)
    # Powers of two keep the sequence balanced; it goes on where it stopped when values coincide.
    count = 1 << max(0, math.ceil(math.log2(wanted)))
    yield from sobol.random(count).tolist()
    for _ in range(TRIES.bit_length()):
        yield from sobol.random(count).tolist()
        count *= 2


def _value(axis: list[Scalar] | Range, u: float) -> Scalar:
    """What a coordinate from 0 to 1 (excluded) means on an axis."""
    if isinstance(axis, list):
        return axis[min(len(axis) - 1, int(u * len(axis)))]
    whole = isinstance(axis.low, int) and isinstance(axis.high, int)
    low, high = (axis.low - 0.5, axis.high + 0.5) if whole else (axis.low, axis.high)
    if axis.scale == "log":
        # The lower end of a whole number's interval is not rounded below 1/2, whose logarithm is finite.
        found = math.exp(math.log(low) + u * (math.log(high) - math.log(low)))
    else:
        found = low + u * (high - low)
    if whole:
        return int(min(axis.high, max(axis.low, round(found))))
    return min(float(axis.high), max(float(axis.low), float(f"{found:.{DIGITS}g}")))
