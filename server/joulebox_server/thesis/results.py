"""What the sweeps of a run brought, for figures and claims: points are the repeats of a configuration together."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from joulebox_server.analysis.intervals import Interval
from joulebox_server.thesis.discharge import Discharge
from joulebox_server.thesis.rows import CostBasis, Purpose, Row, configuration_key
from joulebox_server.thesis.scatter import Scatters, interval_of

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
        return interval_of([row.image.on(self.basis) for row in self.rows], self.scatters.cost)

    def stage(self, *names: str) -> Interval:
        """Cost of one stage, or of several together; 0 where none of them ran."""
        values = [sum(row.stages[n].on(self.basis) for n in names if n in row.stages) for row in self.rows]
        return interval_of(values, self.scatters.stage)

    @property
    def difference(self) -> Interval | None:
        """To the reference; None for a reference, and where it was not compared."""
        known = [row.difference for row in self.rows if row.difference is not None]
        return interval_of(known, self.scatters.difference) if known else None

    @property
    def per_pixel(self) -> Interval | None:
        """The difference a pixel."""
        return self.difference.scaled(1 / self.pixels) if self.difference else None


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
        """Points of a sweep whose settings are these; a tuple of values takes any of them.

        scene      a label, or the beginning of one
        """
        purposes = (purpose,) if isinstance(purpose, str) else purpose
        groups: dict[tuple[str, str], list[Row]] = {}
        for row in self.rows:
            if row.sweep == sweep and row.purpose in purposes and _fits(row, scene, settings):
                groups.setdefault((row.scene, configuration_key(row.settings)), []).append(row)
        scatters = self.scatters
        return [Point(tuple(group), self.basis, scatters) for group in groups.values()]

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
        return found[0].rows[0].difference if found else None

    @cached_property
    def scatters(self) -> Scatters:
        """How far single renders of this run scatter, from its control runs and its seeds."""
        return Scatters.learnt(self.rows, self.basis)


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
