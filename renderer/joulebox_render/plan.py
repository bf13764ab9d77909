"""The plan: which stages and maps a scene needs under given settings, and why the others are left out.

Only what cannot change a pixel is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from joulebox_render.records import GLASS, MIRROR, PHONG, Scene
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

    @property
    def run(self) -> list[str]:
        """Stages that run, in their order."""
        stages = {
            "photon_map": self.global_map or self.caustic_map,
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
    caustics = _caustic_reason(settings, specular)
    if caustics:
        left_out["caustics"] = caustics
    if not photon_method and caustics:
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
    )


def _caustic_reason(settings: Settings, specular: bool) -> str:
    """Why there is no caustic map; empty where there is one."""
    if settings.indirect == "path":
        return "indirect=path finds caustics by its paths"
    if not settings.caustics:
        return "caustics=false"
    if settings.caustic_photons == 0:
        return "caustic_photons=0"
    return "" if specular else "no specular surface"
