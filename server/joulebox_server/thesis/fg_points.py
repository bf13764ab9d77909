"""The batch of final gathering: its sweeps, and lines through their points."""

from typing import Any

from joulebox_server.thesis.batch import THESIS, Plan, Sweep, again
from joulebox_server.thesis.results import Point, Results, along, only

SCENE = "cornell-spheres"
TOLERANCES = (0.05, 0.1, 0.15, 0.2, 0.3)
RAYS = (16, 64, 144)
SPACINGS = (1, 4, 8)
PHOTONS = (50_000, 100_000, 175_000)
FEWER_PHOTONS, REFERENCE_PHOTONS = 100_000, 250_000
CAUSTIC_PHOTONS = 20_000
ELSEWHERE: dict[str, Any] = {
    "irradiance_cache_tolerance": 0.02,
    "final_gather_rays": 256,
    "photon_spacing": 0,
    "global_photons": REFERENCE_PHOTONS,
}
"""The reference, and where a setting stays while another moves."""
BASE: dict[str, Any] = {
    **THESIS,
    "indirect": "final_gather",
    "caustic_photons": CAUSTIC_PHOTONS,
    **ELSEWHERE,
}


def sweeps(plan: Plan) -> list[Sweep]:
    """One setting at a time about the reference, spacing at 100k photons too; a quick run renders some again."""
    # the first is the control of a full run: cheap, and like the others
    changes: list[dict[str, Any]] = [{"irradiance_cache_tolerance": value} for value in reversed(TOLERANCES)]
    changes += [{"final_gather_rays": count} for count in RAYS]
    changes += [{"photon_spacing": n} for n in SPACINGS]
    changes += [{"photon_spacing": n, "global_photons": FEWER_PHOTONS} for n in SPACINGS]
    changes += [{"global_photons": count} for count in PHOTONS]
    side = plan.pick(128, 256)
    sweep = _sweep("fg", side, changes)
    if not plan.quick:
        return [sweep]
    few: list[dict[str, Any]] = [{"irradiance_cache_tolerance": value} for value in (0.1, 0.15, 0.3)]
    few += [{"final_gather_rays": count} for count in RAYS]
    return [sweep, again(sweep, 2, few)]


def _sweep(name: str, side: int, changes: list[dict[str, Any]]) -> Sweep:
    return {
        "name": name,
        "scenes": [SCENE],
        "settings": BASE | {"width": side, "height": side},
        "rule": "list",
        "configurations": changes,
        "reference": {"settings": ELSEWHERE},
    }


def line(results: Results, name: str, **elsewhere: Any) -> list[tuple[float, Point]]:
    """Points that differ from the reference in one setting alone, the reference among them, in order.

    elsewhere   settings that stay at another value than the reference's
    """
    fixed = {key: value for key, value in (ELSEWHERE | elsewhere).items() if key != name}
    return along(results.with_reference("fg", SCENE, **fixed), name)


def at(results: Results, **changed: Any) -> Point:
    """The point with these settings, the others the reference's. Raises MissingError without it."""
    return only(results.with_reference("fg", SCENE, **(ELSEWHERE | changed)))


def sized(results: Results) -> Point:
    """The reference. Raises MissingError without it."""
    return results.reference("fg", SCENE)
