"""Lights in Phong lobes, found by samples of the light and by rays of the lobe: each counts once, with less noise.

Estimates are held two-sided to 4.5 standard errors (a false alarm in 150,000), which are bounded themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.stages import paths

SIGMAS = 4.5
GLOSSY = np.array([0.6, 0.3, 0.1])
ANGLE_DEG = 40.0
Make = Callable[..., Path]
Render = Callable[..., Any]
Z = Callable[[Any, float], float]

# A glossy plate in z = 0, seen from +x at ANGLE_DEG; what it mirrors lies towards -x.
X, Z_ = 5 * math.sin(math.radians(ANGLE_DEG)), 5 * math.cos(math.radians(ANGLE_DEG))
CAMERA = f'<transform name="to_world"><lookat origin="{X},0,{Z_}" target="0,0,0" up="0,1,0"/></transform>'
MIRROR = np.array([-math.sin(math.radians(ANGLE_DEG)), 0, math.cos(math.radians(ANGLE_DEG))])


def plate(exponent: float, diffuse: str = "0") -> str:
    return (
        f'<shape type="rectangle"><bsdf type="phong"><rgb name="diffuse_reflectance" value="{diffuse}"/>'
        f'<rgb name="specular_reflectance" value="0.6 0.3 0.1"/><float name="exponent" value="{exponent}"/></bsdf>'
        "</shape>"
    )


def lobe_times_cosine(exponent: float, place: Any) -> Any:
    """f cos theta / distance^2 for glossy = 1 towards places (.., 3) from the origin."""
    distance = np.linalg.norm(place, axis=-1)
    direction = place / distance[..., None]
    power = np.maximum(0, direction @ MIRROR) ** exponent
    return (exponent + 2) / (2 * math.pi) * power * np.maximum(0, direction[..., 2]) / distance**2


@pytest.mark.parametrize("exponent", [0, 3, 50, 2000])
@pytest.mark.parametrize("indirect", ["none", "direct_visualization", "final_gather", "path"])
@pytest.mark.parametrize("kind", ["point", "spot"])
def test_a_point_light_over_a_glossy_plate(
    make_scene: Make, render: Render, exponent: float, indirect: str, kind: str
) -> None:
    """f cos theta I / d^2, but for how far paths start above the plate: 3e-5 m, so 2e-5 of an angle of 0.03, to the
    power of 2,000.
    """
    place = 1.5 * MIRROR + (0.04, 0.03, 0)
    at = ",".join(map(str, place))
    lamp = (
        f'<emitter type="point"><point name="position" value="{at}"/><rgb name="intensity" value="3 2 1"/></emitter>'
        if kind == "point"
        else f'<emitter type="spot"><transform name="to_world"><lookat origin="{at}" target="0,0,0" up="0,1,0"/>'
        '</transform><rgb name="intensity" value="3 2 1"/></emitter>'
    )
    scene = make_scene(plate(exponent) + lamp, camera=CAMERA, fov_deg=1e-5)
    settings = {"width": 3, "height": 3, "global_photons": 100, "caustic_photons": 100}
    pixels = render(scene, indirect=indirect, samples_per_pixel=1, **settings).pixels
    expected = GLOSSY * (3, 2, 1) * lobe_times_cosine(exponent, place)
    np.testing.assert_allclose(pixels, np.broadcast_to(expected, pixels.shape), rtol=2e-3)


# Area lights that face the plate: XML, and points (N, 3) of them with the cosine at the light and the area of each.
SIDE = 1000
HEIGHT = 0.8


def flat_light(disk: bool, emitter: str) -> tuple[str, Any, Any, Any]:
    """Half edges or radius 0.3 about MIRROR's direction at HEIGHT, facing down."""
    middle = MIRROR * HEIGHT / MIRROR[2]
    kind = "disk" if disk else "rectangle"
    text = (
        f'<shape type="{kind}"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="180"/>'
        f'<translate value="{",".join(map(str, middle))}"/></transform>{emitter}</shape>'
    )
    steps = (np.arange(SIDE) + 0.5) / SIDE * 0.6 - 0.3
    x, y = (part.ravel() for part in np.meshgrid(steps, steps))
    inside = x * x + y * y < 0.09 if disk else np.ones(len(x), bool)
    place = middle + np.stack([x, y, 0 * x], -1)[inside]
    return text, place, place[:, 2] / np.linalg.norm(place, axis=1), 0.36 / SIDE**2


def sphere_light(emitter: str) -> tuple[str, Any, Any, Any]:
    middle, radius = MIRROR * 1.1, 0.3
    text = (
        f'<shape type="sphere"><point name="center" value="{",".join(map(str, middle))}"/>'
        f'<float name="radius" value="{radius}"/>{emitter}</shape>'
    )
    z, phi = np.meshgrid((np.arange(SIDE) + 0.5) / SIDE * 2 - 1, (np.arange(SIDE) + 0.5) / SIDE * 2 * math.pi)
    normal = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], -1).reshape(-1, 3)
    place = middle + radius * normal
    cosine = np.maximum(0, -(place * normal).sum(axis=1) / np.linalg.norm(place, axis=1))
    return text, place, cosine, 4 * math.pi * radius**2 / SIDE**2


def mesh_light(emitter: str, file: Path) -> tuple[str, Any, Any, Any]:
    """The rectangle as an OBJ of two triangles."""
    text, place, cosine, area = flat_light(False, emitter)
    (file / "square.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3\nf 1 3 4\n")
    name = '<shape type="obj"><string name="filename" value="square.obj"/>'
    return text.replace('<shape type="rectangle">', name), place, cosine, area


@pytest.mark.parametrize("exponent", [0, 5, 100, 3000])
@pytest.mark.parametrize("kind", ["rectangle", "disk", "sphere", "mesh"])
@pytest.mark.parametrize("shadow_rays", [1, 9])
def test_an_area_light_over_a_glossy_plate(
    make_scene: Make, render: Render, z_score: Z, tmp_path: Path, kind: str, exponent: float, shadow_rays: int
) -> None:
    """Against midpoint sums over the light: samples of the light and rays of the lobe make up one light between them.

    Alone either would give from a hundredth to nearly all of it, depending on the exponent.
    """
    emitter = '<emitter type="area"><rgb name="radiance" value="4 4 4"/></emitter>'
    light = {
        "rectangle": lambda: flat_light(False, emitter), "disk": lambda: flat_light(True, emitter),
        "sphere": lambda: sphere_light(emitter), "mesh": lambda: mesh_light(emitter, tmp_path),
    }[kind]()  # fmt: skip
    text, place, cosine, area = light
    scene = make_scene(plate(exponent) + text, camera=CAMERA, fov_deg=1e-3)
    settings = {"indirect": "none", "caustics": False, "width": 16, "height": 16, "samples_per_pixel": 16}
    pixels = render(scene, shadow_rays=shadow_rays, **settings).pixels
    expected = 4 * float((lobe_times_cosine(exponent, place) * cosine).sum() * area)
    for channel in range(3):
        shown = pixels[..., channel]
        assert shown.std() / 16 < 0.01 * shown.mean()
        assert abs(z_score(shown, GLOSSY[channel] * expected)) < SIGMAS


@pytest.fixture
def brute_force(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Call it, and lobes find lights by their rays alone."""

    def follow(context: Any, lobes: Any, fan: int, first: int, rays: Any, density: Any) -> int:
        count = follow_lobes(context, lobes, fan, first, rays, density)
        density[:] = 0
        return count

    follow_lobes = paths.follow_lobes

    def forget() -> None:
        monkeypatch.setattr(paths, "follow_lobes", follow)
        monkeypatch.setattr(paths, "light_lobes", lambda *_: None)

    return forget


def spheres(render: Render, seeds: int, exponent: float, **settings: Any) -> Any:
    """Pictures (seeds, 40, 40, 3) of phong-spheres, all of one exponent."""
    defines = {f"exponent_{where}": str(exponent) for where in ("left", "middle", "right")}
    size = {"width": 40, "height": 40, "global_photons": 5000, "caustic_photons": 5000}
    how = {"sampler": "sobol", **size, **settings}
    return np.array([render("phong-spheres", defines=defines, seed=s, **how).pixels for s in range(seeds)], np.float64)


@pytest.mark.parametrize("exponent", [2, 40])
@pytest.mark.parametrize("indirect", ["none", "path"])
def test_lights_are_as_bright_as_by_lobe_rays_alone(
    render: Render, brute_force: Callable[[], None], indirect: str, exponent: float
) -> None:
    """phong-spheres with and without samples of the lamp: 100 blocks of 4 x 4 pixels, beyond 5 in none."""
    settings = {"indirect": indirect, "caustics": False, "samples_per_pixel": 16, "shadow_rays": 4}
    ours = spheres(render, 6, exponent, **settings)
    brute_force()
    plain = spheres(render, 6, exponent, **settings)
    blocks = [part.mean(axis=-1).reshape(6, 10, 4, 10, 4).mean(axis=(2, 4)) for part in (ours, plain)]
    error = np.sqrt(sum(part.var(axis=0, ddof=1) for part in blocks) / 6)
    # Six seeds underrate some blocks' errors: none is taken for less than the blocks' middle one.
    error = np.maximum(error, np.median(error))
    difference = blocks[0].mean(axis=0) - blocks[1].mean(axis=0)
    assert np.abs(difference / error).max() < 5
    assert abs(ours.mean() / plain.mean() - 1) < 0.01


@pytest.mark.parametrize(("exponent", "factor"), [(1, 0.02), (10, 0.06), (100, 0.6)])
def test_lights_are_much_less_noisy(
    render: Render, brute_force: Callable[[], None], exponent: float, factor: float
) -> None:
    """Mean variance over seeds of direct light, where samples of the lamp add less than 5 % to the rays.

    On the spheres it falls to 0.003, 0.017 and about 0.2 of what it is by lobe rays alone; the rest of the picture has
    noise of its own, a mean over twelve seeds and a hundred glossy pixels is good to a fifth.
    """
    settings = {"indirect": "none", "caustics": False, "samples_per_pixel": 1, "shadow_rays": 4, "jitter": False}
    ours = spheres(render, 12, exponent, **settings)
    brute_force()
    plain = spheres(render, 12, exponent, **settings)
    assert ours.var(axis=0, ddof=1).mean() < factor * plain.var(axis=0, ddof=1).mean()
