"""The plan leaves out what cannot change a pixel, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.plan import Plan, make_plan
from joulebox_render.scene import load_scene
from joulebox_render.settings import make_settings

SMALL: dict[str, Any] = {
    "width": 12, "height": 12, "samples_per_pixel": 2, "shadow_rays": 4, "final_gather_rays": 8,
    "global_photons": 2000, "caustic_photons": 300, "gather_count": 20,
}  # fmt: skip
INDIRECT = ("none", "direct_visualization", "final_gather", "path")
STAGES = {"photon_map", "precomputed_irradiance", "direct", "indirect", "caustics"}


def plan_of(scene: str, **settings: Any) -> Plan:
    return make_plan(load_scene(scene), make_settings(settings))


@pytest.mark.parametrize("indirect", INDIRECT)
@pytest.mark.parametrize("scene", ["cornell-boxes", "point-light", "furnace", "cornell-spheres", "phong-spheres"])
@pytest.mark.parametrize(
    "settings",
    [{}, {"sampler": "sobol", "caustic_hints": True}, {"irradiance_cache_tolerance": 0.3}],
    ids=lambda settings: " ".join(settings) or "plain",
)
def test_what_is_left_out_does_not_change_a_pixel(
    open_session: Callable[..., Any], scene: str, indirect: str, settings: dict[str, Any]
) -> None:
    """Against everything that the settings ask for forced on: identical pixels."""
    planned = open_session(scene, **SMALL, indirect=indirect, **settings)
    forced = open_session(scene, force_all=True, **SMALL, indirect=indirect, **settings)
    np.testing.assert_array_equal(planned.render().pixels, forced.render().pixels)
    if not scene.endswith("spheres"):
        assert forced.plan.specular_recursion
        assert not planned.plan.specular_recursion
        assert forced.plan.caustic_map == (indirect != "path")


CHOICES: dict[str, tuple[Any, ...]] = {
    "indirect": INDIRECT, "caustics": (True, False), "caustic_photons": (0, 100, 300), "caustic_hints": (True, False),
    "photon_spacing": (0, 1, 4), "irradiance_cache_tolerance": (0.0, 0.3, 1.0), "irradiance_gradients": (True, False),
    "importance_sampling": (True, False), "use_shadow_photons": (True, False), "direct_photons": (0, 50),
    "store_at_every_bounce": (True, False), "max_photon_bounces": (0, 1, 9), "max_depth": (0, 1, 12),
    "sampler": ("independent", "stratified", "sobol"), "gather_filter": ("constant", "cone", "epanechnikov"),
    "jitter": (True, False), "seed": tuple(range(100)),
}  # fmt: skip


@pytest.mark.parametrize("trial", range(40))
def test_whatever_is_asked_for(open_session: Callable[..., Any], trial: int) -> None:
    """As above, of settings drawn at random in a scene drawn at random: 40 of some four million combinations."""
    random = np.random.default_rng(trial)
    scene = str(random.choice(["cornell-boxes", "point-light", "furnace", "many-lights", "corner-light", "thin-wall"]))
    drawn = {name: values[random.integers(len(values))] for name, values in CHOICES.items()}
    settings = {**SMALL, "width": 8, "height": 8, **drawn}
    planned, forced = (open_session(scene, force_all=force, **settings) for force in (False, True))
    np.testing.assert_array_equal(planned.render().pixels, forced.render().pixels, err_msg=str(drawn))
    assert set(planned.plan.run) <= set(forced.plan.run)


def test_a_diffuse_scene_needs_no_caustics_and_no_specular_recursion() -> None:
    plan = plan_of("cornell-boxes")
    assert plan.run == ["photon_map", "precomputed_irradiance", "direct", "indirect"]
    assert plan.left_out == {
        "caustics": "no specular surface",
        "specular_recursion": "no specular surface",
        "importance_sampling": "importance_sampling=false",
        "shadow_photons": "use_shadow_photons=false",
    }


def test_a_scene_with_mirror_and_glass_needs_everything() -> None:
    plan = plan_of("cornell-spheres", importance_sampling=True, use_shadow_photons=True)
    assert plan.run == ["photon_map", "precomputed_irradiance", "direct", "indirect", "caustics"]
    assert plan.left_out == {}


@pytest.mark.parametrize(
    ("settings", "part", "reason"),
    [
        ({"indirect": "path"}, "photon_map", "no stage asks for photons"),
        ({"indirect": "path"}, "caustics", "indirect=path finds caustics by its paths"),
        ({"indirect": "path"}, "global_map", "indirect=path asks for no photons"),
        ({"indirect": "none"}, "indirect", "indirect=none"),
        ({"indirect": "none"}, "global_map", "indirect=none asks for no photons"),
        ({"indirect": "none", "caustics": False}, "photon_map", "no stage asks for photons"),
        ({"caustics": False}, "caustics", "caustics=false"),
        ({"caustic_photons": 0}, "caustics", "caustic_photons=0"),
        ({"irradiance_cache_tolerance": 0}, "irradiance_cache", "irradiance_cache_tolerance=0 gathers at every point"),
        (
            {"irradiance_cache_tolerance": 0.2, "indirect": "path"},
            "irradiance_cache",
            "nothing uses it without final gathering",
        ),
        ({"photon_spacing": 0}, "precomputed_irradiance", "photon_spacing=0 gathers photons at every look-up"),
        (
            {"indirect": "direct_visualization"},
            "precomputed_irradiance",
            "nothing looks it up without final gathering",
        ),
    ],
)
def test_settings_leave_out_what_they_do_not_ask_for(settings: dict[str, Any], part: str, reason: str) -> None:
    plan = plan_of("cornell-spheres", **settings)
    assert plan.left_out[part] == reason
    assert part not in plan.run


BALL = '<shape type="sphere"><point name="center" value="0,0,-3"/><bsdf type="dielectric"/></shape>'
POINT, SPOT = '<emitter type="point"/>', '<emitter type="spot"/>'
LAMP = '<shape type="sphere"><point name="center" value="0,3,0"/><emitter type="area"/></shape>'


@pytest.mark.parametrize("lights", [POINT, SPOT, LAMP + POINT], ids=["point", "spot", "lamp and point"])
def test_paths_do_not_claim_the_caustics_of_point_lights(make_scene: Callable[..., Path], lights: str) -> None:
    """A path meets no point, and a light behind glass cannot be sampled: only the photon maps show that light."""
    plan = plan_of(str(make_scene(BALL + lights)), indirect="path")
    assert plan.left_out["caustics"] == "indirect=path finds caustics by its paths, but none of point and spot lights"
    lamp_alone = plan_of(str(make_scene(BALL + LAMP)), indirect="path")
    assert lamp_alone.left_out["caustics"] == "indirect=path finds caustics by its paths"


@pytest.mark.parametrize("scene", ["cornell-boxes", "cornell-spheres", "point-light"])
@pytest.mark.parametrize("indirect", INDIRECT)
@pytest.mark.parametrize("caustics", [True, False])
def test_every_stage_runs_or_is_left_out_for_a_reason_and_is_timed_if_it_runs(
    open_session: Callable[..., Any], scene: str, indirect: str, caustics: bool
) -> None:
    session = open_session(scene, **SMALL, indirect=indirect, caustics=caustics)
    plan = session.plan
    assert set(plan.run) | (set(plan.left_out) & STAGES) == STAGES
    assert not set(plan.run) & set(plan.left_out)
    assert all(plan.left_out.values())
    assert list(session.render().clock.totals()) == plan.run
