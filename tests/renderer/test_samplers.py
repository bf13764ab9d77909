"""Samples of lights and photons that leave them: chi-square tests against their density (sampler_checks)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from joulebox_render.kernels.emission import emit_photons
from joulebox_render.kernels.lighting import shadow_rays
from joulebox_render.kernels.rng import path_key
from joulebox_render.kernels.vector import tangent_frame
from joulebox_render.records import POINT_LIGHT, Rays, ShadowRays
from joulebox_render.scene import load_scene
from joulebox_render.stages.aim import aim_everywhere
from joulebox_render.tables import SceneTables, scene_tables
from sampler_checks import INDEPENDENT, assert_fits, binned, cosine_cells, points_at

FLOOR = '<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform></shape>'
POINT = (
    '<emitter type="point"><point name="position" value="0.2,0.1,1"/><rgb name="intensity" value="3 2 1"/></emitter>'
)
SPOT = (
    '<emitter type="spot"><float name="cutoff_angle" value="40"/><float name="beam_width" value="20"/>'
    '<rgb name="intensity" value="3 2 1"/><transform name="to_world">'
    '<lookat origin="0,0,1" target="0.3,0.1,0" up="0,1,0"/></transform></emitter>'
)
EMITTER = '<emitter type="area"><rgb name="radiance" value="3 2 1"/></emitter>'
TILTED = '<rotate x="0.8" y="0.6" angle="160"/><translate value="0.3,-0.2,1"/>'
RECTANGLE = (
    f'<shape type="rectangle"><transform name="to_world"><scale x="0.4" y="0.2" z="1"/>{TILTED}</transform>'
    f"{EMITTER}</shape>"
)
DISK = f'<shape type="disk"><transform name="to_world"><scale value="0.3"/>{TILTED}</transform>{EMITTER}</shape>'
SPHERE = (
    f'<shape type="sphere"><point name="center" value="0.3,-0.2,1"/><float name="radius" value="0.3"/>{EMITTER}</shape>'
)
CUBE = (
    '<shape type="cube"><transform name="to_world"><scale x="0.1" y="0.2" z="0.3"/><translate value="0,0,1"/>'
    f"</transform>{EMITTER}</shape>"
)


@pytest.fixture
def tables_of(make_scene: Callable[..., Any]) -> Callable[[str], SceneTables]:
    """Tables of a floor at z = 0 and the lights given."""
    return lambda body: scene_tables(load_scene(make_scene(FLOOR + body)))


def sampled_light(tables: SceneTables, count: int = 40_000) -> tuple[Any, Any, Any]:
    """Directions, distances and values of shadow rays from the floor's origin to light 0."""
    points = points_at((0, 0, 1e-5), (0, 0, 1))
    rays = ShadowRays.empty(count)
    written = shadow_rays(tables, 0, count, INDEPENDENT, points, 0, 1, rays)
    found = rays.direction[:written].astype(np.float64)
    value = rays.weight[:written, None].astype(np.float64) * tables.light_radiance[0] * count
    return found, rays.limit[:written] / (1 - 1e-4), value


def test_a_rectangle_light_is_sampled_uniformly_by_area(tables_of: Callable[[str], SceneTables]) -> None:
    tables = tables_of(RECTANGLE)
    directions, distances, _ = sampled_light(tables)
    assert len(directions) == 40_000
    across = directions * distances[:, None] + (0, 0, 1e-5) - tables.light_position[0]
    np.testing.assert_allclose(across @ tables.light_normal[0], 0, atol=1e-5)
    edges = [tables.light_edge_u[0], tables.light_edge_v[0]]
    assert_fits(binned(12, *((across @ edge / (edge @ edge) + 1) / 2 for edge in edges)))


def test_a_disk_light_is_sampled_uniformly_by_area(tables_of: Callable[[str], SceneTables]) -> None:
    tables = tables_of(DISK)
    directions, distances, _ = sampled_light(tables)
    across = directions * distances[:, None] + (0, 0, 1e-5) - tables.light_position[0]
    np.testing.assert_allclose(across @ tables.light_normal[0], 0, atol=1e-5)
    u, v = (across @ edge / (edge @ edge) for edge in (tables.light_edge_u[0], tables.light_edge_v[0]))
    assert_fits(binned(12, np.minimum(u * u + v * v, 1), (np.arctan2(v, u) / (2 * math.pi)) % 1.0))


@pytest.mark.parametrize("radius", [0.3, 0.9, 0.001])
def test_a_sphere_light_is_sampled_uniformly_in_its_cone(
    tables_of: Callable[[str], SceneTables], radius: float
) -> None:
    tables = tables_of(SPHERE.replace('value="0.3"', f'value="{radius}"'))
    directions, distances, _ = sampled_light(tables)
    centre = tables.light_position[0].astype(np.float64) - (0, 0, 1e-5)
    ends = directions * distances[:, None] - centre
    # Shadow rays end 1e-4 of their length before the light; single precision must stay within that.
    np.testing.assert_allclose(np.linalg.norm(ends, axis=1), radius, atol=1e-4)
    axis = centre / np.linalg.norm(centre)
    spread = 1 - math.sqrt(1 - radius**2 / (centre @ centre))
    s, t = (np.array(frame) for frame in np.split(np.array(tangent_frame(*axis)), 2))
    # 1 - cos theta from the sine, which single precision keeps for small cones.
    sine2 = (directions @ s) ** 2 + (directions @ t) ** 2
    polar = sine2 / (1 + np.sqrt(1 - sine2)) / spread
    whole = directions @ np.array([0, 0, 1]) > 0
    assert whole.all()
    assert_fits(binned(12, np.clip(polar, 0, 1), (np.arctan2(directions @ t, directions @ s) / (2 * math.pi)) % 1))


def test_a_mesh_light_is_sampled_uniformly_by_area(tables_of: Callable[[str], SceneTables]) -> None:
    """Where photons leave a cube of six different areas, by triangle and within the triangles."""
    tables = tables_of(CUBE)
    origin, _, _ = emitted(tables)
    first, count = tables.light_triangle_first[0], tables.light_triangle_count[0]
    corners = tables.vertices[tables.triangles[first : first + count]].astype(np.float64)
    a, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(b, c)
    area2 = np.einsum("ij,ij->i", normal, normal)
    offset = origin[:, None, :] - a
    height = np.einsum("nti,ti->nt", offset, normal) / np.sqrt(area2)
    v = np.einsum("nti,ti->nt", np.cross(b, offset), normal) / area2
    u = np.einsum("nti,ti->nt", np.cross(offset, c), normal) / area2
    inside = (np.abs(height) < 1e-4) & (u >= -1e-5) & (v >= -1e-5) & (u + v <= 1 + 1e-5)
    triangle = inside.argmax(axis=1)
    assert inside.any(axis=1).all()
    assert_fits(np.bincount(triangle, minlength=count), np.sqrt(area2))
    rows = np.arange(len(origin))
    chosen_u, chosen_v = u[rows, triangle].clip(0, 1), v[rows, triangle].clip(0, 1)
    # 1 - (1 - u)^2 and v / (1 - u) are uniform and independent in a triangle.
    assert_fits(binned(10, 1 - (1 - chosen_u) ** 2, (chosen_v / np.maximum(1 - chosen_u, 1e-9)).clip(0, 1)))


@pytest.mark.parametrize("light", [RECTANGLE, DISK, SPHERE, CUBE], ids=["rectangle", "disk", "sphere", "mesh"])
def test_directions_towards_a_light_have_the_density_they_are_weighted_with(
    tables_of: Callable[[str], SceneTables], z_score: Callable[[Any, float], float], light: str
) -> None:
    """Sum of sample / density over the light's solid angle, by uniform directions instead: |z| < 4.5 (1 in 150,000).

    The second estimate shoots uniform directions at the light; it shares nothing with the first but the geometry.
    """
    from joulebox_render.intersect import Intersector

    tables = tables_of(light)
    count = 40_000
    _, _, value = sampled_light(tables, count)
    values = np.concatenate([value[:, 0], np.zeros(count - len(value))])
    random = np.random.default_rng(5)
    z, phi = random.random(4 * count), 2 * math.pi * random.random(4 * count)
    r = np.sqrt(1 - z * z)
    direction = np.stack([r * np.cos(phi), r * np.sin(phi), z], -1).astype(np.float32)
    origin = np.tile(np.array([0, 0, 1e-5], np.float32), (len(direction), 1))
    hits = Intersector(tables).closest(origin, direction)
    seen = (hits.primitive >= 0) & (tables.light[hits.primitive] == 0)
    front = np.ones(len(seen))
    if light in (RECTANGLE, DISK):
        front = direction @ tables.light_normal[0] < 0
    other = np.where(seen, front, 0) * z * tables.light_radiance[0, 0] / math.pi * 2 * math.pi
    if light == CUBE:
        # Samples on the cube's far faces are not even written: they face away.
        assert len(value) < count
    difference = values.mean() - other.mean()
    error = math.hypot(values.std() / math.sqrt(len(values)), other.std() / math.sqrt(len(other)))
    assert abs(difference) < 4.5 * error
    assert error < 0.03 * other.mean()


def emitted(tables: SceneTables, count: int = 40_000, seed: int = 3) -> tuple[Any, Any, Any]:
    """Origins, directions and fluxes of photons."""
    rays = Rays.empty(count)
    emit_photons(tables, aim_everywhere(tables), False, np.uint64(path_key(seed, 2, 0)), 0, rays)
    return tuple(column.astype(np.float64) for column in rays[:3])


def test_a_point_light_emits_uniformly(tables_of: Callable[[str], SceneTables]) -> None:
    tables = tables_of(POINT)
    origin, direction, flux = emitted(tables)
    np.testing.assert_allclose(origin, np.tile([0.2, 0.1, 1.0], (len(origin), 1)), atol=1e-6)
    np.testing.assert_allclose(flux, np.tile(4 * math.pi * np.array([3, 2, 1]), (len(flux), 1)), rtol=1e-5)
    x, y, z = direction.T
    assert_fits(binned(12, (z + 1) / 2, (np.arctan2(y, x) / (2 * math.pi)) % 1.0))


def test_a_spot_light_emits_its_falloff(tables_of: Callable[[str], SceneTables]) -> None:
    """Directions are uniform in the cone, and the falloff is the chance that a photon leaves; all that do are equal.

    The mean flux of each of ten bands of angle is within 4.5 standard errors (1 in 15,000 for ten) of the integral
    of the falloff over the band.
    """
    tables = tables_of(SPOT)
    _, direction, flux = emitted(tables)
    axis = tables.light_normal[0].astype(np.float64)
    cosine = direction @ axis
    edges = np.linspace(math.cos(math.radians(40)), 1, 11)
    band = np.clip(np.digitize(cosine, edges) - 1, 0, 9)
    s, t = (np.array(frame) for frame in np.split(np.array(tangent_frame(*axis)), 2))
    azimuth = (np.arctan2(direction @ t, direction @ s) / (2 * math.pi)) % 1.0
    assert_fits(binned(10, (cosine - edges[0]) / (1 - edges[0]), azimuth))
    for row in range(10):
        cosines = np.linspace(edges[row], edges[row + 1], 2001)
        falloff = np.clip((40 - np.degrees(np.arccos(np.minimum(cosines, 1)))) / 20, 0, 1)
        expected = 3 * 2 * math.pi * np.trapezoid(falloff, cosines)
        share = np.where(band == row, flux[:, 0], 0)
        assert abs(share.mean() - expected) < 4.5 * share.std() / math.sqrt(len(share)) + 1e-6
    leaves = flux[:, 0] > 0
    np.testing.assert_allclose(flux[leaves], np.tile(flux[leaves][0], (leaves.sum(), 1)), rtol=1e-6)
    assert leaves[cosine > math.cos(math.radians(20)) + 1e-6].all()
    total = flux[:, 0]
    assert abs(total.mean() - tables.light_power[0, 0]) < 4.5 * total.std() / math.sqrt(len(total))


@pytest.mark.parametrize("light", [RECTANGLE, DISK], ids=["rectangle", "disk"])
def test_flat_lights_emit_by_cosine_from_everywhere_alike(tables_of: Callable[[str], SceneTables], light: str) -> None:
    tables = tables_of(light)
    origin, direction, flux = emitted(tables)
    np.testing.assert_allclose(flux, np.tile(tables.light_power[0], (len(flux), 1)), rtol=1e-5)
    normals = np.tile(tables.light_normal[0].astype(np.float64), (len(origin), 1))
    assert_fits(binned(12, *cosine_cells(direction, normals)))
    across = origin - tables.light_position[0]
    u, v = (across @ edge / (edge @ edge) for edge in (tables.light_edge_u[0], tables.light_edge_v[0]))
    if light == RECTANGLE:
        place = ((u + 1) / 2, (v + 1) / 2)
    else:
        place = (np.minimum(u * u + v * v, 1), (np.arctan2(v, u) / (2 * math.pi)) % 1.0)
    assert_fits(binned(12, *place))
    # Where and whither are independent of each other.
    assert_fits(binned(6, place[0], cosine_cells(direction, normals)[0], cosine_cells(direction, normals)[1]))


@pytest.mark.parametrize("flip", [False, True], ids=["outwards", "inwards"])
def test_a_sphere_light_emits_by_cosine_from_everywhere_alike(
    tables_of: Callable[[str], SceneTables], flip: bool
) -> None:
    flipped = '<boolean name="flip_normals" value="true"/><emitter' if flip else "<emitter"
    tables = tables_of(SPHERE.replace("<emitter", flipped))
    origin, direction, _ = emitted(tables)
    outwards = (origin - tables.light_position[0].astype(np.float64)) / 0.3
    lengths = np.linalg.norm(outwards, axis=1, keepdims=True)
    np.testing.assert_allclose(lengths, 1, atol=1e-3)
    outwards /= lengths
    assert_fits(binned(12, (outwards[:, 2] + 1) / 2, (np.arctan2(outwards[:, 1], outwards[:, 0]) / (2 * math.pi)) % 1))
    assert_fits(binned(12, *cosine_cells(direction, -outwards if flip else outwards)))


def test_lights_are_chosen_in_proportion_to_their_power(tables_of: Callable[[str], SceneTables]) -> None:
    """Photons of all lights carry equal power, and each light's photons are as many as its share."""
    strong = POINT.replace("0.2,0.1,1", "-1,0,1").replace("3 2 1", "9 6 3")
    tables = tables_of(POINT + strong + RECTANGLE)
    origin, _, flux = emitted(tables)
    power = tables.light_power.astype(np.float64).mean(axis=1)
    np.testing.assert_allclose(flux.mean(axis=1), power.sum(), rtol=1e-5)
    points = tables.light_kind == POINT_LIGHT
    at_light = np.linalg.norm(origin[:, None, :] - tables.light_position, axis=2) < 1e-6
    counts = np.where(points, at_light.sum(axis=0), 0)
    assert_fits(np.where(points, counts, len(origin) - counts.sum()), power)


@pytest.mark.parametrize("sobol", [False, True])
def test_photons_do_not_depend_on_who_asks_for_them(tables_of: Callable[[str], SceneTables], sobol: bool) -> None:
    """Photon number n is the same in any batch."""
    tables = tables_of(RECTANGLE + POINT)
    family = np.uint64(path_key(9, 2, 0))
    whole, part = Rays.empty(100), Rays.empty(37)
    emit_photons(tables, aim_everywhere(tables), sobol, family, 0, whole)
    emit_photons(tables, aim_everywhere(tables), sobol, family, 41, part)
    for all_, some in zip(whole, part, strict=True):
        np.testing.assert_array_equal(all_[41:78], some)
