"""Polygons: a bunny of four details and three sizes, by direct visualisation and by final gathering."""

from typing import Any

from joulebox_server.analysis.intervals import Interval
from joulebox_server.thesis import quantities
from joulebox_server.thesis.batch import THESIS, Batch, Figure, Finding, Plan, Sweep, Tile
from joulebox_server.thesis.claims import claims_of
from joulebox_server.thesis.judging import between, every, finding, largest, ratio, smallest, told, total
from joulebox_server.thesis.results import Point, Results, only

BOXES, BUNNY = "cornell-boxes", "cornell-bunny"
DETAILS = (948, 3850, 16300, 69666)
SIZES = ("small", "medium", "large")
BASE: dict[str, Any] = {**THESIS, "indirect": "direct_visualization", "global_photons": 250_000, "caustics": False}
GATHERED: dict[str, Any] = {
    "indirect": "final_gather",
    "global_photons": 100_000,
    "photon_spacing": 4,
    "irradiance_cache_tolerance": 0.1,
}


def sweeps(plan: Plan) -> list[Sweep]:
    """Final gathering of every bunny; direct visualisation is the reference with every seed, and its other seed."""
    side = plan.pick(128, 256)
    scenes: list[Any] = [BOXES]
    scenes += [
        {"name": BUNNY, "defines": {"detail": str(detail), "size": size}} for size in SIZES for detail in DETAILS
    ]
    return [
        {
            "name": "polygons",
            "scenes": scenes,
            "settings": BASE | {"width": side, "height": side},
            "rule": "list",
            "configurations": [GATHERED],
            "controls": 0,
            **({"repeats": 4} if plan.quick else {}),
            "reference": {"settings": {"indirect": "direct_visualization"}},
        }
    ]


def shown(results: Results, scene: str) -> Point:
    """Direct visualisation of a scene, over all seeds. Raises MissingError without it."""
    return only(results.points("polygons", scene, ("reference", "noise_floor")))


def gathered(results: Results, scene: str) -> Point:
    """Final gathering of a scene. Raises MissingError without it."""
    return only(results.points("polygons", scene))


def bunny(detail: int, size: str) -> str:
    """The label of a bunny's scene."""
    return f"{BUNNY} detail={detail} size={size}"


def _costs(results: Results, size: str, stage: str) -> list[Interval]:
    return [shown(results, bunny(detail, size)).stage(stage) for detail in DETAILS]


def _rising(results: Results, stage: str, above: tuple[str, ...]) -> Finding:
    """Whether the finest mesh costs more than the coarsest at each size, and medium more than the sizes `above`."""
    costs = {size: _costs(results, size, stage) for size in SIZES}
    steps = [ratio(costs[size][-1], costs[size][0]) for size in SIZES]
    tops = [ratio(total(costs["medium"]), total(costs[size])) for size in above]
    verdict = every([*(between(step, low=1.0) for step in steps), *(between(top, low=1.0) for top in tops)])
    words = ", ".join(f"{told(top)} of {size}" for size, top in zip(above, tops, strict=True))
    least = smallest(steps)
    return finding(least, verdict, f"the medium bunny costs {words}; the least of the finest mesh over the coarsest")


def _map_creation(results: Results) -> Finding:
    return _rising(results, "photon_map", ("small", "large"))


def _direct(results: Results) -> Finding:
    return _rising(results, "direct", ("large",))


def _indirect(results: Results) -> Finding:
    boxes = shown(results, BOXES).stage("indirect")
    means = {size: total(_costs(results, size, "indirect")).scaled(1 / len(DETAILS)) for size in SIZES}
    dearest = largest([ratio(mean, boxes) for mean in means.values()])
    grows = ratio(means["large"], means["small"])
    verdict = every([between(dearest, high=1.05), between(grows, high=1.05)])
    return finding(dearest, verdict, f"large over small {told(grows)}; the dearest size over boxes")


def _final_gathering(results: Results) -> Finding:
    worst = []
    for size in SIZES:
        costs = [gathered(results, bunny(detail, size)).cost for detail in DETAILS]
        worst.append(ratio(largest(costs), smallest(costs)))
    most = largest(worst)
    return finding(
        most, every([between(one, high=1.15) for one in worst]), "the dearest mesh over the cheapest, at most"
    )


CLAIMS = claims_of(
    "polygons", {"fig34": _map_creation, "fig36": _direct, "fig45": _indirect, "fig53": _final_gathering}
)


def _bunnies(of: Any) -> quantities.Lines:
    return lambda results: {size: [(detail, of(results, bunny(detail, size))) for detail in DETAILS] for size in SIZES}


def _with_boxes(results: Results) -> quantities.Series:
    boxes = shown(results, BOXES)
    return {"boxes": [(detail, boxes) for detail in DETAILS]} | dict(_bunnies(shown)(results))


def _pictures(scenes: list[str]) -> Any:
    def draw(results: Results) -> list[Tile]:
        found = [(scene.removeprefix(BUNNY).strip(), gathered(results, scene).rows[0].image_sha256) for scene in scenes]
        return [Tile(sha256, words or scenes[0]) for words, sha256 in found if sha256]

    return draw


OURS = "The thesis' own drawing of this number is not at hand; this is what ours shows in its place."
AXIS, LEGEND = "triangles of the bunny", "size"
FIGURES = (
    Figure("21", "The scene cornell-bunny", OURS, _pictures([bunny(69666, "medium")])),
    Figure("23", "The bunny in four details", OURS, _pictures([bunny(detail, "medium") for detail in DETAILS])),
    Figure("24", "The bunny in three sizes", OURS, _pictures([bunny(16300, size) for size in SIZES])),
    Figure("34", "Map creation over polygons", "Direct visualisation.",
           quantities.over(quantities.stage("photon_map"), _bunnies(shown), AXIS, LEGEND, log_x=True)),
    Figure("36", "Direct lighting over polygons", "Direct visualisation.",
           quantities.over(quantities.stage("direct"), _bunnies(shown), AXIS, LEGEND, log_x=True)),
    Figure("45", "Indirect light over polygons", "Direct visualisation; boxes have no bunny, so their line is level.",
           quantities.over(quantities.stage("indirect"), _with_boxes, AXIS, LEGEND, log_x=True)),
    Figure("53", "Final gathering over polygons", "",
           quantities.over(quantities.COST, _bunnies(gathered), AXIS, LEGEND, log_x=True)),
)  # fmt: skip


def advice(results: Results) -> list[str]:
    """What detail costs."""
    fine, coarse = (gathered(results, bunny(detail, "medium")).cost for detail in (DETAILS[-1], DETAILS[0]))
    return [
        "Polygons: do not spare them to save energy. By final gathering, an image with a bunny of 69,666 triangles "
        f"costs {told(ratio(fine, coarse))} times one with 948."
    ]


BATCH = Batch(
    "polygons",
    "Polygons",
    "A bunny stands in the box, of 948 to 69,666 triangles and 0.15 to 0.5 of the box's height. What does geometric "
    "detail cost, stage by stage?",
    sweeps,
    FIGURES,
    CLAIMS,
    advice,
)
