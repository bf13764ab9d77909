"""What the sweeps of a run brought, for figures and claims: points are the repeats of a configuration together."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from joulebox_server.analysis.intervals import Interval
from joulebox_server.thesis.discharge import Discharge
from joulebox_server.thesis.rows import CostBasis, Purpose, Row, base_sweep, configuration_key
from joulebox_server.thesis.scatter import COST, DIFFERENCE, TIME, Quantity, Scatters, paired, value_of

NOMINAL_PIXELS = 256 * 256
"""Of the pictures that the acceptable difference of 100 is stated for."""


@dataclass(frozen=True)
class Point:
    """The repeats of one configuration of one scene in one sweep."""

    rows: tuple[Row, ...]
    basis: CostBasis
    scatters: Scatters

    @property
    def settings(self) -> Mapping[str, Any]:
        """Of the first repeat."""
        return self.rows[0].settings

    @property
    def scene(self) -> str:
        """The scene's label."""
        return self.rows[0].scene

    @property
    def pixels(self) -> int:
        """Pixels of the picture."""
        return self.rows[0].pixels

    @property
    def cost(self) -> Interval:
        """Of an image: joules, or CPU seconds on a time basis."""
        return self.scatters.interval(self.rows, COST)

    @property
    def time(self) -> Interval:
        """Seconds from an image's first photon to its last pixel."""
        return self.scatters.interval(self.rows, TIME)

    def stage(self, *names: str) -> Interval:
        """Cost of one stage, or of several together; 0 where none of them ran."""
        return self.scatters.interval(self.rows, ("stage", *names))

    @property
    def difference(self) -> Interval | None:
        """To the reference; None for a reference, and where it was not compared."""
        known = any(row.difference is not None for row in self.rows)
        return self.scatters.interval(self.rows, DIFFERENCE) if known else None

    @property
    def per_pixel(self) -> Interval | None:
        """The difference a pixel."""
        return self.difference.scaled(1 / self.pixels) if self.difference else None

    def over(self, other: "Point", quantity: Quantity) -> Interval | None:
        """A quantity over that of another point, seed by seed; None where they share fewer than three seeds."""
        return paired(self._by_seed(quantity), other._by_seed(quantity))

    def _by_seed(self, quantity: Quantity) -> dict[int, float]:
        found = ((row.seed, value_of(row, quantity, self.basis)) for row in self.rows)
        return {seed: value for seed, value in found if value is not None}


@dataclass(frozen=True)
class Results:
    """All rows of a run, and what its costs rest on."""

    rows: tuple[Row, ...]
    basis: CostBasis
    quick: bool
    discharge: Discharge | None = None

    @property
    def unit(self) -> str:
        """Of costs."""
        return "CPU s" if self.basis == "time" else "J"

    def points(
        self,
        sweep: str,
        scene: str | None = None,
        purpose: Purpose | tuple[Purpose, ...] = "measure",
        **settings: Any,
    ) -> list[Point]:
        """Points of a sweep, and of what rendered it again, whose settings are these; a tuple takes any of its values.

        scene      a label, or the beginning of one
        """
        purposes = (purpose,) if isinstance(purpose, str) else purpose
        groups: dict[tuple[str, str], list[Row]] = {}
        for row in self.rows:
            if base_sweep(row.sweep) == sweep and row.purpose in purposes and _fits(row, scene, settings):
                groups.setdefault((row.scene, configuration_key(row.settings)), []).append(row)
        scatters = self.scatters
        # the first seed leads: figures show its picture
        ordered = [sorted(group, key=lambda row: row.seed) for group in groups.values()]
        return [Point(tuple(group), self.basis, scatters) for group in ordered]

    def point(self, sweep: str, scene: str | None = None, purpose: Purpose = "measure", **settings: Any) -> Point:
        """The one point that fits. Raises MissingError for none or several."""
        found = self.points(sweep, scene, purpose, **settings)
        if len(found) != 1:
            what = ", ".join(f"{name} {value}" for name, value in settings.items()) or "any settings"
            raise MissingError(f"{len(found)} points of {sweep} {scene or ''} have {what}, one is needed")
        return found[0]

    def reference(self, sweep: str, scene: str | None = None) -> Point:
        """The reference of a sweep's scene."""
        return self.point(sweep, scene, "reference")

    def with_reference(self, sweep: str, scene: str | None = None, **settings: Any) -> list[Point]:
        """`points`, and the reference where it fits: in a line through the settings it is the end that differs by 0."""
        return [*self.points(sweep, scene, **settings), *self.points(sweep, scene, "reference", **settings)]

    def floor(self, sweep: str, scene: str | None = None) -> float | None:
        """Difference of the reference to itself at another seed; None where it is not known."""
        found = self.points(sweep, scene, "noise_floor")
        return found[0].difference.value if found and found[0].difference else None

    @cached_property
    def scatters(self) -> Scatters:
        """How far renders of this run scatter, from all that it rendered more than once."""
        return Scatters(self.rows, self.basis)


def compared(point: Point) -> Interval:
    """Its difference. Raises MissingError where its picture was not compared."""
    if point.difference is None:
        raise MissingError(f"a picture of {point.scene} was not compared")
    return point.difference


def at_256(point: Point) -> Interval:
    """Its difference scaled to 256x256 pixels. Raises MissingError where its picture was not compared."""
    return compared(point).scaled(NOMINAL_PIXELS / point.pixels)


def only(points: Sequence[Point]) -> Point:
    """The one point. Raises MissingError for none or several."""
    if len(points) != 1:
        raise MissingError(f"{len(points)} points fit where one is needed")
    return points[0]


class MissingError(Exception):
    """The results lack a point that a figure or a claim needs: it cannot be judged."""


def along(points: Iterable[Point], name: str) -> list[tuple[float, Point]]:
    """The points in order of a setting, with its value."""
    return sorted(((float(p.settings[name]), p) for p in points), key=lambda pair: pair[0])


def _fits(row: Row, scene: str | None, settings: Mapping[str, Any]) -> bool:
    if scene is not None and not (row.scene + " ").startswith(scene + " "):
        return False
    return all(_equal(row.settings.get(name), value) for name, value in settings.items())


def _equal(given: Any, wanted: Any) -> bool:
    if isinstance(wanted, tuple):
        return any(_equal(given, one) for one in wanted)
    if isinstance(given, float) and isinstance(wanted, int | float):
        return math.isclose(given, wanted, rel_tol=1e-9)
    return bool(given == wanted)


def grouped(points: Sequence[Point], name: str) -> Iterator[tuple[Any, list[Point]]]:
    """Points by the value of a setting, in order of the values."""
    for value in sorted({p.settings[name] for p in points}):
        yield value, [p for p in points if p.settings[name] == value]
