"""The thesis' tables 3 and 4: what each of seven settings costs and does to the picture, by `analysis.ratings`."""

from collections.abc import Sequence

from joulebox_server.analysis.difference import acceptable_limit
from joulebox_server.analysis.documents import Rating, Tradeoff
from joulebox_server.analysis.intervals import exactly
from joulebox_server.analysis.points import Observation, Subject
from joulebox_server.analysis.tradeoff import build_tradeoff
from joulebox_server.thesis.results import Point, Results


def ratings(results: Results, sweep: str, scene: str, settings: Sequence[str]) -> dict[str, Rating]:
    """Ratings of these settings from the points of one sweep's scene, by setting; without those that did not vary.

    A setting's line is the points that differ from the reference in it alone. The cost is joules, or CPU seconds.
    """
    reference = results.points(sweep, scene, "reference")
    found: dict[str, Rating] = {}
    for name in settings:
        line = _line(results.points(sweep, scene), reference[0] if reference else None, name)
        if len(line) > 1:
            found |= {rated.setting: rated for rated in tradeoff_of(line, reference, (name,)).ratings}
    return found


def _line(points: Sequence[Point], reference: Point | None, name: str) -> list[Point]:
    """Points that differ from the reference in one setting, and the point that is like it."""
    if reference is None:
        return []
    same = ("seed", name)
    base = {key: value for key, value in reference.settings.items() if key not in same}
    return [p for p in points if {key: value for key, value in p.settings.items() if key not in same} == base]


def tradeoff_of(points: Sequence[Point], reference: Sequence[Point], axes: Sequence[str] = ()) -> Tradeoff:
    """Points of one size as the analysis takes them; its time is our cost: it judges what the study rests on."""
    width, height = (int(points[0].settings[side]) for side in ("width", "height"))
    subject = Subject(
        sweep_id="", scene=points[0].scene, device="", width=width, height=height, axes=axes, seed_policy="same"
    )
    return build_tradeoff(subject, _observations(points), _observations(reference))


def _observations(points: Sequence[Point]) -> list[Observation]:
    """Every row of the points."""
    return [
        Observation(
            configuration_id=str(number),
            settings=row.settings,
            repeat=row.seed,  # what renders a sweep again counts its repeats from 0 too
            seed=row.seed,
            time_s=exactly(row.image.on(point.basis)),
            cpu_s=exactly(row.image.cpu_s),
            energy_j=None,
            quality="none",
            windows=1,
            difference=row.difference,
            pixel_sha256=row.pixel_sha256,
        )
        for number, point in enumerate(points)
        for row in point.rows
    ]


def limit_of(point: Point) -> float:
    """The acceptable difference at a point's size."""
    return acceptable_limit(int(point.settings["width"]), int(point.settings["height"]))
