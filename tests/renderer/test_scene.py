"""What load_scene makes of a scene: geometry, camera, names and defines."""

from __future__ import annotations

import dataclasses
import math
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from joulebox_render.records import (
    BLACK,
    DIFFUSE,
    GLASS,
    MIRROR,
    RECTANGLE_LIGHT,
)
from joulebox_render.scene import list_scenes, load_scene
from scene_files import load

HERE = Path(__file__).parent
CHECKOUT = HERE.parents[1]


@pytest.mark.parametrize(
    ("name", "shipped"), [("cornell_boxes", "cornell-boxes"), ("cornell_spheres", "cornell-spheres")]
)
def test_shipped_scene_equals_the_reference(name: str, shipped: str) -> None:
    """The tidied scenes hold the very numbers the reference pictures were rendered from."""
    reference = load_scene(HERE / "data" / "reference" / f"{name}.xml")
    ours = load_scene(shipped)
    for field in ("vertices", "triangles", "corner_normals", "analytic_center", "analytic_radius", "light"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(reference, field), err_msg=field)
    for field in ("kind", "albedo", "ior", "two_sided"):
        np.testing.assert_array_equal(
            getattr(ours.materials, field)[ours.material],
            getattr(reference.materials, field)[reference.material],
            err_msg=field,
        )
    for field in dataclasses.fields(ours.lights):
        np.testing.assert_array_equal(getattr(ours.lights, field.name), getattr(reference.lights, field.name))
    np.testing.assert_array_equal(ours.camera.to_world, reference.camera.to_world)
    assert dataclasses.replace(ours.camera, to_world=reference.camera.to_world) == reference.camera
    assert (ours.film_width, ours.film_height) == (256, 256)


def test_cornell_spheres_in_numbers() -> None:
    scene = load_scene("cornell-spheres")
    assert scene.name == "cornell-spheres"
    assert len(scene.triangles) == 12
    kinds = scene.materials.kind[scene.material]
    assert kinds.tolist() == [DIFFUSE] * 10 + [BLACK] * 2 + [MIRROR, GLASS]
    assert scene.materials.ior[scene.material[-1]] == pytest.approx(1.5)
    assert scene.lights.kind.tolist() == [RECTANGLE_LIGHT]
    area = 0.1332 * 0.111
    assert scene.lights.area[0] == pytest.approx(area, rel=1e-6)
    np.testing.assert_allclose(scene.lights.power[0], math.pi * area * 15.0, rtol=1e-6)
    np.testing.assert_allclose(scene.lights.normal[0], [0.0, -1.0, 0.0], atol=1e-7)
    assert scene.light.tolist() == [-1] * 10 + [0, 0, -1, -1]
    assert any("integrator" in note for note in scene.notes)
    assert any("sampler" in note for note in scene.notes)


def test_all_arrays_fit_together() -> None:
    """Every shipped scene: types, shapes, ranges and unit normals are what records.py promises."""
    for entry in list_scenes():
        scene = load_scene(entry.name)
        primitives = len(scene.triangles) + len(scene.analytic_kind)
        assert scene.material.shape == scene.light.shape == (primitives,)
        for array in (scene.vertices, scene.corner_normals, scene.face_normals, scene.analytic_center):
            assert array.dtype == np.float32
            assert array.flags.c_contiguous
        for array in (scene.triangles, scene.material, scene.light, scene.analytic_kind):
            assert array.dtype == np.int32
        np.testing.assert_allclose(np.linalg.norm(scene.corner_normals, axis=2), 1.0, atol=1e-5)
        corners = scene.vertices[scene.triangles]
        winding = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        unit = winding / np.linalg.norm(winding, axis=1, keepdims=True)
        np.testing.assert_allclose(unit, scene.face_normals, atol=1e-3)
        assert (np.einsum("tcx,tx->tc", scene.corner_normals, scene.face_normals) > 0.0).all()
        assert (scene.lights.power.max(axis=1) > 0.0).all()
        assert set(scene.light[scene.light >= 0]) <= set(range(len(scene.lights.kind)))


def test_list_scenes_names_every_folder() -> None:
    entries = list_scenes()
    folders = sorted(path.name for path in (CHECKOUT / "scenes").iterdir() if path.is_dir())
    assert [entry.name for entry in entries] == folders
    for entry in entries:
        assert (entry.path / "scene.xml").is_file()
        assert entry.title != entry.name, "the README's first heading is the title"


def test_wheel_carries_the_scenes() -> None:
    """An installed renderer finds its scenes inside the package."""
    project = tomllib.loads((CHECKOUT / "renderer" / "pyproject.toml").read_text())
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert included == {"../scenes": "joulebox_render/scenes"}


def test_cubes_stand_where_the_rectangles_of_cornell_boxes_do() -> None:
    """many-lights builds the boxes from cubes; their corners are those of cornell-boxes to 0.1 mm."""
    boxes, cubes = load_scene("cornell-boxes"), load_scene("many-lights")
    yellow = np.unique(boxes.vertices[boxes.triangles[boxes.material == boxes.material[12]]].reshape(-1, 3), axis=0)
    cube_rows = np.flatnonzero(np.all(np.isclose(cubes.materials.albedo[cubes.material], [0.7, 0.6, 0.1]), axis=1))
    corners = cubes.vertices[cubes.triangles[cube_rows]].reshape(-1, 3)
    nearest = np.linalg.norm(corners[:, None] - yellow[None], axis=2).min(axis=1)
    assert len(cube_rows) == 24
    assert nearest.max() < 1e-4


def test_transform_steps_apply_in_order(tmp_path: Path) -> None:
    """Scale, turn by 90 degrees around y, move: (1, 1, 0) -> (2, 2, 0) -> (0, 2, -2) -> (1, 4, 1)."""
    scene = load(
        tmp_path,
        '<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate y="1" angle="90"/>'
        '<translate x="1" y="2" z="3"/></transform></shape>',
    )
    np.testing.assert_allclose(scene.vertices[2], [1.0, 4.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(scene.face_normals, [[1.0, 0.0, 0.0]] * 2, atol=1e-6)


def test_camera(tmp_path: Path) -> None:
    """Camera space: +z forward, +x left, +y up; a look_at is rigid."""
    sensor = (
        '<sensor type="perspective"><string name="focal_length" value="50mm"/>'
        '<transform name="to_world"><look_at origin="0,0,5" target="0,0,0" up="0,2,0"/></transform>'
        '<film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="32"/>'
        '<rfilter type="gaussian"/></film></sensor>'
    )
    scene = load(tmp_path, '<shape type="cube"/>', sensor=sensor)
    np.testing.assert_allclose(scene.camera.to_world @ [0, 0, 1, 1], [0, 0, 4, 1], atol=1e-12)
    np.testing.assert_allclose(scene.camera.to_world @ [1, 0, 0, 0], [-1, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(scene.camera.to_world @ [0, 1, 0, 0], [0, 1, 0, 0], atol=1e-12)
    assert scene.camera.fov_axis == "diagonal"
    assert scene.camera.fov_deg == pytest.approx(2 * math.degrees(math.atan(math.hypot(36, 24) / 100)))
    assert (scene.film_width, scene.film_height) == (64, 32)
    assert any("gaussian" in note for note in scene.notes)


def test_camera_defaults(tmp_path: Path) -> None:
    scene = load(tmp_path, '<shape type="cube"/>')
    assert (scene.camera.fov_deg, scene.camera.fov_axis) == (40.0, "x")
    assert (scene.camera.near_m, scene.camera.far_m) == (0.01, 10000.0)
    assert (scene.film_width, scene.film_height) == (768, 576)


def test_defines(tmp_path: Path) -> None:
    """-D wins over <default>; names are replaced inside text, and in later defaults."""
    body = (
        '<default name="size" value="2"/><default name="scale" value="$size"/>'
        '<shape type="sphere"><float name="radius" value="$scale"/>'
        '<point name="center" value="$size, $size,1"/></shape>'
    )
    assert load(tmp_path, body).analytic_radius[0] == 2.0
    scene = load(tmp_path, body, size="3")
    assert scene.analytic_radius[0] == 3.0
    np.testing.assert_array_equal(scene.analytic_center[0], [3.0, 3.0, 1.0])


def test_scene_by_name_folder_and_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A path that exists wins; a folder of the same name without scene.xml does not hide a shipped scene."""
    shutil.copytree(CHECKOUT / "scenes" / "furnace", tmp_path / "mine")
    assert load_scene(tmp_path / "mine").name == "mine"
    assert load_scene(str(tmp_path / "mine" / "scene.xml")).name == "mine"
    (tmp_path / "mine" / "scene.xml").rename(tmp_path / "mine" / "other.xml")
    assert load_scene(tmp_path / "mine" / "other.xml").name == "other"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "furnace").mkdir()
    assert load_scene("furnace").folder == CHECKOUT / "scenes" / "furnace"
