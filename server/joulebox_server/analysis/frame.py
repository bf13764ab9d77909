"""What a trade-off chart shows: rows of plain values and the range of each axis.

Everything that can be decided before drawing is decided here, so that the chart is a pure mapping of rows.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

from joulebox_server.analysis.candidates import Candidate
from joulebox_server.analysis.documents import UNITS, Axis, Point, Tradeoff
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.tradeoff import front_of
from joulebox_server.analysis.words import figure, setting

XName = Literal["energy_j", "time_s", "energy_j_per_pixel"]
YName = Literal["difference", "difference_per_pixel"]
ScaleName = Literal["auto", "linear", "log"]

LOG_FROM_RATIO = 20.0
"""Largest to smallest value from which on "auto" takes a logarithmic axis."""
MAX_COLOURS = 8
PREDICTED = "predicted, not measured"

X_UNITS: dict[XName, str] = {"energy_j": "J", "time_s": "s", "energy_j_per_pixel": "J"}
SETTING_PREFIX = "setting_"
"""Keeps the settings' names apart from the rows' own."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Range:
    """Lowest and highest value of an axis, and whether it is logarithmic."""

    low: float
    high: float
    log: bool

    def clamped(self, value: float) -> float:
        """The value, or the nearest end of the axis: a logarithmic axis has no 0."""
        return min(max(value, self.low), self.high)

    def fraction(self, value: float) -> float:
        """Where along the axis a value is, 0 at its low end and 1 at its high one."""
        inside = self.clamped(value)
        if self.log:
            return math.log(inside / self.low) / math.log(self.high / self.low)
        return (inside - self.low) / (self.high - self.low)

    def at(self, fraction: float) -> float:
        """The value at a fraction of the axis."""
        if self.log:
            return self.low * math.pow(self.high / self.low, fraction)
        return self.low + (self.high - self.low) * fraction


@dataclass(frozen=True)
class Frame:
    """Rows and ranges of one trade-off chart; values are those of the axes' quantities."""

    points: list[Row]
    segments: list[Row]
    predicted: list[Row]
    reference: Row | None
    x: Range
    y: Range
    limit: float
    floor: float | None
    colour_by: str | None


@dataclass(frozen=True)
class View:
    """How a trade-off is looked at.

    scale       "auto" takes a logarithmic axis where its values span a factor of more than 20
    budget      in the unit of x [J, s, or J a pixel]; drawn as an upright line
    limit       acceptable difference of a whole picture; None takes the sweep's
    colour_by   name of a setting; None takes the axis with the most values that colours can tell apart
    only        name of a setting -> its values that are looked at; every other point is drawn pale
    """

    x: XName = "energy_j"
    y: YName = "difference"
    scale: ScaleName = "auto"
    budget: float | None = None
    limit: float | None = None
    colour_by: str | None = None
    only: Mapping[str, Sequence[str]] = field(default_factory=dict)


def frame(tradeoff: Tradeoff, view: View, predictions: Sequence[Candidate] = ()) -> Frame:
    """Everything a chart of this trade-off shows.

    Raises AnalysisError where it has no energy to show, for a setting that no point has, and for a budget or a
    limit that is not above 0.
    """
    x, y, scale, budget = view.x, view.y, view.scale, view.budget
    for name, value in (("budget", budget), ("limit", view.limit)):
        if value is not None and not 0 < value < math.inf:
            raise AnalysisError(f"the {name} is {value}, it must be a number above 0")
    axis: Axis = "time_s" if x == "time_s" else "energy_j"
    if axis == "energy_j" and tradeoff.energy_quality == "time_only" and tradeoff.points:
        raise AnalysisError(
            f"no energy is known for {tradeoff.scene} on {tradeoff.device}, the chart must be over time_s"
        )
    area = tradeoff.width * tradeoff.height
    x_factor = 1 / area if x == "energy_j_per_pixel" else 1.0
    y_factor = 1 / area if y == "difference_per_pixel" else 1.0
    limit = (view.limit or tradeoff.limit) * y_factor
    floor = tradeoff.noise_floor.value * y_factor if tradeoff.noise_floor else None
    colour = _colour(tradeoff, view.colour_by)
    _check_named(tradeoff, view.only)
    names = [*varied(tradeoff), *([colour] if colour else [])]
    rows = _rows(tradeoff, axis, x_factor, y_factor, names, view.only)
    foretold = _predicted_rows(predictions, axis, x_factor, y_factor, names, view.only)
    reference = _reference_row(tradeoff, axis, x_factor)

    extra_x = [value for value in (budget, reference["x"] if reference else None) if value is not None]
    drawn = [*rows, *foretold]
    x_range = _range([row["x"] for row in drawn] + extra_x, (row["x_high"] for row in rows), scale)
    extra_y = [value for value in (limit, floor) if value is not None]
    y_range = _range([row["y"] for row in drawn] + extra_y, (row["y_high"] for row in rows), scale)
    for row in drawn:
        row.update({name: x_range.clamped(row[name]) for name in ("x", "x_low", "x_high")})
        row.update({name: y_range.clamped(row[name]) for name in ("y", "y_low", "y_high")})
    if reference is not None:
        reference["y"] = y_range.low  # its difference is 0, which a logarithmic axis does not reach
    return Frame(
        points=rows,
        segments=_segments(rows),
        predicted=foretold,
        reference=reference,
        x=x_range,
        y=y_range,
        limit=limit,
        floor=floor,
        colour_by=colour,
    )


def varied(tradeoff: Tradeoff) -> list[str]:
    """Names of the settings that the sweep varies or that differ from the reference's, in that order."""
    names = dict.fromkeys(tradeoff.axes)
    for point in tradeoff.points:
        names.update(dict.fromkeys(point.changed))
    return list(names)


def spread(interval: Interval | None, unit: str) -> str:
    """An interval in words: 3.84 J (3.72 to 3.96)."""
    if interval is None:
        return "not known"
    value = f"{figure(interval.value)} {unit}".strip()
    if interval.low == interval.high:
        return value
    return f"{value} ({figure(interval.low)} to {figure(interval.high)})"


def is_looked_at(settings: Mapping[str, Any], only: Mapping[str, Sequence[str]]) -> bool:
    """Whether settings are among those that a view is of; values are compared as the page writes them."""
    return all(setting(settings.get(name)) in values for name, values in only.items())


def _check_named(tradeoff: Tradeoff, names: Iterable[str]) -> None:
    for name in names:
        if tradeoff.points and not any(name in point.settings for point in tradeoff.points):
            raise AnalysisError(f"no setting is named {name}, points are chosen by one of the settings")


def _rows(
    tradeoff: Tradeoff,
    axis: Axis,
    x_factor: float,
    y_factor: float,
    names: Sequence[str],
    only: Mapping[str, Sequence[str]],
) -> list[Row]:
    rows = []
    for point, standing in zip(tradeoff.points, front_of(tradeoff.points, axis), strict=True):
        cost, difference = point.cost(axis), point.difference
        if cost is None or difference is None:
            continue
        front = "off the front"
        if standing.on_front:
            front = "on the front" if standing.confirmed else "on the front, not confirmed"
        rows.append(
            _told(point, names)
            | _coordinates(cost, difference, x_factor, y_factor)
            | {"standing": front, "on_front": standing.on_front, "confirmed": standing.confirmed}
            | {"shown": is_looked_at(point.settings, only)}
        )
    return rows


def _predicted_rows(
    predictions: Sequence[Candidate],
    axis: Axis,
    x_factor: float,
    y_factor: float,
    names: Sequence[str],
    only: Mapping[str, Sequence[str]],
) -> list[Row]:
    """Settings that were never measured, where the surrogate expects them."""
    word = "energy" if axis == "energy_j" else "time"
    return [
        {
            "label": choice.label,
            word: f"{spread(choice.cost, UNITS[axis])}, predicted",
            "difference": f"{spread(choice.difference, '')}, predicted",
            "standing": PREDICTED,
            "shown": is_looked_at(choice.settings, only),
            **{SETTING_PREFIX + name: choice.settings.get(name) for name in names},
        }
        | _coordinates(choice.cost, choice.difference, x_factor, y_factor)
        for choice in predictions
    ]


def _told(point: Point, names: Sequence[str]) -> Row:
    """What a tooltip says of a point."""
    return {
        "configuration_id": point.configuration_id,
        "label": point.label,
        "energy": spread(point.energy_j, "J") + ("" if point.quality == "measured" else f", {point.quality}"),
        "time": spread(point.time_s, "s"),
        "difference": spread(point.difference, ""),
        "energy_j_value": point.energy_j.value if point.energy_j else None,
        "time_s_value": point.time_s.value,
        "repeats": point.repeats,
        "fragile": point.fragile,
        **{SETTING_PREFIX + name: point.settings.get(name) for name in names},
    }


def _coordinates(x: Interval, y: Interval, x_factor: float, y_factor: float) -> Row:
    bounds = {name: x_factor * value for name, value in (("x", x.value), ("x_low", x.low), ("x_high", x.high))}
    return bounds | {name: y_factor * value for name, value in (("y", y.value), ("y_low", y.low), ("y_high", y.high))}


def _reference_row(tradeoff: Tradeoff, axis: Axis, x_factor: float) -> Row | None:
    reference = tradeoff.reference
    cost = reference.cost(axis) if reference else None
    if reference is None or cost is None:
        return None
    return _told(reference, varied(tradeoff)) | {"x": cost.value * x_factor, "label": "reference"}


def _segments(rows: Sequence[Row]) -> list[Row]:
    """Pieces of the front's line; a piece is confirmed when both of its ends are."""
    front = sorted((row for row in rows if row["on_front"]), key=lambda row: (row["x"], -row["y"]))
    return [
        {
            "x": one["x"],
            "y": one["y"],
            "x2": other["x"],
            "y2": other["y"],
            "confirmed": one["confirmed"] and other["confirmed"],
        }
        for one, other in pairwise(front)
    ]


def _range(values: Sequence[float], highs: Iterable[float], scale: ScaleName) -> Range:
    """Range that holds all values, and the intervals as far as they leave the values readable."""
    positive = [value for value in values if value > 0]
    if not positive:
        return Range(0.0, 1.0, log=False)
    top = max(positive)
    bottom = min(positive)
    log = scale == "log" or (scale == "auto" and top / bottom > LOG_FROM_RATIO)
    reach = min(max([top, *highs]), 1.5 * top)
    return Range(0.7 * bottom, 1.3 * reach, log=True) if log else Range(0.0, 1.06 * reach, log=False)


def _colour(tradeoff: Tradeoff, wanted: str | None) -> str | None:
    """The setting that colours the points: the one asked for, else the axis with the most values."""
    if wanted is not None:
        if not any(wanted in point.settings for point in tradeoff.points):
            raise AnalysisError(f"no setting is named {wanted}, colour_by must be one of the settings")
        return wanted
    counts = {name: len(values_of(tradeoff, name)) for name in tradeoff.axes}
    fit = {name: count for name, count in counts.items() if 2 <= count <= MAX_COLOURS}
    return max(fit, key=lambda name: fit[name]) if fit else None


def values_of(tradeoff: Tradeoff, name: str) -> list[Any]:
    """The different values that a setting takes, in rising order where they have one."""
    values = {setting(p.settings[name]): p.settings[name] for p in tradeoff.points if name in p.settings}
    numeric = all(isinstance(v, int | float) and math.isfinite(v) for v in values.values())
    return sorted(values.values()) if numeric else sorted(values.values(), key=str)
