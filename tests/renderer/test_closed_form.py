"""Radiance known in closed form: lights over planes, mirrors, glass.

Unbiased estimates are held two-sided to 4.5 standard errors (a false alarm in 150,000), the standard error taken
from independent pixels or seeds; each such test also bounds the standard error, so that it can fail. Deterministic
ones are held to single precision.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.kernels.vector import fresnel, reflected, refracted

SIGMAS = 4.5
Z = Callable[[Any, float], float]
Render = Callable[..., Any]
Make = Callable[..., Path]

# The plane z = -1 in front of the camera at the origin, reflecting half.
PLANE = (
    '<shape type="rectangle"><transform name="to_world"><scale value="1.5"/><translate value="0,0,-1"/></transform>'
    '<bsdf type="diffuse"><rgb name="reflectance" value="0.5 0.25 0.125"/></bsdf></shape>'
)
ALBEDO = np.array([0.5, 0.25, 0.125])
EMITTER = '<emitter type="area"><rgb name="radiance" value="4 4 4"/></emitter>'
# No jitter and one sample: every eye ray goes through its pixel's centre.
CENTRES: dict[str, Any] = {"indirect": "none", "caustics": False, "samples_per_pixel": 1, "jitter": False}


def film(width: int = 16, fov_deg: float = 60.0) -> tuple[Any, Any]:
    """x and y on the plane z = -1 that the pixels' centres see, (width, width)."""
    x = (2 * (np.arange(width) + 0.5) / width - 1) * math.tan(math.radians(fov_deg) / 2)
    return np.meshgrid(x, -x)


def point_light(position: str) -> str:
    return (
        f'<emitter type="point"><point name="position" value="{position}"/>'
        '<rgb name="intensity" value="6 6 6"/></emitter>'
    )


def place(*steps: str) -> str:
    return f'<transform name="to_world">{"".join(steps)}</transform>'


# --- light straight from lights ---


def test_a_point_light_over_a_plane(make_scene: Make, render: Render) -> None:
    """L = albedo / pi  I cos / d^2 in every pixel: one shadow ray, nothing random.

    To 2e-4: points are lifted off the surface by a hundred-thousandth of the scene's radius, 2e-5 m here.
    """
    light = point_light("0.3,0.2,-0.4")
    x, y = film()
    d2 = (x - 0.3) ** 2 + (y - 0.2) ** 2 + 0.6**2
    expected = (ALBEDO / math.pi) * (6 * 0.6 / d2**1.5)[..., None]
    np.testing.assert_allclose(render(make_scene(PLANE + light), **CENTRES).pixels, expected, rtol=2e-4)


def test_a_spot_light_over_a_plane(make_scene: Make, render: Render) -> None:
    """Full inside beam_width, linear in the angle down to nothing at cutoff_angle."""
    light = (
        '<emitter type="spot"><float name="cutoff_angle" value="40"/><float name="beam_width" value="15"/>'
        '<rgb name="intensity" value="6 6 6"/>'
        + place('<lookat origin="0.1,0,-0.4" target="0.1,0,-1" up="0,1,0"/>')
        + "</emitter>"
    )
    x, y = film()
    d2 = (x - 0.1) ** 2 + y**2 + 0.6**2
    falloff = np.clip((40 - np.degrees(np.arccos(0.6 / np.sqrt(d2)))) / 25, 0, 1)
    expected = (ALBEDO / math.pi) * (falloff * 6 * 0.6 / d2**1.5)[..., None]
    pixels = render(make_scene(PLANE + light), **CENTRES).pixels
    # The lift of 2e-5 m turns the angle by up to 0.002 of the 25 degrees, near the cutoff a large share of little.
    np.testing.assert_allclose(pixels, expected, rtol=2e-4, atol=2e-4)
    assert (expected == 0).any()
    assert (falloff == 1).any()


def test_a_shadow_is_dark_and_the_rest_is_not(make_scene: Make, render: Render) -> None:
    """A triangle-made and an analytic blocker: the pixels behind them see nothing, the others all."""
    light = (
        '<emitter type="point"><point name="position" value="0,0,2"/><rgb name="intensity" value="6 6 6"/></emitter>'
    )
    blockers = (
        '<shape type="rectangle">'
        + place('<scale value="0.05"/>', '<translate value="0.2,0,0.5"/>')
        + "</shape>"
        + '<shape type="sphere"><point name="center" value="-0.2,0,0.5"/><float name="radius" value="0.05"/></shape>'
    )
    x, y = film(64)
    # From the lamp at z = 2 a point of the plane is seen through (x, y) / 2 at z = 0.5.
    square = (np.abs(x / 2 - 0.2) < 0.05) & (np.abs(y / 2) < 0.05)
    ray = np.stack([x, y, np.full_like(x, -3.0)], -1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    offset = np.array([-0.2, 0, -1.5])
    round_ = offset @ offset - (ray @ offset) ** 2 < 0.05**2
    pixels = render(make_scene(PLANE + blockers + light), width=64, height=64, **CENTRES).pixels
    np.testing.assert_array_equal(pixels[..., 0] == 0, square | round_)
    assert square.sum() > 8
    assert round_.sum() > 8


def corner_form_factor(a: Any, b: Any, h: float) -> Any:
    """Form factor from a point to a parallel rectangle a x b at height h over one of its corners."""
    u, v = np.hypot(a, h), np.hypot(b, h)
    return (a / u * np.arctan(b / u) + b / v * np.arctan(a / v)) / (2 * math.pi)


@pytest.mark.parametrize("shadow_rays", [4, 7, 36])
@pytest.mark.parametrize("sampler", ["stratified", "independent"])
def test_a_rectangle_light_over_a_plane(
    make_scene: Make, render: Render, z_score: Z, sampler: str, shadow_rays: int
) -> None:
    """E = pi L F, F the form factor of parallel rectangles (Howell C-11, signed over four corners)."""
    lamp = (
        '<shape type="rectangle">'
        + place('<scale x="0.3" y="0.2" z="1"/>', '<rotate x="1" angle="180"/>', '<translate value="0.1,0,0.5"/>')
        + EMITTER
        + "</shape>"
    )
    x, y = film(32)
    terms = [
        sign_x * sign_y * corner_form_factor(0.1 + sign_x * 0.3 - x, sign_y * 0.2 - y, 1.5)
        for sign_x in (-1, 1)
        for sign_y in (-1, 1)
    ]
    expected = 4 * np.sum(terms, axis=0)
    settings = {**CENTRES, "shadow_rays": shadow_rays, "sampler": sampler, "width": 32, "height": 32}
    pixels = render(make_scene(PLANE + lamp), **settings).pixels
    ratio = pixels / (ALBEDO * expected[..., None])
    np.testing.assert_allclose(ratio, np.repeat(ratio[..., :1], 3, -1), rtol=1e-5)
    assert abs(z_score(ratio[..., 0], 1)) < SIGMAS
    assert ratio[..., 0].std() < 0.2 / math.sqrt(shadow_rays)


@pytest.mark.parametrize("radius", [0.5, 0.1, 0.003, 0.0003])
@pytest.mark.parametrize("height", [0.2, 1.0])
def test_a_sphere_light_over_a_plane(
    make_scene: Make, render: Render, z_score: Z, radius: float, height: float
) -> None:
    """E = pi L (r / d)^2 cos where the whole sphere is above the horizon: also for tiny, distant ones."""
    lamp = (
        f'<shape type="sphere"><point name="center" value="0.1,0,{height - 0.5}"/>'
        f'<float name="radius" value="{radius}"/>{EMITTER}</shape>'
    )
    camera = place('<lookat origin="3,0,0.5" target="1,0,-1" up="0,0,1"/>')
    scene = make_scene(PLANE + lamp, camera=camera, fov_deg=8)
    image = render(scene, width=32, height=32, shadow_rays=9, **CENTRES)
    # The same film looking along -z, turned to the camera's axes.
    u, v = film(32, 8)
    forward = np.array([-2, 0, -1.5]) / 2.5
    right = np.array([0.0, 1, 0])
    ray = forward + u[..., None] * right + v[..., None] * np.cross(right, forward)
    at = np.array([3, 0, 0.5]) - ray * (1.5 / ray[..., 2:])
    up = height + 0.5
    d2 = (at[..., 0] - 0.1) ** 2 + at[..., 1] ** 2 + up**2
    expected = 4 * radius**2 * up / d2**1.5
    assert up > radius
    ratio = image.pixels[..., 0] / (0.5 * expected)
    assert ratio.std() < 0.1
    # The lift of 2e-5 m off the plane brings the light nearer by up to 1e-4.
    assert abs(z_score(ratio, 1)) < SIGMAS or abs(ratio.mean() - 1) < 1e-4


def test_an_area_light_is_seen_with_its_radiance_on_its_front_alone(make_scene: Make, render: Render) -> None:
    lamp = '<shape type="rectangle">{}' + EMITTER + "</shape>"
    facing = lamp.format(place('<scale value="20"/>', '<translate value="0,0,-1"/>'))
    averted = lamp.format(place('<scale value="20"/>', '<rotate y="1" angle="180"/>', '<translate value="0,0,-1"/>'))
    np.testing.assert_array_equal(render(make_scene(facing), **CENTRES).pixels, 4)
    np.testing.assert_array_equal(render(make_scene(averted), **CENTRES).pixels, 0)


# --- mirrors and glass ---


def test_a_mirror_shows_what_a_camera_behind_it_would_see(make_scene: Make, render: Render) -> None:
    """A lamp and a lit wall, seen in a mirror at z = -1 and by the camera's mirror image: the same but left-right."""
    things = (
        point_light("0.2,0.3,0.5")
        + '<shape type="rectangle">'
        + place('<scale value="5"/>', '<rotate x="1" angle="180"/>', '<translate value="0.3,0,2"/>')
        + '<bsdf type="diffuse"><rgb name="reflectance" value="0.5 0.25 0.125"/></bsdf></shape>'
        '<shape type="rectangle">'
        + place('<scale value="0.3"/>', '<rotate x="1" angle="180"/>', '<translate value="0.4,0.1,1.5"/>')
        + EMITTER
        + "</shape>"
    )
    mirror = (
        '<shape type="rectangle">'
        + place('<scale value="9"/>', '<translate value="0,0,-1"/>')
        + '<bsdf type="conductor"><string name="material" value="none"/>'
        '<rgb name="specular_reflectance" value="0.9 0.8 0.7"/></bsdf></shape>'
    )
    behind = place('<lookat origin="0,0,-2" target="0,0,0" up="0,1,0"/>')
    settings = {**CENTRES, "width": 48, "height": 48, "shadow_rays": 400}
    seen = render(make_scene(things + mirror), **settings).pixels
    direct = render(make_scene(things, camera=behind), **settings).pixels[:, ::-1]
    lamp = direct[..., 0] == 4
    assert 20 < lamp.sum() < lamp.size / 2
    expected = direct * np.array([0.9, 0.8, 0.7])
    np.testing.assert_allclose(seen[lamp], expected[lamp], rtol=1e-5)
    # The mirror also reflects light onto the wall, which only caustics (off here) would show: direct light alone.
    # Both sample the small lamp with 400 stratified rays of their own: 1 % is ten times their error.
    edge = np.zeros_like(lamp)
    for shift in (-1, 1):
        edge |= np.roll(lamp, shift, 0) ^ lamp | np.roll(lamp, shift, 1) ^ lamp
    np.testing.assert_allclose(seen[~edge], expected[~edge], rtol=0.01)


OCTAHEDRON_PLY = """ply
format ascii 1.0
element vertex 6
property float x
property float y
property float z
element face 8
property list uchar int vertex_indices
end_header
1 0 0
-1 0 0
0 1 0
0 -1 0
0 0 1
0 0 -1
3 0 2 4
3 2 1 4
3 1 3 4
3 3 0 4
3 2 0 5
3 1 2 5
3 3 1 5
3 0 3 5
"""


@pytest.mark.parametrize("indirect", ["path", "none"])
@pytest.mark.parametrize("bsdf", ["conductor", "dielectric"])
def test_what_is_convex_reflects_nothing_of_itself(
    tmp_path: Path, make_scene: Make, render: Render, bsdf: str, indirect: str
) -> None:
    """An emissive octahedron alone, smoothed so that its shading normals are up to 55 degrees off its faces.

    Only its outside emits, so mirror and glass show that once, 4, and nothing else.
    """
    (tmp_path / "octahedron.ply").write_text(OCTAHEDRON_PLY, encoding="utf-8")
    name = '<string name="material" value="none"/>' if bsdf == "conductor" else ""
    body = (
        '<shape type="ply"><string name="filename" value="octahedron.ply"/>'
        + place(
            '<rotate x="1" angle="20"/>',
            '<rotate y="1" angle="25"/>',
            '<scale value="0.5"/>',
            '<translate value="0,0,-2"/>',
        )
        + f'<bsdf type="{bsdf}">{name}</bsdf>'
        + EMITTER
        + "</shape>"
    )
    pixels = render(make_scene(body), width=48, height=48, indirect=indirect, seed=3).pixels
    assert (pixels[..., 0] > 0).mean() > 0.05
    assert pixels.max() <= 4.0 * (1 + 1e-5)


def fresnel_closed_form(cos_i: Any, n: float) -> Any:
    """Unpolarised reflectance going from index 1 into n, straight from Snell's law."""
    cos_t = np.sqrt(1 - (1 - np.asarray(cos_i) ** 2) / n**2)
    r_s = (cos_i - n * cos_t) / (cos_i + n * cos_t)
    r_p = (n * cos_i - cos_t) / (n * cos_i + cos_t)
    return (r_s**2 + r_p**2) / 2


def test_fresnel_reflectance() -> None:
    assert fresnel(1.0, 1 / 1.5)[0] == pytest.approx(0.04, rel=1e-9)
    for angle in np.radians([5, 30, 56, 80, 89]):
        cos_i = math.cos(angle)
        share, cos_t = fresnel(cos_i, 1 / 1.5)
        assert share == pytest.approx(float(fresnel_closed_form(cos_i, 1.5)), rel=1e-9)
        assert math.sin(angle) == pytest.approx(1.5 * math.sqrt(1 - cos_t**2), rel=1e-9)
        # The way back reflects as much.
        assert fresnel(cos_t, 1.5)[0] == pytest.approx(share, rel=1e-9)
    brewster = math.cos(math.atan(1.5))
    cos_t = math.sqrt(1 - (1 - brewster**2) / 2.25)
    r_s = (brewster - 1.5 * cos_t) / (brewster + 1.5 * cos_t)
    assert fresnel(brewster, 1 / 1.5)[0] == pytest.approx(r_s**2 / 2, rel=1e-9)


def test_total_internal_reflection_starts_at_the_critical_angle() -> None:
    critical = math.asin(1 / 1.5)
    assert fresnel(math.cos(critical + 1e-6), 1.5) == (1.0, 0.0)
    assert fresnel(math.cos(critical - 1e-6), 1.5)[0] < 1


def test_reflected_and_refracted_directions() -> None:
    random = np.random.default_rng(3)
    for eta in (1 / 1.5, 1.2, 1.0):
        for _ in range(50):
            normal = random.normal(size=3)
            normal /= np.linalg.norm(normal)
            going = random.normal(size=3)
            going /= np.linalg.norm(going)
            going = going if going @ normal < 0 else -going
            cos_i = -going @ normal
            bounced = np.array(reflected(*going, *normal))
            np.testing.assert_allclose(np.cross(bounced, normal), np.cross(going, normal), atol=1e-12)
            assert bounced @ normal == pytest.approx(cos_i)
            share, cos_t = fresnel(cos_i, eta)
            if share < 1:
                through = np.array(refracted(*going, *normal, cos_i, cos_t, eta))
                np.testing.assert_allclose(np.cross(through, normal), eta * np.cross(going, normal), atol=1e-9)
                assert through @ normal == pytest.approx(-cos_t)


GLASS = '<bsdf type="dielectric"><float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf>'
PANEL = '<shape type="rectangle">' + place('<scale value="50"/>', '<translate value="0,0,-4"/>') + EMITTER + "</shape>"


@pytest.mark.parametrize("angle_deg", [0, 30, 60, 75])
def test_a_glass_slab_lets_through_what_fresnel_says(
    make_scene: Make, render: Render, z_score: Z, angle_deg: float
) -> None:
    """(1 - R) / (1 + R) of the radiance behind, over all reflections inside; R Fresnel's at the pixel's angle.

    Branches that carry less than a thousandth of the pixel are drawn at random, hence 4.5 sigma over pixels.
    """
    slab = (
        '<shape type="cube">'
        + place('<scale x="30" y="30" z="0.1"/>', f'<rotate y="1" angle="{angle_deg}"/>', '<translate value="0,0,-1"/>')
        + GLASS
        + "</shape>"
    )
    # Small enough that what the slab's front reflects misses the panel.
    panel = PANEL.replace('"50"', '"1"')
    pixels = render(make_scene(panel + slab, fov_deg=4), max_depth=40, **CENTRES).pixels[..., 0]
    u, v = film(16, 4)
    turned = math.radians(angle_deg)
    cos_i = (u * math.sin(turned) - math.cos(turned)) / np.sqrt(1 + u * u + v * v)
    r = fresnel_closed_form(np.abs(cos_i), 1.5)
    ratio = pixels / (4 * (1 - r) / (1 + r))
    assert ratio.std() < 0.01
    assert abs(z_score(ratio, 1)) < SIGMAS or abs(ratio.mean() - 1) < 1e-5


def test_a_mirror_image_in_glass_has_fresnels_share(make_scene: Make, render: Render) -> None:
    """The front of a thick slab shows a lamp behind the camera with R; what enters never comes back."""
    lamp = (
        '<shape type="rectangle">'
        + place('<scale value="50"/>', '<rotate x="1" angle="180"/>', '<translate value="0,0,1"/>')
        + EMITTER
        + "</shape>"
    )
    block = '<shape type="cube">' + place('<scale value="30"/>', '<translate value="0,0,-31"/>') + GLASS + "</shape>"
    pixels = render(make_scene(lamp + block), max_depth=1, **CENTRES).pixels[..., 0]
    x, y = film()
    np.testing.assert_allclose(pixels, 4 * fresnel_closed_form(1 / np.sqrt(1 + x * x + y * y), 1.5), rtol=1e-4)


def test_from_inside_glass_the_world_is_in_a_cone(make_scene: Make, render: Render) -> None:
    """n^2 (1 - R) L inside the critical angle, and nothing of the panel beyond it."""
    block = '<shape type="cube">' + place('<scale x="30" y="30" z="1"/>') + GLASS + "</shape>"
    pixels = render(make_scene(PANEL + block, fov_deg=100), width=64, height=64, max_depth=0, **CENTRES).pixels
    assert not pixels.any(), "max_depth=0 follows nothing through glass"
    pixels = render(make_scene(PANEL + block, fov_deg=100), width=64, height=64, max_depth=1, **CENTRES).pixels
    x, y = film(64, 100)
    cos_i = 1 / np.sqrt(1 + x * x + y * y)
    sine2 = 2.25 * (1 - cos_i**2)
    inside = sine2 < 1
    cos_out = np.sqrt(np.where(inside, 1 - sine2, 1))
    expected = np.where(inside, 2.25 * (1 - fresnel_closed_form(cos_out, 1.5)) * 4, 0)
    clear = np.abs(sine2 - 1) > 0.01
    np.testing.assert_allclose(pixels[..., 0][clear], expected[clear], rtol=1e-4)
    assert inside.sum() > 200
    assert (~inside).sum() > 200
