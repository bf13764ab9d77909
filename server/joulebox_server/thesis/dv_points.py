"""The batch of direct visualisation: its sweeps, and lines through their points."""

from collections.abc import Sequence
from typing import Any

from joulebox_server.thesis.batch import THESIS, Plan, Sweep, again
from joulebox_server.thesis.results import Point, Results, along

SCENES = ("cornell-boxes", "cornell-spheres")
BOXES, SPHERES = SCENES
PHOTONS = (50_000, 100_000, 175_000, 200_000)
REFERENCE_PHOTONS, MOST_PHOTONS = 250_000, 500_000
DISTANCES = (0.5, 0.75, 1.5, 2.0, 3.0)
DISTANCE_M = 0.02
COUNTS = (50, 150, 200, 250)
COUNT = 100
ELSEWHERE: dict[str, Any] = {
    "global_photons": REFERENCE_PHOTONS,
    "gather_distance_m": DISTANCE_M,
    "gather_count": COUNT,
}
"""Where a setting stays while another moves."""
BASE: dict[str, Any] = {
    **THESIS,
    "indirect": "direct_visualization",
    "caustics": False,
    **ELSEWHERE,
}
"""The thesis' reference of direct visualisation; without a caustic map the global map shows caustics."""


def sweeps(plan: Plan) -> list[Sweep]:
    """One setting at a time about the reference, for both scenes; a quick run renders what is compared again."""
    changes: list[dict[str, Any]] = [{"global_photons": count} for count in (REFERENCE_PHOTONS, *PHOTONS, MOST_PHOTONS)]
    changes += [{"gather_distance_m": factor * DISTANCE_M} for factor in DISTANCES]
    changes += [{"gather_count": count} for count in COUNTS]
    size = {"width": 256, "height": 256}
    boxes, spheres = (_sweep(f"dv-{scene}", scene, BASE | size, changes) for scene in SCENES)
    if not plan.quick:
        return [boxes, spheres]
    # ratings look at every step of the boxes, claims at these of the spheres
    photons: list[dict[str, Any]] = [{"global_photons": n} for n in (50_000, 100_000, REFERENCE_PHOTONS, MOST_PHOTONS)]
    ends = [{"gather_distance_m": factor * DISTANCE_M} for factor in (DISTANCES[0], DISTANCES[-1])]
    return [boxes, spheres, again(boxes, 5), again(spheres, 5, [*photons, *ends])]


def _sweep(name: str, scene: str, settings: dict[str, Any], changes: Sequence[dict[str, Any]]) -> Sweep:
    return {
        "name": name,
        "scenes": [scene],
        "settings": settings,
        "rule": "list",
        "configurations": list(changes),
        "reference": {"settings": {"global_photons": REFERENCE_PHOTONS}},
    }


def line(results: Results, scene: str, name: str) -> list[tuple[float, Point]]:
    """Points that differ from the reference in one setting alone, with the reference's twin, in order."""
    fixed = {key: value for key, value in ELSEWHERE.items() if key != name}
    return along(results.points(f"dv-{scene}", scene, **fixed), name)
