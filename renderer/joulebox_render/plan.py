"""The plan: which stages and maps a scene needs under given settings, and why the others are left out.

Only what cannot change a pixel is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from joulebox_render.records import ENVIRONMENT, GLASS, MIRROR, PHONG, POINT_LIGHT, SPOT_LIGHT, Scene
from joulebox_render.settings import Settings


@dataclass(frozen=True)
class Plan:
    """What runs. `left_out` maps each stage or map that does not run to the reason."""

    global_map: bool
    precomputed_irradiance: bool
    caustic_map: bool
    specular_recursion: bool
    glossy: bool
    irradiance_cache: bool
    importance_sampling: bool
    left_out: dict[str, str] = field(default_factory=dict)
    indirect: bool = True
    shadow_photons: bool = False

    @property
    def run(self) -> list[str]:
        """Stages that run, in their order."""
        stages = {
            "photon_map": self.global_map or self.caustic_map or self.shadow_photons,
            "precomputed_irradiance": self.precomputed_irradiance,
            "direct": True,
            "indirect": self.indirect,
            "caustics": self.caustic_map,
        }
        return [name for name, runs in stages.items() if runs]


def make_plan(scene: Scene, settings: Settings, force_all: bool = False) -> Plan:
    """Derive the plan; `force_all` runs what the settings ask for even where the scene cannot show it."""
    used = set(scene.materials.kind[scene.material].tolist())
    specular = force_all or bool(used & {MIRROR, GLASS, PHONG})
    left_out: dict[str, str] = {}

    photon_method = settings.indirect in ("direct_visualization", "final_gather")
    if not photon_method:
        left_out["global_map"] = f"indirect={settings.indirect} asks for no photons"
    precompute = settings.indirect == "final_gather" and settings.photon_spacing > 0
    if not precompute:
        left_out["precomputed_irradiance"] = (
            "photon_spacing=0 gathers photons at every look-up"
            if settings.indirect == "final_gather"
            else "nothing looks it up without final gathering"
        )
    cached = settings.indirect == "final_gather" and settings.irradiance_cache_tolerance > 0
    if not cached:
        left_out["irradiance_cache"] = (
            "irradiance_cache_tolerance=0 gathers at every point"
            if settings.indirect == "final_gather"
            else "nothing uses it without final gathering"
        )
    if settings.indirect == "final_gather" and not settings.importance_sampling:
        left_out["importance_sampling"] = "importance_sampling=false"
    caustics = _caustic_reason(scene, settings, specular)
    if caustics:
        left_out["caustics"] = caustics
    no_test = _shadow_reason(scene, settings, force_all)
    if no_test:
        left_out["shadow_photons"] = no_test
    if not photon_method and caustics and no_test:
        left_out["photon_map"] = "no stage asks for photons"
    if not specular:
        left_out["specular_recursion"] = "no specular surface"
    if settings.indirect == "none":
        left_out["indirect"] = "indirect=none"
    return Plan(
        global_map=photon_method,
        precomputed_irradiance=precompute,
        caustic_map=not caustics,
        specular_recursion=specular,
        glossy=force_all or PHONG in used,
        irradiance_cache=cached,
        importance_sampling=settings.importance_sampling and settings.indirect == "final_gather",
        left_out=left_out,
        indirect=settings.indirect != "none",
        shadow_photons=not no_test,
    )


def _caustic_reason(scene: Scene, settings: Settings, specular: bool) -> str:
    """Why there is no caustic map; empty where there is one."""
    if settings.indirect == "path":
        found = "indirect=path finds caustics by its paths"
        # A path meets no point, and a light behind a mirror or glass cannot be sampled.
        missed = specular and bool(np.isin(scene.lights.kind, (POINT_LIGHT, SPOT_LIGHT)).any())
        return found + ", but none of point and spot lights" * missed
    if not settings.caustics:
        return "caustics=false"
    if settings.caustic_photons == 0:
        return "caustic_photons=0"
    return "" if specular else "no specular surface"


def _shadow_reason(scene: Scene, settings: Settings, force_all: bool) -> str:
    """Why there are no direct and shadow photons; empty where there are."""
    if not settings.use_shadow_photons:
        return "use_shadow_photons=false"
    if settings.direct_photons == 0:
        return "direct_photons=0"
    if force_all or not np.isin(scene.lights.kind, (POINT_LIGHT, SPOT_LIGHT, ENVIRONMENT)).all():
        return ""
    return "no area light: a point light takes one ray, and the sky is in part hidden almost everywhere"
