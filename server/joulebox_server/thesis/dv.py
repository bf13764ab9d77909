"""Direct visualisation of the photon map: what photons, gather distance and gather count cost and change."""

import statistics

from joulebox_server.analysis.intervals import exactly
from joulebox_server.analysis.words import figure
from joulebox_server.thesis import figures, quantities
from joulebox_server.thesis.batch import Batch, Figure, Rated, Spec, Tile
from joulebox_server.thesis.dv_claims import CLAIMS
from joulebox_server.thesis.dv_points import BOXES, ELSEWHERE, SCENES, SPHERES, line, sweeps
from joulebox_server.thesis.judging import saving, told, told_share
from joulebox_server.thesis.ratings import limit_of
from joulebox_server.thesis.results import Point, Results, compared


def both(name: str) -> quantities.Lines:
    """Lines of both scenes along a setting."""
    return lambda results: {scene.removeprefix("cornell-"): line(results, scene, name) for scene in SCENES}


def _everything(results: Results) -> quantities.Series:
    return {
        scene.removeprefix("cornell-"): [(_label(point), point) for point in results.points(f"dv-{scene}")]
        for scene in SCENES
    }


def _label(point: Point) -> str:
    photons, distance_m, count = (point.settings[name] for name in ELSEWHERE)
    return f"{photons:,} photons, {distance_m:g} m, count {count}"


def _scene_picture(number: str, scene: str) -> Figure:
    def draw(results: Results) -> list[Tile]:
        sha256 = results.reference(f"dv-{scene}", scene).rows[0].image_sha256
        return [Tile(sha256, f"{scene}: 250k photons within 0.02 m, at most 100")] if sha256 else []

    return Figure(number, f"The scene {scene}", "Rendered with the reference of direct visualisation.", draw)


def _discharge(results: Results) -> Spec | None:
    found = results.discharge
    if found is None:
        return None
    watts = [power_w for _, power_w in found.samples]
    later = watts[2:] or watts
    mean, sigma = statistics.fmean(later), statistics.pstdev(later)
    rows = [figures.value(time_s, exactly(power_w)) for time_s, power_w in found.samples]
    levels = {"mean": mean, "mean + sigma": mean + sigma, "mean - sigma": mean - sigma}
    what = "" if found.quality == "measured" else ", replayed from a scripted trace"
    return figures.lines(rows, "time [s]", f"power [W]{what}", levels=levels, from_zero=False)


def _over_time(results: Results) -> Spec | None:
    rows = [
        {"x": r.image.time_s, "x_low": r.image.time_s, "x_high": r.image.time_s, "label": r.scene,
         **figures.value(r.image.time_s, exactly(r.image.on(results.basis)), str(r.settings["indirect"]))}
        for r in results.rows if r.purpose == "measure"
    ]  # fmt: skip
    return figures.points(
        rows, "time of an image [s]", f"cost of an image [{results.unit}]", "indirect light", log=True
    )


def _delta(results: Results) -> list[Tile]:
    few = results.point(f"dv-{BOXES}", BOXES, **(ELSEWHERE | {"global_photons": 50_000})).rows[0]
    found = [(few.reference_sha256, "the reference: 250k photons"), (few.image_sha256, "50k photons"),
             (few.delta_sha256, "their difference (white: 10 JND)")]  # fmt: skip
    return [Tile(sha256, caption) for sha256, caption in found if sha256]


PHOTON_AXIS, DISTANCE_AXIS, COUNT_AXIS = "global photons", "gather distance [m]", "gather count"
PHOTON_LINES, DISTANCE_LINES, COUNT_LINES = (both(name) for name in ELSEWHERE)
OURS = "The thesis' own drawing of this number is not at hand; this is what ours shows in its place."

FIGURES = (
    _scene_picture("18", BOXES),
    _scene_picture("19", SPHERES),
    Figure("22", "Discharge over time", "Mean and one sigma are those of the samples after the first two.", _discharge),
    Figure("26", "Two pictures and their difference", OURS, _delta),
    Figure("29", "Cost against time", "Every configuration that this run measured. On a time basis, a tautology.",
           _over_time),
    Figure("30", "Stages over photons, direct visualisation", "Stages are booked as the thesis does.",
           quantities.stacked(PHOTON_LINES, "scene, global photons")),
    Figure("32", "Map creation over photons", "", quantities.over(quantities.stage("photon_map"), PHOTON_LINES,
                                                                    PHOTON_AXIS, "scene")),
    Figure("35", "Direct lighting over photons", "What is seen through mirror or glass is booked here.",
           quantities.over(quantities.stage("direct"), PHOTON_LINES, PHOTON_AXIS, "scene")),
    Figure("38", "Cost against difference, direct visualisation", "Every point of both scenes.",
           quantities.trade_off(_everything, "scene")),
    Figure("39", "Cost over photons", "", quantities.over(quantities.COST, PHOTON_LINES, PHOTON_AXIS, "scene")),
    Figure("40", "Difference over photons", "",
           quantities.over(quantities.LIMITED, PHOTON_LINES, PHOTON_AXIS, "scene")),
    Figure("41", "Cost over gather distance", "", quantities.over(quantities.COST, DISTANCE_LINES, DISTANCE_AXIS,
                                                                    "scene")),
    Figure("42", "Difference over gather distance", "",
           quantities.over(quantities.LIMITED, DISTANCE_LINES, DISTANCE_AXIS, "scene")),
    Figure("43", "Cost over gather count", "", quantities.over(quantities.COST, COUNT_LINES, COUNT_AXIS, "scene")),
    Figure("44", "Difference over gather count", "",
           quantities.over(quantities.LIMITED, COUNT_LINES, COUNT_AXIS, "scene")),
)  # fmt: skip


def advice(results: Results) -> list[str]:
    """What direct visualisation's settings are worth, from this run: a value is advised that surely saves."""
    reference = results.reference(f"dv-{BOXES}", BOXES)
    found = []
    floor, limit = results.floor(f"dv-{BOXES}", BOXES), limit_of(reference)
    if floor is not None and floor > limit:
        found.append(
            f"Direct visualisation shows the noise of its photons: another seed of its reference already differs by "
            f"{figure(floor)}, where {figure(limit)} is acceptable. Prefer final gathering."
        )
    for name, what in (("global_photons", "photons"), ("gather_distance_m", "gather distance"),
                       ("gather_count", "gather count")):  # fmt: skip
        points = [(x, p) for x, p in line(results, BOXES, name) if p.difference and p.difference.value <= limit]
        cheaper = [(p.cost.value, x, p) for x, p in points if saving(p.cost, reference.cost).low > 0]
        if cheaper:
            _, x, best = min(cheaper, key=lambda one: one[0])
            found.append(
                f"Direct visualisation, {what}: {x:,g} saves {told_share(saving(best.cost, reference.cost))} of the "
                f"reference's cost, at a difference of {told(compared(best))}."
            )
        elif points:
            found.append(
                f"Direct visualisation, {what}: leave it at {ELSEWHERE[name]:,g}. No other value that was tried surely "
                "costs less and keeps the difference acceptable."
            )
    return found


BATCH = Batch(
    "dv",
    "Direct visualisation",
    "The photon map is shown as it is: every pixel estimates its light from the photons around it. Photons, gather "
    "distance and gather count are varied one at a time about the thesis' reference (250k photons, 0.02 m, 100), "
    "in a box with two boxes and in one with a mirror and a glass sphere.",
    sweeps,
    FIGURES,
    CLAIMS,
    advice,
    (Rated("3", f"dv-{BOXES}", BOXES, ("global_photons", "gather_distance_m", "gather_count")),),
)
