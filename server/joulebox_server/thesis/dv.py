"""Direct visualisation of the photon map: what photons, gather distance and gather count cost and change."""

from typing import Any

from joulebox_server.thesis.batch import THESIS, Batch, Plan, Sweep

SCENES = ("cornell-boxes", "cornell-spheres")
PHOTONS = [50_000, 100_000, 175_000, 200_000]
REFERENCE_PHOTONS = 250_000
DISTANCE_M = 0.02
COUNT = 100


def sweeps(plan: Plan) -> list[Sweep]:
    """One sweep, one setting at a time about the reference, for both scenes."""
    base: dict[str, Any] = {**THESIS, "indirect": "direct_visualization", "caustics": False, "global_photons": REFERENCE_PHOTONS,
            "gather_distance_m": DISTANCE_M, "gather_count": COUNT, "width": 256, "height": 256}  # fmt: skip
    changes: list[dict[str, Any]] = [{}]
    changes += [{"global_photons": count} for count in [*PHOTONS, 500_000]]
    changes += [{"gather_distance_m": factor * DISTANCE_M} for factor in (0.5, 0.75, 1.5, 2.0, 3.0)]
    changes += [{"gather_count": count} for count in (50, 150, 200, 250)]
    preset = base.pop("preset")
    return [
        {
            "name": f"dv-{scene}",
            "scenes": [scene],
            "preset": preset,
            "settings": base,
            "rule": "list",
            "configurations": [{"global_photons": REFERENCE_PHOTONS, **change} for change in changes],
            "reference": {"settings": {"global_photons": REFERENCE_PHOTONS}},
        }
        for scene in SCENES
    ]


BATCH = Batch("dv", "Direct visualisation", __doc__ or "", sweeps, (), ())
