"""Settings that the renderer's tests start from."""

from __future__ import annotations

from typing import Any

# The plain method: each estimate at each point, nothing reused or aimed. Tests name what they use beyond, so that
# they do not depend on the presets.
PLAIN: dict[str, Any] = {
    "threads": 2, "samples_per_pixel": 4, "shadow_rays": 36, "sampler": "stratified", "caustic_photons": 50_000,
    "caustic_hints": False, "gather_count": 100, "caustic_gather_count": 100, "caustic_gather_distance_m": 0.01,
    "final_gather_rays": 64, "irradiance_cache_tolerance": 0.0, "importance_sampling": False,
}  # fmt: skip
