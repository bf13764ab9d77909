"""Phong's glossy lobe: its reader, its sampler against the closed form, its energy, and the light it passes on.

    f(wi, wo) = albedo / pi + glossy (n + 2) / (2 pi) cos^n alpha,  alpha between wo and the mirror image of wi

Chi-square tests are two-sided at 2e-4; estimates are held to 4.5 standard errors (a false alarm in 150,000), which
are bounded themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.kernels.lobes import phong_bounce
from joulebox_render.kernels.rng import path_key
from joulebox_render.kernels.vector import reflected
from joulebox_render.records import BLACK, DIFFUSE, PHONG, Photons
from joulebox_render.stages import photon_map
from joulebox_render.stages.aim import aim_everywhere
from joulebox_render.stages.photon_map import BOUNCED, CAUSTIC, FIRST_HIT
from scene_files import bsdf, load, message
from scipy import stats

SIGMAS = 4.5
ALPHA = 2e-4
UP = (0.0, 0.0, 1.0)
Make = Callable[..., Path]
Open = Callable[..., Any]
Render = Callable[..., Any]
Z = Callable[[Any, float], float]


# --- the reader ---


def phong(diffuse: str = "0.3 0.5 0.2", glossy: str = "0.6 0.3 0.1", exponent: float = 20) -> str:
    return (
        f'<bsdf type="phong"><rgb name="diffuse_reflectance" value="{diffuse}"/>'
        f'<rgb name="specular_reflectance" value="{glossy}"/><float name="exponent" value="{exponent}"/></bsdf>'
    )


@pytest.mark.parametrize(
    ("text", "kind", "albedo", "glossy", "exponent", "two_sided"),
    [
        ('<bsdf type="phong"/>', PHONG, [0.5] * 3, [0.2] * 3, 30, 0),
        (phong(), PHONG, [0.3, 0.5, 0.2], [0.6, 0.3, 0.1], 20, 0),
        (phong("0", "1", 0), PHONG, [0] * 3, [1] * 3, 0, 0),
        (phong("0.5", "0"), DIFFUSE, [0.5] * 3, [0] * 3, 0, 0),
        (phong("0", "0"), BLACK, [0] * 3, [0] * 3, 0, 0),
        (f'<bsdf type="twosided">{phong()}</bsdf>', PHONG, [0.3, 0.5, 0.2], [0.6, 0.3, 0.1], 20, 1),
    ],
)
def test_reading(
    tmp_path: Path, text: str, kind: int, albedo: Any, glossy: Any, exponent: float, two_sided: int
) -> None:
    found = load(tmp_path, f'<shape type="rectangle">{text}</shape>').materials
    assert (found.kind.tolist(), found.two_sided.tolist()) == ([kind], [two_sided])
    np.testing.assert_allclose(found.albedo[0], albedo, rtol=1e-6)
    np.testing.assert_allclose(found.glossy[0], glossy, rtol=1e-6)
    assert found.exponent.tolist() == [exponent]


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ('<rgb name="specular_reflectance" value="0.2 0.6 0.2"/>', ["phong reflects 1.1", "at most 1"]),
        ('<rgb name="diffuse_reflectance" value="1 0 0"/>', ["phong reflects 1.2", "add up"]),
        ('<rgb name="diffuse_reflectance" value="1.5 0 0"/>', ["from 0 to 1"]),
        ('<float name="exponent" value="-1"/>', ['"exponent" is -1', "at least 0"]),
        ('<float name="exponent" value="2e5"/>', ['"exponent" is 200000', "at most 100000"]),
        ('<float name="exponent" value="nan"/>', ["not a finite number"]),
        ('<float name="alpha" value="1"/>', ['"alpha"', "exponent"]),
    ],
)
def test_refusals(tmp_path: Path, inside: str, words: list[str]) -> None:
    said = message(tmp_path, bsdf(inside, "phong"))
    assert "line 5" in said
    for word in words:
        assert word in said


def test_twosided_takes_one_diffuse_or_phong(tmp_path: Path) -> None:
    assert "diffuse or phong" in message(tmp_path, bsdf('<bsdf type="conductor"/>', "twosided"))


# --- the sampler ---


def going(angle_deg: float) -> tuple[float, float, float]:
    """A direction of travel that comes down on z = 0 at an angle from the normal."""
    angle = math.radians(angle_deg)
    return math.sin(angle), 0.0, -math.cos(angle)


def bounces(exponent: float, angle_deg: float, numbers: Any) -> tuple[Any, Any]:
    """Directions (N, 3) and scales (N,) that the kernel makes of numbers (N, 2)."""
    found = np.array([phong_bounce(exponent, *going(angle_deg), *UP, *UP, float(u), float(v)) for u, v in numbers])
    return found[:, :3], found[:, 3]


def lobe(exponent: float, direction: Any, angle_deg: float) -> Any:
    """glossy part of f for glossy = 1, light going at `angle_deg` and leaving along `direction`."""
    mirror = np.array(going(angle_deg)) * (1, 1, -1)
    cosine = np.maximum(0.0, np.asarray(direction) @ mirror)
    return (exponent + 2) / (2 * math.pi) * cosine**exponent


def directional_albedo(exponent: float, cosine: float) -> float:
    """Share of the light from one direction that the lobe reflects: midpoint sums over the hemisphere."""
    z, phi = np.meshgrid((np.arange(2000) + 0.5) / 2000, (np.arange(1000) + 0.5) / 1000 * math.pi, indexing="ij")
    mirror = z * cosine + np.sqrt(1 - z * z) * math.sqrt(1 - cosine * cosine) * np.cos(phi)
    values = (exponent + 2) / (2 * math.pi) * np.where(mirror > 0, np.maximum(0, mirror) ** exponent, 0) * z
    return float(values.mean() * 2 * math.pi)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 10.0, 100.0, 1e5])
@pytest.mark.parametrize("angle_deg", [0, 40, 85])
def test_the_lobe_has_its_density(exponent: float, angle_deg: float) -> None:
    """cos^(n + 1) alpha is uniform, and so is the angle around the mirror direction."""
    numbers = np.random.default_rng(4).random((20_000, 2))
    direction, _ = bounces(exponent, angle_deg, numbers)
    mirror = np.array(going(angle_deg)) * (1, 1, -1)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-6)
    across = np.array([0.0, 1.0, 0.0])
    x, y = direction @ np.cross(across, mirror), direction @ across
    # From the sine, which keeps the digits of narrow lobes.
    cosine2 = np.maximum(0, 1 - x * x - y * y)
    uniform = cosine2 ** ((exponent + 1) / 2)
    turn = (np.arctan2(y, x) / (2 * math.pi)) % 1
    counts = np.histogram2d(uniform, turn, bins=12, range=[(0, 1)] * 2)[0]
    p = stats.chisquare(counts.ravel()).pvalue
    assert ALPHA / 2 < p < 1 - ALPHA / 2


@pytest.mark.parametrize("exponent", [0.0, 1.0, 10.0, 100.0])
@pytest.mark.parametrize("angle_deg", [0, 40, 85])
def test_weights_times_density_are_the_closed_form(exponent: float, angle_deg: float) -> None:
    """scale x (n + 1) / (2 pi) cos^n alpha = f cos theta, and nothing below the surface."""
    numbers = np.random.default_rng(5).random((2000, 2))
    direction, scale = bounces(exponent, angle_deg, numbers)
    mirror = np.array(going(angle_deg)) * (1, 1, -1)
    density = (exponent + 1) / (2 * math.pi) * np.maximum(0, direction @ mirror) ** exponent
    expected = lobe(exponent, direction, angle_deg) * np.maximum(0, direction[:, 2])
    np.testing.assert_allclose(scale * density, expected, rtol=1e-5, atol=1e-12)
    assert (scale == 0).any() == (angle_deg > 0 and (direction[:, 2] <= 0).any())


def test_a_direction_under_the_real_surface_is_not_taken() -> None:
    """An interpolated normal's lobe may dip under the geometric one."""
    tilted = (math.sin(0.5), 0.0, math.cos(0.5))
    numbers = np.random.default_rng(6).random((500, 2))
    found = np.array([phong_bounce(5.0, *going(70), *UP, *tilted, float(u), float(v)) for u, v in numbers])
    assert np.all((found[:, 3] > 0) == ((found[:, 2] > 0) & (found[:, :3] @ tilted > 0)))
    assert (found[:, 3] == 0).any()


def test_reciprocity() -> None:
    """f(wi, wo) = f(wo, wi), f being the sampler's own weight x density / cos."""
    random = np.random.default_rng(7)
    for _ in range(200):
        exponent = float(random.choice([0.5, 3, 40]))
        angle_deg = float(random.uniform(0, 80))
        direction, scale = (column[0] for column in bounces(exponent, angle_deg, random.random((1, 2))))
        if scale == 0:
            continue
        mirror = np.array(going(angle_deg)) * (1, 1, -1)
        there = scale * (exponent + 1) / (2 * math.pi) * (direction @ mirror) ** exponent / direction[2]
        # The way back: light arrives along -direction and leaves towards where it came from.
        back_mirror = np.array(reflected(*(-direction), *UP))
        leaving = -np.array(going(angle_deg))
        back = (exponent + 2) / (2 * math.pi) * max(0.0, leaving @ back_mirror) ** exponent
        assert back == pytest.approx(there, rel=1e-5)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 10.0, 100.0, 1000.0])
def test_no_more_leaves_than_arrives(exponent: float) -> None:
    """The lobe's mean scale over its own distribution is the directional albedo, at most 1, and 1 head on."""
    u, v = np.meshgrid((np.arange(60) + 0.5) / 60, (np.arange(60) + 0.5) / 60)
    numbers = np.stack([u.ravel(), v.ravel()], -1)
    for angle_deg in (0, 20, 50, 80, 89):
        mean = bounces(exponent, angle_deg, numbers)[1].mean()
        assert mean <= 1 + 1e-3
        if exponent < 1000:
            assert mean == pytest.approx(directional_albedo(exponent, math.cos(math.radians(angle_deg))), abs=0.005)
    assert bounces(exponent, 0, numbers)[1].mean() == pytest.approx(1, abs=1e-3)


# --- light ---


@pytest.mark.parametrize("exponent", [1, 10, 100])
@pytest.mark.parametrize("angle_deg", [10, 75])
@pytest.mark.parametrize("indirect", ["path", "final_gather"])
def test_the_white_furnace(
    make_scene: Make, render: Render, z_score: Z, exponent: float, angle_deg: float, indirect: str
) -> None:
    """Under a sky of radiance 1 a plate shows albedo + glossy x directional albedo, by numerical integration."""
    plate = f'<shape type="rectangle">{phong(exponent=exponent)}</shape>'
    x, z = 5 * math.sin(math.radians(angle_deg)), 5 * math.cos(math.radians(angle_deg))
    camera = f'<transform name="to_world"><lookat origin="{x},0,{z}" target="0,0,0" up="0,1,0"/></transform>'
    scene = make_scene(plate + '<emitter type="constant"/>', camera=camera, fov_deg=0.5)
    settings = {"indirect": indirect, "global_photons": 2000, "caustic_photons": 2000, "final_gather_rays": 4}
    pixels = render(scene, width=24, height=24, shadow_rays=4, **settings).pixels
    share = directional_albedo(exponent, math.cos(math.radians(angle_deg)))
    for channel, (diffuse, glossy) in enumerate(zip((0.3, 0.5, 0.2), (0.6, 0.3, 0.1), strict=True)):
        shown = pixels[..., channel]
        assert shown.std() / 24 < 0.003
        assert abs(z_score(shown, diffuse + glossy * share)) < SIGMAS


ROOM = (
    '<shape type="sphere"><boolean name="flip_normals" value="true"/><bsdf type="diffuse">'
    '<rgb name="reflectance" value="0.4"/></bsdf></shape>'
)
POINT = '<emitter type="point"><rgb name="intensity" value="3 2 1"/></emitter>'


def trace(session: Any, count: int) -> Photons:
    tables = session.context.tables
    family = np.uint64(path_key(3, photon_map.EMISSION_STREAM, photon_map.EVERYWHERE))
    return photon_map.trace_photons(session.context, aim_everywhere(tables), family, 0, count)


@pytest.mark.parametrize("exponent", [1, 30])
@pytest.mark.parametrize("sampler", ["independent", "sobol"])
def test_the_ledger_of_photons(make_scene: Make, open_session: Open, z_score: Z, exponent: float, sampler: str) -> None:
    """Half the photons meet a wide Phong plate close to the lamp, uniformly in cos theta; what it passes on arrives.

    BOUNCED photons carry its albedo, CAUSTIC ones glossy x directional albedo. A lobe of exponent 1 reflects more
    than arrives into some directions: there the flux takes the excess, and the ledger still holds. The plate's shade
    on the room is left out by looking at what comes from it alone.
    """
    count = 40_000
    plate = (
        '<shape type="disk"><transform name="to_world"><scale value="0.5"/><translate value="0,0,-0.001"/></transform>'
        + phong("0.3 0.5 0.2", "0.6 0.3 0.1", exponent)
        + "</shape>"
    )
    photons = trace(open_session(make_scene(ROOM + plate + POINT), max_photon_bounces=1, sampler=sampler), count)
    radius = np.linalg.norm(photons.position, axis=1)
    at_room = radius > 0.99
    assert np.all(photons.history[~at_room & (photons.history != BOUNCED)] == FIRST_HIT)
    share = (1 - 0.001 / math.hypot(0.5, 0.001)) / 2
    cosines = (np.arange(40) + 0.5) / 40
    glossy_share = np.mean([directional_albedo(exponent, cosine) for cosine in cosines])
    from_plate = np.isin(photons.number, photons.number[(photons.history == FIRST_HIT) & ~at_room])
    assert abs(from_plate[photons.history == CAUSTIC].mean() - 1) < 1e-9
    for channel, (diffuse, glossy) in enumerate(zip((0.3, 0.5, 0.2), (0.6, 0.3, 0.1), strict=True)):
        power = 4 * math.pi * (3, 2, 1)[channel] * share
        for history, expected in ((CAUSTIC, glossy * glossy_share), (BOUNCED, diffuse)):
            chosen = at_room & from_plate & (photons.history == history)
            flux = np.bincount(photons.number[chosen], photons.flux[chosen, channel], count)
            assert flux.std() / math.sqrt(count) < 0.02 * power
            assert abs(z_score(flux, power * expected)) < SIGMAS
    first = photons.flux[photons.history == FIRST_HIT].sum(axis=0, dtype=float) / count
    np.testing.assert_allclose(first, 4 * math.pi * np.array([3, 2, 1.0]), rtol=1e-4)


def test_storing_where_absorbed_keeps_the_flux(make_scene: Make, open_session: Open) -> None:
    """A Phong room around the lamp: per wall and channel the same irradiance, with one photon an emission."""
    room = ROOM.replace('<bsdf type="diffuse"><rgb name="reflectance" value="0.4"/></bsdf>', phong(exponent=5))
    assert "phong" in room
    count = 20_000
    totals, errors = [], []
    for every in (True, False):
        photons = trace(open_session(make_scene(room + POINT), store_at_every_bounce=every), count)
        flux = np.stack([np.bincount(photons.number, photons.flux[:, c], count) for c in range(3)], -1)
        totals.append(flux.mean(axis=0))
        errors.append(flux.std(axis=0) / math.sqrt(count))
    error = np.hypot(*errors)
    assert np.all(error < 0.04 * totals[0])
    assert np.all(np.abs(totals[0] - totals[1]) < SIGMAS * error)


def test_final_gathering_agrees_with_paths(make_scene: Make, open_session: Open) -> None:
    """A glossy ball in a lit room, seen by both methods: the means of each half of the picture.

    Density estimates in a ball are unbiased (Archimedes; the room is one), the plate under the ball loses at its rim:
    1.5 % are allowed for it beside 4.5 standard errors over six seeds.
    """
    things = (
        ROOM
        + f'<shape type="sphere"><point name="center" value="0.1,0,-0.6"/><float name="radius" value="0.2"/>{phong()}'
        "</shape>"
        '<shape type="disk"><transform name="to_world"><scale value="0.2"/><rotate x="1" angle="90"/>'
        '<translate value="0,0.9,-0.2"/></transform><emitter type="area"><rgb name="radiance" value="9"/></emitter>'
        "</shape>"
    )
    scene = make_scene(things, fov_deg=50)
    means = {}
    for indirect in ("path", "final_gather"):
        settings = {"indirect": indirect, "global_photons": 20_000, "caustic_photons": 10_000, "width": 24,
                    "height": 24, "gather_distance_m": 0.1, "caustic_gather_distance_m": 0.1}  # fmt: skip
        pictures = [open_session(scene, seed=seed, **settings).render().pixels for seed in range(6)]
        middle = np.array([[p[8:16, 8:16].mean(), p[:, :6].mean(), p[:, 18:].mean()] for p in pictures])
        means[indirect] = (middle.mean(axis=0), middle.std(axis=0, ddof=1) / math.sqrt(6))
    (path, path_error), (gathered, gather_error) = means["path"], means["final_gather"]
    error = np.hypot(path_error, gather_error)
    assert np.all(error < 0.02 * path), error / path
    assert np.all(np.abs(path - gathered) < 0.015 * path + SIGMAS * error), (path, gathered, error)
