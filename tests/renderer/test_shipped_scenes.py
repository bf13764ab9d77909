"""What the shipped scenes claim in their READMEs: their -D names, their measures, and what closes them off.

Measures are exact but for single precision: 1e-6 m in rooms of half a metre. Rays that must be blocked are drawn at
random, 20,000 each; a hole that one ray in 3,000 finds escapes such a test with a probability of 0.13 %.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from joulebox_render.intersect import Intersector
from joulebox_render.records import Scene
from joulebox_render.scene import list_scenes, load_scene
from joulebox_render.tables import scene_tables
from scene_files import refused

F8 = npt.NDArray[np.float64]
HALF = 0.2775
"""Half the side of the Cornell box [m], and how deep below the origin its floor lies."""
TRIANGLES = (948, 3850, 16300, 69666)
HEIGHT = {"small": 0.15 * 0.555, "medium": 0.3 * 0.555, "large": 0.5 * 0.555}
RAYS = 20_000
MITSUBA_CANNOT = {"phong-spheres"}
"""Mitsuba 3 has no phong."""

# Values to try for every -D that a README documents.
TRIED = {
    "detail": [str(count) for count in TRIANGLES],
    "size": list(HEIGHT),
    "flat": ["true", "false"],
    "height": ["0.01", "0.4"],
    "radius": ["0.02", "0.145"],
    "ior": ["1.1", "2.4"],
    "intensity": ["0.1", "1 2 3"],
    "reflectance": ["0.9"],
    "radiance": ["3", "1 2 3"],
    "thickness": ["0.001", "0.03"],
    "opening": ["0", "20", "90"],
    "exponent": ["-4", "4"],
    "exponent_left": ["1", "1000"],
    "exponent_middle": ["1", "1000"],
    "exponent_right": ["1", "1000"],
    "diffuse": ["0", "0.1 0.2 0.3"],
    "specular": ["0", "0.3"],
}
# Names of <default>s that are not meant for -D: Mitsuba's own settings, and how a size becomes a height.
INNER = re.compile(r"spp|seed|(unless_|height.*\$).*")


def documented(folder: Path) -> list[str]:
    """The -D names of a scene's README."""
    return sorted(set(re.findall(r"-D (\w+)=", (folder / "README.md").read_text(encoding="utf-8"))))


def variants() -> list[Any]:
    """Every scene as it is, and with every documented -D."""
    found = [(entry.name, name, value) for entry in list_scenes() for name in documented(entry.path)
             for value in TRIED.get(name, ["no value to try"])]  # fmt: skip
    return [(entry.name, "", "") for entry in list_scenes()] + found


def name_of(variant: tuple[str, str, str]) -> str:
    scene, name, value = variant
    return f"{scene} {name}={value}" if name else scene


def rays(scene: Scene, origin: F8, target: F8) -> tuple[Any, Any, Any, Any]:
    """Intersector, origin and unit direction (N, 3) f4, and distance (N,) f4 from origins to targets."""
    away = target - origin
    distance = np.linalg.norm(away, axis=1)
    direction = np.ascontiguousarray(away / distance[:, None], dtype=np.float32)
    start = np.ascontiguousarray(origin, dtype=np.float32)
    return Intersector(scene_tables(scene)), start, direction, distance.astype(np.float32)


def blocked(scene: Scene, origin: F8, target: F8) -> npt.NDArray[np.bool_]:
    """(N,) whether anything lies between origin and target."""
    intersector, start, direction, distance = rays(scene, origin, target)
    return intersector.occluded(start, direction, distance).astype(bool)


def first_hit(scene: Scene, origin: F8, target: F8) -> F8:
    """(N, 3) where rays from origin through target hit first; infinite where they hit nothing."""
    intersector, start, direction, _ = rays(scene, origin, target)
    hits = intersector.closest(start, direction)
    reach = np.where(hits.primitive < 0, np.inf, hits.distance.astype(np.float64))
    return start.astype(np.float64) + reach[:, None] * direction.astype(np.float64)


def within(low: tuple[float, ...], high: tuple[float, ...], seed: int) -> F8:
    """(RAYS, 3) points at random in a box."""
    return np.random.default_rng(seed).uniform(low, high, (RAYS, 3))


def below_lamp(scene: Scene) -> F8:
    """(RAYS, 3) points 1 mm below a rectangular lamp, so that its own plane blocks nothing."""
    center, half_u, half_v = (
        getattr(scene.lights, field)[0].astype(np.float64) for field in ("position", "edge_u", "edge_v")
    )
    place = np.random.default_rng(4).uniform(-1.0, 1.0, (2, RAYS, 1))
    lamp: F8 = center + place[0] * half_u + place[1] * half_v - [0.0, 1e-3, 0.0]
    return lamp


def bunny(**defines: str) -> tuple[F8, npt.NDArray[np.int32]]:
    """Vertices (V, 3) and triangles (T, 3) of the bunny, which stands last in its scene."""
    scene = load_scene("cornell-bunny", defines)
    first = 12  # of the box and the lamp: six rectangles
    used, corners = np.unique(scene.triangles[first:], return_inverse=True)
    return scene.vertices[used].astype(np.float64), corners.reshape(-1, 3).astype(np.int32)


# --- what can be given by -D ---


@pytest.mark.parametrize("name", [entry.name for entry in list_scenes()])
def test_readme_documents_every_define(name: str) -> None:
    """In both directions: what the file has, the README names, and the other way round."""
    folder = next(entry.path for entry in list_scenes() if entry.name == name)
    defaults = re.findall(r'<default name="([^"]+)"', (folder / "scene.xml").read_text(encoding="utf-8"))
    assert documented(folder) == sorted({given for given in defaults if not INNER.fullmatch(given)})


@pytest.mark.parametrize("variant", variants(), ids=name_of)
def test_every_define_loads_here_and_in_mitsuba(variant: tuple[str, str, str]) -> None:
    """Both readers find as many triangles of the same area (Mitsuba sums it in float32), and as many other shapes."""
    name, define, value = variant
    defines = {define: value} if define else {}
    scene = load_scene(name, defines)
    if name in MITSUBA_CANNOT:
        return
    mi: Any = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed; pip install mitsuba to compare")
    mi.set_variant("scalar_rgb")
    theirs = mi.load_file(str(scene.folder / "scene.xml"), **defines).shapes()
    meshes = [shape for shape in theirs if shape.is_mesh()]
    # Mitsuba counts rectangles as meshes too, and merges meshes of one bsdf.
    assert len(scene.triangles) == sum(mesh.face_count() for mesh in meshes)
    assert len(scene.analytic_kind) == len(theirs) - len(meshes)
    a, b, c = (scene.vertices[scene.triangles[:, i]].astype(np.float64) for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0
    assert area == pytest.approx(sum(float(mesh.surface_area()) for mesh in meshes), rel=1e-4)


def test_a_detail_or_size_that_there_is_not() -> None:
    assert 'there is no file "bunny-5.ply"' in refused("cornell-bunny", detail="5")
    text = refused("cornell-bunny", size="huge")
    assert "size=huge" in text
    assert "small|medium|large" in text


# --- the bunny ---


@pytest.mark.parametrize("detail", TRIANGLES)
def test_bunny_has_as_many_triangles_as_it_says_and_is_closed(detail: int) -> None:
    """Every edge belongs to two triangles that run along it in opposite directions, and the volume is positive."""
    vertices, triangles = bunny(detail=str(detail))
    assert len(triangles) == detail
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == 3 * detail
    np.testing.assert_array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    volume = np.einsum("tx,tx->", a, np.cross(b, c)) / 6.0
    # 0.2053 of the height cubed for the finest; decimation to 948 triangles takes 0.9 % off.
    assert volume / HEIGHT["medium"] ** 3 == pytest.approx(0.2053, rel=0.015)


@pytest.mark.parametrize("detail", TRIANGLES)
@pytest.mark.parametrize("size", HEIGHT)
def test_bunny_is_as_high_as_its_size_says_and_stands_on_the_floor(size: str, detail: int) -> None:
    vertices, _ = bunny(size=size, detail=str(detail))
    assert vertices[:, 1].min() == pytest.approx(-HALF, abs=1e-6)
    assert vertices[:, 1].min() >= np.float32(-HALF), "no part of it is below the floor"
    assert np.ptp(vertices[:, 1]) == pytest.approx(HEIGHT[size], rel=1e-5)
    assert np.abs(vertices[:, [0, 2]]).max() < HALF - 0.05, "it keeps clear of the walls"


def test_bunny_of_any_height() -> None:
    vertices, _ = bunny(height="0.4", detail="948")
    assert np.ptp(vertices[:, 1]) == pytest.approx(0.4, rel=1e-5)
    assert np.abs(vertices).max() <= np.float32(HALF)


# --- spheres ---


@pytest.mark.parametrize("radius", [0.02, 0.10545, 0.145])
def test_cornell_spheres_stay_on_the_floor_and_apart(radius: float) -> None:
    scene = load_scene("cornell-spheres", {"radius": str(radius)})
    center = scene.analytic_center.astype(np.float64)
    np.testing.assert_allclose(scene.analytic_radius, radius, rtol=1e-6)
    np.testing.assert_allclose(center[:, 1] - radius, -HALF, atol=1e-6)
    assert np.linalg.norm(center[0] - center[1]) > 2 * radius
    assert (np.abs(center[:, [0, 2]]) + radius).max() < HALF


def test_phong_spheres_stand_on_the_floor_and_apart() -> None:
    scene = load_scene("phong-spheres")
    center, radius = scene.analytic_center.astype(np.float64), 0.08
    np.testing.assert_allclose(center[:, 1] - radius, -HALF, atol=1e-6)
    between = np.linalg.norm(center[:, None] - center[None], axis=2)[np.triu_indices(3, 1)]
    assert between.min() > 2 * radius


# --- rooms ---


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("furnace", (-0.49, -0.49, -0.49), (0.49, 0.49, 0.49)),
        ("veach-door", (-0.29, 0.01, -0.59), (0.29, 0.35, 0.34)),
    ],
)
def test_closed_rooms_are_closed(name: str, low: tuple[float, ...], high: tuple[float, ...]) -> None:
    """No ray from inside gets out."""
    hit = first_hit(load_scene(name), within(low, high, 1), within(low, high, 2))
    assert np.isfinite(hit).all()


@pytest.mark.parametrize("opening", ["0", "50", "90"])
def test_nothing_in_the_near_room_sees_the_lamp_behind_the_door(opening: str) -> None:
    """From all of the near room to all of the lamp."""
    scene = load_scene("veach-door", {"opening": opening})
    near = within((-0.3, 0.0, -0.25), (0.3, 0.36, 0.35), 3)
    assert blocked(scene, near, below_lamp(scene)).all()


def test_the_door_is_ajar() -> None:
    """It stands in the near room, and some sight lines lead past it, fewer than when it is wide open."""
    scene = load_scene("veach-door")
    paint = np.isclose(scene.materials.albedo[:, 2], 0.55)[scene.material[: len(scene.triangles)]]
    door = scene.vertices[scene.triangles[paint]].reshape(-1, 3)
    assert door[:, 2].min() > -0.2501
    assert door[:, 2].max() == pytest.approx(-0.25 + 0.138 * math.sin(math.radians(50)), abs=0.008)
    near, far = within((-0.3, 0.0, -0.25), (0.3, 0.36, 0.35), 5), within((-0.3, 0.0, -0.6), (0.3, 0.36, -0.3), 6)
    open_share = {
        opening: 1.0 - blocked(load_scene("veach-door", {"opening": opening}), near, far).mean()
        for opening in ("0", "50", "90")
    }
    assert open_share["0"] < 0.002 < 0.01 < open_share["50"] < open_share["90"]


@pytest.mark.parametrize("thickness", [0.004, 0.001, 0.03])
def test_the_thin_wall_is_as_thick_as_it_says(thickness: float) -> None:
    """Both its faces, found by rays across; thinner by default than the gather distance of 0.02 m."""
    scene = load_scene("thin-wall", {"thickness": str(thickness)})
    left = within((-0.2, -0.26, -0.27), (-0.2, -0.15, 0.06), 7)
    right = left * [-1.0, 1.0, 1.0]
    left[:, 1] += 0.3  # above the box
    right[:, 1] += 0.3
    faces = [first_hit(scene, left, right)[:, 0], first_hit(scene, right, left)[:, 0]]
    np.testing.assert_allclose(faces[0], -thickness / 2, atol=1e-6)
    np.testing.assert_allclose(faces[1], thickness / 2, atol=1e-6)


def test_the_thin_wall_has_no_gaps() -> None:
    """No sight line between the chambers behind its front edge, right up to floor, ceiling and back wall."""
    scene = load_scene("thin-wall")
    low, high = (-0.2775, -0.2775, -0.2775), (-0.0021, 0.2775, 0.0699)
    left, right = within(low, high, 8), within(low, high, 9) * [-1.0, 1.0, 1.0]
    assert blocked(scene, left, right).all()
    # Just above the floor, just below the ceiling, just before the back wall.
    for axis, value in ((1, -HALF + 1e-5), (1, HALF - 1e-5), (2, -HALF + 1e-5)):
        left[:, axis] = right[:, axis] = value
        assert blocked(scene, left, right).all()


def test_the_lamp_of_thin_wall_does_not_see_what_the_picture_compares() -> None:
    """The right part of the back wall, the wall's right face and the sphere get indirect light alone."""
    scene = load_scene("thin-wall")
    back = within((0.0021, -0.2775, -0.2774), (0.2775, 0.2775, -0.2774), 11)
    assert blocked(scene, back, below_lamp(scene)).all()


def test_corner_light_is_as_near_to_the_corner_as_it_says() -> None:
    scene = load_scene("corner-light")
    lamp = int(np.flatnonzero(scene.light[len(scene.triangles) :] >= 0)[0])
    np.testing.assert_allclose(scene.analytic_center[lamp], 0.05, atol=1e-7)
    assert scene.analytic_radius[lamp] == pytest.approx(0.012, rel=1e-6)
    assert scene.vertices.min() >= -1e-6, "nothing reaches behind floor and walls"
    center, radius = scene.analytic_center.astype(np.float64), scene.analytic_radius.astype(np.float64)
    touching = np.abs(center - radius[:, None]) < 1e-6
    touching[lamp] = False
    assert touching.sum(axis=1).tolist() == [2, 1, 0], "one ball touches floor and left wall, one the floor"
