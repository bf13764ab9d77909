"""What a recommendation chooses from: measured points, and predictions for settings that were never measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from joulebox_server.analysis.documents import Axis, Basis, Point, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.pareto import standings
from joulebox_server.analysis.points import changed_settings, label_of
from joulebox_server.analysis.scatter import one_sided
from joulebox_server.analysis.surrogate import Forecast, Surrogate


@dataclass(frozen=True)
class Candidate:
    """Settings with a cost and a difference, whose bounds each hold with the trade-off's confidence.

    point       null for settings that were never measured on this device
    """

    configuration_id: str | None
    label: str
    settings: dict[str, Any]
    changed: dict[str, Any]
    cost: Interval
    difference: Interval
    point: Point | None

    @property
    def basis(self) -> Basis:
        """Whether it was measured."""
        return "predicted" if self.point is None else "measured"

    @property
    def key(self) -> str:
        """Orders what is equal in everything else."""
        return self.configuration_id or self.label


Known = tuple[list[Candidate], list[Candidate]]
"""What was measured, and what is predicted."""


def candidates(tradeoff: Tradeoff, axis: Axis) -> Known:
    """Every point that has both a cost and a difference; and every combination of their values that was never run.

    Where there are enough points, what was measured of one is steadied by what was measured of others, and
    combinations can be predicted; otherwise points stand for themselves and nothing is predicted.
    """
    surrogate = Surrogate(tradeoff, axis)
    if not surrogate.possible:
        known = [(p, cost, p.difference) for p in tradeoff.points if (cost := p.cost(axis)) and p.difference]
        return [_of_point(*each, tradeoff) for each in known], []
    measured = [_of_point(*each, tradeoff) for each in surrogate.steadied()]
    predicted = [from_forecast(tradeoff, each) for each in surrogate.forecasts(surrogate.never_run())]
    return measured, predicted


def _of_point(point: Point, cost: Interval, difference: Interval, tradeoff: Tradeoff) -> Candidate:
    return Candidate(
        point.configuration_id,
        point.label,
        point.settings,
        point.changed,
        bounds(cost, tradeoff.confidence),
        bounds(difference, tradeoff.confidence),
        point,
    )


def bounds(interval: Interval, confidence: float) -> Interval:
    """Bounds that each hold with the confidence, from those that hold together with it."""
    part = one_sided(confidence)
    low, value, high = interval.low, interval.value, interval.high
    return Interval(value=value, low=value - part * (value - low), high=value + part * (high - value))


def from_forecast(tradeoff: Tradeoff, forecast: Forecast, configuration_id: str | None = None) -> Candidate:
    """A prediction as a candidate."""
    base: Mapping[str, Any] | None = tradeoff.reference.settings if tradeoff.reference else None
    return Candidate(
        configuration_id,
        label_of(forecast.settings, base, tradeoff.axes),
        forecast.settings,
        changed_settings(forecast.settings, base, tradeoff.axes),
        bounds(forecast.cost, tradeoff.confidence),
        bounds(forecast.difference, tradeoff.confidence),
        None,
    )


def worth_showing(measured: Sequence[Candidate], predicted: Sequence[Candidate]) -> list[Candidate]:
    """Of the predictions those that nothing, measured or predicted, is expected to beat in both cost and difference."""
    every = [*predicted, *measured]
    found = standings([c.cost for c in every], [c.difference for c in every], [1] * len(every))
    return [candidate for candidate, standing in zip(predicted, found, strict=False) if standing.on_front]


def pictures_agree(one: Candidate, other: Candidate) -> bool:
    """Whether two configurations gave the very same pixels: what tells them apart does nothing on this scene."""
    hashes: Sequence[str | None] = [c.point.pixel_sha256 if c.point else None for c in (one, other)]
    return hashes[0] is not None and hashes[0] == hashes[1]
