"""Final gathering: what tolerance, gather rays, precomputed irradiance and photons cost and change."""

from typing import Any

from joulebox_server.thesis import quantities
from joulebox_server.thesis.batch import Batch, Figure, Rated, Tile
from joulebox_server.thesis.fg_claims import CLAIMS, STEPS
from joulebox_server.thesis.fg_points import FEWER_PHOTONS, REFERENCE_PHOTONS, SCENE, at, line, sized, sweeps
from joulebox_server.thesis.judging import saving, told, told_share
from joulebox_server.thesis.ratings import limit_of
from joulebox_server.thesis.results import Results, at_256, compared

TOLERANCE, RAYS, PHOTONS = "irradiance_cache_tolerance", "final_gather_rays", "global_photons"


def alone(name: str) -> quantities.Lines:
    """The line along one setting."""
    return lambda results: {"": line(results, name)}


def _spacings(results: Results) -> quantities.Series:
    return {
        f"{count:,} photons": [
            ("none" if n == 0 else f"every {n:.0f}", point)
            for n, point in line(results, "photon_spacing", global_photons=count)
        ]
        for count in (REFERENCE_PHOTONS, FEWER_PHOTONS)
    }


def _steps(results: Results) -> quantities.Series:
    settings = {"tolerance": TOLERANCE, "gather rays": RAYS, "photon spacing": "photon_spacing", "photons": PHOTONS}
    return {words: [p for p in line(results, name) if p[1].difference] for words, name in settings.items()}


def _pictures(captions: dict[str, dict[str, Any]]) -> Any:
    def draw(results: Results) -> list[Tile]:
        found = [(words, at(results, **changed).rows[0].image_sha256) for words, changed in captions.items()]
        return [Tile(sha256, words) for words, sha256 in found if sha256]

    return draw


OURS = "The thesis' own drawing of this number is not at hand; this is what ours shows in its place."
FIGURES = (
    Figure("27", "Final gathering with few and with many rays", OURS,
           _pictures({"16 gather rays": {RAYS: 16}, "64 gather rays": {RAYS: 64}, "256 gather rays": {}})),
    Figure("28", "Final gathering at a high and at a low tolerance", OURS,
           _pictures({"tolerance 0.3": {TOLERANCE: 0.3}, "tolerance 0.1": {TOLERANCE: 0.1}, "tolerance 0.02": {}})),
    Figure("31", "Stages over photons, final gathering", "Stages are booked as the thesis does.",
           quantities.stacked(alone(PHOTONS), "global photons")),
    Figure("46", "Cost against difference, final gathering", "One line of settings a colour.",
           quantities.trade_off(_steps, "setting")),
    Figure("47", "Cost over precomputed irradiance", "", quantities.over(quantities.COST, _spacings, "precomputed at",
                                                                          "photons")),
    Figure("48", "Difference over precomputed irradiance", "",
           quantities.over(quantities.DIFFERENCE, _spacings, "precomputed at", "photons")),
    Figure("49", "Cost over tolerance", "", quantities.over(quantities.COST, alone(TOLERANCE), "tolerance")),
    Figure("50", "Difference over tolerance", "",
           quantities.over(quantities.DIFFERENCE, alone(TOLERANCE), "tolerance")),
    Figure("51", "Cost over gather rays", "", quantities.over(quantities.COST, alone(RAYS), "gather rays")),
    Figure("52", "Difference over gather rays", "",
           quantities.over(quantities.DIFFERENCE, alone(RAYS), "gather rays")),
)  # fmt: skip


def advice(results: Results) -> list[str]:
    """What each step away from the reference saves and changes, the best first."""
    reference = sized(results)
    found = []
    for words, changed in STEPS.items():
        point = at(results, **changed)
        saved = saving(point.cost, reference.cost)
        if compared(point).value <= limit_of(point) and saved.low > 0:
            found.append((saved.value, f"Final gathering: {words} saves {told_share(saved)} of the reference's cost, "
                                       f"at a difference of {told(at_256(point))} scaled to 256x256."))  # fmt: skip
    return [sentence for _, sentence in sorted(found, reverse=True)]


BATCH = Batch(
    "fg",
    "Final gathering",
    "From every point that is seen, rays are sent to gather light from the photon map, and an irradiance cache keeps "
    "what they bring for points nearby. Its tolerance, the number of rays, irradiance precomputed at photons and the "
    "photons are varied one at a time about the thesis' reference, in the box with a mirror and a glass sphere.",
    sweeps,
    FIGURES,
    CLAIMS,
    advice,
    (Rated("4", "fg", SCENE, (TOLERANCE, RAYS, "photon_spacing", PHOTONS)),),
)
