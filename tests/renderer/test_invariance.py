"""A picture hangs neither on the unit of length nor on the order in which a file lists its shapes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

HALF = 0.2775
WALLS = {
    "floor": ("white", (0, HALF, 0, 0, 0, 0, HALF, -HALF, HALF, 0, 0, 0)),
    "ceiling": ("white", (HALF, 0, 0, 0, 0, 0, -HALF, HALF, 0, HALF, 0, 0)),
    "back": ("white", (HALF, 0, 0, 0, 0, HALF, 0, 0, 0, 0, HALF, -HALF)),
    "left": ("red", (0, 0, HALF, -HALF, HALF, 0, 0, 0, 0, HALF, 0, 0)),
    "right": ("white", (0, 0, -HALF, HALF, 0, HALF, 0, 0, HALF, 0, 0, 0)),
}
BSDFS = (
    '<bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.73"/></bsdf>'
    '<bsdf type="diffuse" id="red"><rgb name="reflectance" value="0.63 0.065 0.05"/></bsdf>'
    '<bsdf type="dielectric" id="glass"><float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf>'
)
METHODS: dict[str, dict[str, Any]] = {
    "cached": {"irradiance_cache_tolerance": 0.5, "sampler": "sobol", "caustic_hints": True},
    "gathered": {"final_gather_rays": 16},
    "visualised": {"indirect": "direct_visualization"},
}


def box(scale: float, turned: bool = False) -> str:
    """A room with a lamp, a cube and a glass ball, all lengths times `scale`, its shapes in either order."""

    def matrix(numbers: Sequence[float]) -> str:
        return " ".join(repr(float(number) * scale) for number in numbers) + " 0 0 0 1"

    shapes = [
        f'<shape type="rectangle"><transform name="to_world"><matrix value="{matrix(numbers)}"/></transform>'
        f'<ref id="{bsdf}"/></shape>'
        for bsdf, numbers in WALLS.values()
    ]
    lamp = (0.0666, 0, 0, 0, 0, 0, -HALF, 0.274725, 0, 0.0555, 0, 0)
    shapes += [
        f'<shape type="rectangle"><transform name="to_world"><matrix value="{matrix(lamp)}"/></transform>'
        '<emitter type="area"><rgb name="radiance" value="15"/></emitter></shape>',
        f'<shape type="cube"><transform name="to_world"><scale value="{0.08 * scale}"/><rotate y="1" angle="20"/>'
        f'<translate x="{-0.1 * scale}" y="{-0.1975 * scale}" z="{-0.05 * scale}"/></transform>'
        '<ref id="white"/></shape>',
        f'<shape type="sphere"><point name="center" value="{0.11 * scale} {-0.17 * scale} {0.07 * scale}"/>'
        f'<float name="radius" value="{0.1 * scale}"/><ref id="glass"/></shape>',
    ]
    return BSDFS + "".join(reversed(shapes) if turned else shapes)


def camera(scale: float) -> str:
    """A camera in front of the room."""
    return f'<transform name="to_world"><lookat origin="0,0,{1.08 * scale}" target="0,0,0" up="0,1,0"/></transform>'


@pytest.fixture
def picture(make_scene: Callable[..., Path], render: Callable[..., Any]) -> Callable[..., Any]:
    """picture(method, scale, turned, seed): the room's pixels, lengths among the settings scaled along."""

    def make(method: str, scale: float = 1.0, turned: bool = False, seed: int = 0) -> Any:
        scene = make_scene(box(scale, turned), camera=camera(scale), fov_deg=40)
        lengths = {"gather_distance_m": 0.02 * scale, "caustic_gather_distance_m": 0.01 * scale}
        counts = {"global_photons": 10_000, "caustic_photons": 3_000, "shadow_rays": 4, "width": 32, "height": 32}
        return render(scene, seed=seed, **{**counts, **lengths, **METHODS[method]}).pixels

    return make


def difference(image: Any, other: Any) -> float:
    """Mean squared difference relative to brightness, the worst hundredth left out: grazing rays go either way."""
    error = np.sort(((image - other) ** 2 / (other**2 + 1e-3)).ravel())
    return float(error[: int(0.99 * len(error))].mean())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scale", [1e-3, 0.37, 1e3])
def test_a_scaled_scene_gives_the_same_picture(picture: Callable[..., Any], method: str, scale: float) -> None:
    """To single precision's noise; another seed shows that the measure sees noise."""
    plain = picture(method)
    assert difference(picture(method, scale), plain) < 1e-6
    assert difference(picture(method, seed=1), plain) > 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_the_order_of_shapes_does_not_show(picture: Callable[..., Any], method: str) -> None:
    assert difference(picture(method, turned=True), picture(method)) < 1e-6
