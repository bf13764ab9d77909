"""The constant environment: reading it, seeing it, being lit by it, photons from it, and Mitsuba's word on all that.

Estimates are held two-sided to 4.5 standard errors (a false alarm in 150,000), which are bounded themselves;
chi-square tests to 2e-4.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.kernels.rng import path_key
from joulebox_render.records import ENVIRONMENT, POINT_LIGHT, Photons
from joulebox_render.stages import photon_map
from joulebox_render.stages.aim import aim_everywhere
from joulebox_render.stages.photon_map import FIRST_HIT
from scene_files import load, message
from scipy import stats

SIGMAS = 4.5
ALPHA = 2e-4
RADIANCE = np.array([1.5, 1.0, 0.5])
SKY = '<emitter type="constant"><rgb name="radiance" value="1.5 1 0.5"/></emitter>'
Make = Callable[..., Path]
Open = Callable[..., Any]
Render = Callable[..., Any]
Z = Callable[[Any, float], float]


def diffuse(reflectance: str) -> str:
    return f'<bsdf type="diffuse"><rgb name="reflectance" value="{reflectance}"/></bsdf>'


def place(**steps: str) -> str:
    """A transform of named steps, in their order; a rotation's value is an axis's name and an angle."""
    text = ""
    for step, value in steps.items():
        if step == "rotate":
            axis, angle = value.split()
            text += f'<rotate {axis}="1" angle="{angle}"/>'
        else:
            text += f'<{step} value="{value}"/>'
    return f'<transform name="to_world">{text}</transform>'


def camera(origin: str, target: str, up: str = "0,1,0") -> str:
    return f'<transform name="to_world"><lookat origin="{origin}" target="{target}" up="{up}"/></transform>'


# --- the reader ---


def test_reading(tmp_path: Path) -> None:
    """The light's ball is the one around the geometry: half a cube's diagonal; its power what enters that ball."""
    cube = f'<shape type="cube">{place(translate="1,2,3")}</shape>'
    lights = load(tmp_path, cube + SKY).lights
    assert sorted(lights.kind.tolist()) == [POINT_LIGHT, ENVIRONMENT]
    row = lights.kind.tolist().index(ENVIRONMENT)
    np.testing.assert_allclose(lights.radiance[row], RADIANCE)
    np.testing.assert_allclose(lights.position[row], [1, 2, 3], atol=1e-6)
    radius = float(lights.radius[row])
    assert math.sqrt(3) <= radius <= 1.001 * math.sqrt(3)
    np.testing.assert_allclose(lights.power[row], math.pi * RADIANCE * 4 * math.pi * radius**2, rtol=1e-6)
    assert lights.area[row] == 0


def test_the_default_radiance_is_one(tmp_path: Path) -> None:
    lights = load(tmp_path, '<shape type="cube"/><emitter type="constant"/>', lamp="").lights
    np.testing.assert_array_equal(lights.radiance, [[1, 1, 1]])


def test_one_sky_is_enough(tmp_path: Path) -> None:
    assert "a constant light already" in message(tmp_path, SKY + SKY)


def test_a_black_sky_is_left_out_with_a_word(tmp_path: Path) -> None:
    black = '<emitter type="constant"><rgb name="radiance" value="0"/></emitter>'
    scene = load(tmp_path, '<shape type="cube"/>' + black)
    assert scene.lights.kind.tolist() == [POINT_LIGHT]
    assert any("constant" in note and "left out" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ('<rgb name="radiance" value="-1"/>', ["radiance"]),
        ('<float name="scale" value="2"/>', ['"scale"', "radiance"]),
        ('<rgb name="intensity" value="2"/>', ['"intensity"', "radiance"]),
    ],
)
def test_refusals(tmp_path: Path, inside: str, words: list[str]) -> None:
    said = message(tmp_path, f'<emitter type="constant">{inside}</emitter>')
    assert "line 5" in said
    assert all(word in said for word in words)


# --- seeing it ---

ONE: dict[str, Any] = {"indirect": "none", "caustics": False, "samples_per_pixel": 1}
FAR = f'<shape type="rectangle">{place(translate="0,0,50")}</shape>'


def test_what_misses_shows_the_sky(make_scene: Make, render: Render) -> None:
    pixels = render(make_scene(FAR + SKY), **ONE).pixels
    np.testing.assert_array_equal(pixels, np.broadcast_to(RADIANCE, pixels.shape))


def test_a_mirror_shows_the_sky(make_scene: Make, render: Render) -> None:
    mirror = (
        f'<shape type="rectangle">{place(scale="9", translate="0,0,-1")}'
        '<bsdf type="conductor"><string name="material" value="none"/>'
        '<rgb name="specular_reflectance" value="0.9 0.8 0.7"/></bsdf></shape>'
    )
    pixels = render(make_scene(mirror + SKY), **ONE).pixels
    np.testing.assert_allclose(pixels, np.broadcast_to(RADIANCE * (0.9, 0.8, 0.7), pixels.shape), rtol=1e-6)


@pytest.mark.parametrize("ior", [1.5, 0.7])
def test_the_white_furnace_of_glass(make_scene: Make, render: Render, z_score: Z, ior: float) -> None:
    """A glass ball in a uniform sky cannot be seen: what it reflects and lets through adds up to what is behind it."""
    glass = f'<bsdf type="dielectric"><float name="int_ior" value="{ior}"/><float name="ext_ior" value="1"/></bsdf>'
    ball = f'<shape type="sphere"><point name="center" value="0,0,-3"/><float name="radius" value="2"/>{glass}</shape>'
    scene = make_scene(ball + SKY)
    pixels = render(scene, width=48, height=48, max_depth=100, **ONE).pixels / RADIANCE
    assert pixels.std() < 0.05
    assert abs(z_score(pixels[..., 0], 1)) < SIGMAS or abs(pixels.mean() - 1) < 1e-5


# --- being lit by it ---

FLOOR = f'<shape type="rectangle">{place(scale="100")}{diffuse("0.5 0.25 0.125")}</shape>'
ALBEDO = np.array([0.5, 0.25, 0.125])
# Looks straight down on z = 0 from 3 m above x = 1; film x runs along +x.
DOWN = camera("1,0,3", "1,0,0")


@pytest.mark.parametrize("sampler", ["independent", "stratified", "sobol"])
@pytest.mark.parametrize("indirect", ["none", "path", "final_gather", "direct_visualization"])
def test_an_open_plane_reflects_albedo_times_the_sky(
    make_scene: Make, render: Render, sampler: str, indirect: str
) -> None:
    """Cosine-distributed samples of a uniform sky are all alike: exact to single precision."""
    settings = {"global_photons": 500, "gather_distance_m": 1.0, "shadow_rays": 7, "final_gather_rays": 4}
    scene = make_scene(FLOOR + SKY, camera=DOWN)
    pixels = render(scene, indirect=indirect, sampler=sampler, **settings).pixels
    np.testing.assert_allclose(pixels, np.broadcast_to(ALBEDO * RADIANCE, pixels.shape), rtol=1e-5)


@pytest.mark.parametrize("sampler", ["independent", "stratified", "sobol"])
def test_a_wall_hides_its_part(make_scene: Make, render: Render, z_score: Z, sampler: str) -> None:
    """Beside an endless wall of height h a point at x sees (1 + x / (x^2 + h^2)^(1/2)) / 2; half at its foot."""
    height = 2.0
    wall = f'<shape type="rectangle">{place(scale="2,900,1", rotate="y 90")}{diffuse("0")}</shape>'
    scene = make_scene(FLOOR.replace("100", "1000") + wall + SKY, camera=camera("2,0,0.5", "2,0,0"), fov_deg=150)
    pixels = render(scene, width=32, height=32, shadow_rays=36, sampler=sampler, **ONE, jitter=False).pixels
    x = 2 + 0.5 * math.tan(math.radians(75)) * (2 * (np.arange(32) + 0.5) / 32 - 1)
    right = x > 0.05
    seen = (1 + x / np.hypot(x, height)) / 2
    ratio = pixels[:, right, 0] / (0.5 * 1.5 * seen[right])
    assert ratio.std() < 0.2
    assert abs(z_score(ratio, 1)) < SIGMAS
    near = make_scene(FLOOR + wall + SKY, camera=camera("0.001,0,1", "0.001,0,0"), fov_deg=0.05)
    foot = render(near, width=16, height=16, shadow_rays=36, sampler=sampler, **ONE).pixels[:, :, 0]
    assert abs(z_score(foot, 0.75 / 2)) < SIGMAS
    assert foot.std() / 16 < 0.01


# --- photons from it ---


def trace(session: Any, count: int) -> Photons:
    tables = session.context.tables
    family = np.uint64(path_key(3, photon_map.EMISSION_STREAM, photon_map.EVERYWHERE))
    photons = photon_map.trace_photons(session.context, aim_everywhere(tables), family, 0, count)
    return Photons(*(column[photons.history == FIRST_HIT] for column in photons))


def assert_uniform(*coordinates: Any) -> None:
    counts = np.histogramdd(np.stack(coordinates, -1), bins=10, range=[(0, 1)] * len(coordinates))[0].ravel()
    p = stats.chisquare(counts).pvalue
    assert ALPHA / 2 < p < 1 - ALPHA / 2, p


def assert_cosine(photons: Photons) -> None:
    """Where they come from has the cosine density about the normal."""
    cosine = np.einsum("ij,ij->i", photons.wi.astype(float), photons.normal)
    assert cosine.min() >= 0
    assert_uniform(np.minimum(cosine**2, 1))


def test_photons_land_on_a_ball_everywhere_alike(make_scene: Make, open_session: Open) -> None:
    """Flux pi L 4 pi R^2 in all, uniform over the ball, cosine-distributed; a share (R / r)^2 of those that enter."""
    ball = (
        f'<shape type="sphere"><point name="center" value="1,2,3"/><float name="radius" value="0.7"/>{diffuse("0.5")}'
        "</shape>"
    )
    session = open_session(make_scene(ball + SKY))
    photons, count = trace(session, 60_000), 60_000
    outwards = (photons.position.astype(float) - (1, 2, 3)) / 0.7
    np.testing.assert_allclose(np.linalg.norm(outwards, axis=1), 1, atol=1e-4)
    assert_uniform((outwards[:, 2] + 1) / 2, (np.arctan2(outwards[:, 1], outwards[:, 0]) / (2 * math.pi)) % 1)
    assert_cosine(photons)
    # The ball of the light is the bounding box's: (R / r)^2 = 1/3 of what enters meets the ball.
    share = 1 / 3 / 1.0001**2
    assert abs(len(photons.number) - share * count) < SIGMAS * math.sqrt(share * (1 - share) * count)
    np.testing.assert_allclose(photons.flux[0], math.pi * RADIANCE * 4 * math.pi * 0.7**2 / share, rtol=1e-4)


def test_photons_on_a_plane_bring_pi_times_the_sky(make_scene: Make, open_session: Open) -> None:
    """Irradiance pi L: a Poisson count of equal photons, uniform over the plane; its back stores nothing."""
    plate = f'<shape type="rectangle">{place(scale="1,0.5,1")}{diffuse("0.5")}</shape>'
    count = 60_000
    photons = trace(open_session(make_scene(plate + SKY)), count)
    flux = photons.flux[:, 1].astype(float)
    np.testing.assert_allclose(flux, flux[0], rtol=1e-5)
    stored, expected = len(flux), math.pi * RADIANCE[1] * 2.0 / (flux[0] / count)
    assert expected > 5000
    assert abs(stored - expected) < SIGMAS * math.sqrt(expected)
    assert_uniform((photons.position[:, 0] + 1) / 2, photons.position[:, 1] + 0.5)
    assert_cosine(photons)
    assert np.all(photons.normal[:, 2] > 0.999)


def test_lights_share_emission_by_power(make_scene: Make, open_session: Open) -> None:
    """A point lamp besides the sky: all photons carry the power of both together."""
    ball = f'<shape type="sphere"><float name="radius" value="0.5"/>{diffuse("0.5")}</shape>'
    lamp = '<emitter type="point"><point name="position" value="0,0,9"/><rgb name="intensity" value="1"/></emitter>'
    session = open_session(make_scene(ball + lamp + SKY))
    photons = trace(session, 20_000)
    power = session.context.tables.light_power.astype(float).mean(axis=1)
    np.testing.assert_allclose(photons.flux.mean(axis=1), power.sum(), rtol=1e-5)


# --- Mitsuba's word ---


@pytest.mark.parametrize("indirect", ["path", "final_gather"])
def test_mitsuba_agrees(tmp_path: Path, open_session: Open, indirect: str) -> None:
    """A grey ball and a tilted plate over a floor under the sky: means of 4 x 4 blocks, pixels of all of them.

    4.5 standard errors from eight independent renderings each (Student's t: 8 at fourteen degrees of freedom is as
    rare); final gathering may lose 1.5 % to the edges of its density estimates.
    """
    mi: Any = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed; pip install mitsuba to compare")
    mi.set_variant("scalar_rgb")
    scene = (
        '<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="-1"/></integrator>'
        '<sensor type="perspective"><float name="fov" value="40"/>'
        f"{camera('2.5,-3,2', '0,0,0.3', '0,0,1')}"
        '<sampler type="independent"/><film type="hdrfilm"><integer name="width" value="16"/>'
        '<integer name="height" value="16"/><rfilter type="box"/></film></sensor>'
        f'<shape type="rectangle">{place(scale="2")}{diffuse("0.8 0.6 0.4")}</shape>'
        f'<shape type="sphere"><point name="center" value="0,0,0.5"/><float name="radius" value="0.5"/>'
        f"{diffuse('0.7')}</shape>"
        f'<shape type="cube">{place(scale="0.3", rotate="z 30", translate="1,-0.4,0.3")}'
        f"{diffuse('0.3 0.5 0.7')}</shape>{SKY}</scene>"
    )
    file = tmp_path / "sky.xml"
    file.write_text(scene)
    reference = mi.load_file(str(file))
    theirs = np.array([np.array(mi.render(reference, spp=48, seed=seed)) for seed in range(8)])
    settings = {"indirect": indirect, "samples_per_pixel": 16, "shadow_rays": 9, "gather_distance_m": 0.1,
                "global_photons": 50_000, "final_gather_rays": 36}  # fmt: skip
    ours = np.array([open_session(file, seed=seed, **settings).render().pixels for seed in range(8)])

    def blocks(pictures: Any) -> tuple[Any, Any]:
        means = pictures.reshape(8, 4, 4, 4, 4, 3).mean(axis=(2, 4))
        return means.mean(axis=0), means.std(axis=0, ddof=1) / math.sqrt(8)

    (mine, my_error), (other, other_error) = blocks(ours), blocks(theirs)
    error = np.hypot(my_error, other_error)
    assert np.all(error < 0.02 * other)
    allowed = 0.0 if indirect == "path" else 0.015
    assert np.all(np.abs(mine - other) <= 8 * error + (allowed + 1e-6) * other)
    assert abs(mine.mean() / other.mean() - 1) < 0.01
