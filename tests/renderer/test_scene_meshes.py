"""Mesh files: their normals, what is left out, and that each counts in the scene's hash; damaged ones."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from joulebox_render import meshes
from joulebox_render.mesh_ply import read_plain_ply
from joulebox_render.scene import load_scene
from scene_files import FIRST_LINE, LAMP, SENSOR, load, message, shape

QUAD_PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-1 -1 0
1 -1 0
1 1 0
-1 1 1
3 0 1 2
3 0 2 3
"""


def test_hash_changes_with_file_defines_and_meshes(tmp_path: Path) -> None:
    (tmp_path / "quad.ply").write_text(QUAD_PLY)
    body = (
        '<default name="z" value="0"/><shape type="ply"><string name="filename" value="quad.ply"/>'
        '<transform name="to_world"><translate z="$z"/></transform></shape>'
    )
    first = load(tmp_path, body).sha256
    copied = tmp_path / "copy"
    copied.mkdir()
    for name in ("quad.ply", "scene.xml"):
        shutil.copy(tmp_path / name, copied / name)
    assert load_scene(copied).sha256 == first
    assert load(tmp_path, body, z="0").sha256 == first, "a define that repeats the default is the same scene"
    assert load(tmp_path, body, z="1").sha256 != first
    assert load(tmp_path, body + "<!-- -->").sha256 != first
    (tmp_path / "quad.ply").write_text(QUAD_PLY.replace("-1 1 1", "-1 1 2"))
    assert load(tmp_path, body).sha256 != first


def test_mesh_normals(tmp_path: Path) -> None:
    """Smooth by angle-weighted normals unless face_normals is set; vertices on the fold lie between."""
    (tmp_path / "quad.ply").write_text(QUAD_PLY)
    shape = '<shape type="ply"><string name="filename" value="quad.ply"/>{}</shape>'
    flat = load(tmp_path, shape.format('<boolean name="face_normals" value="true"/>'))
    np.testing.assert_array_equal(flat.corner_normals, np.repeat(flat.face_normals[:, None], 3, axis=1))
    smooth = load(tmp_path, shape.format(""))
    np.testing.assert_allclose(smooth.corner_normals[0, 1], smooth.face_normals[0], atol=1e-6)
    between = smooth.corner_normals[0, 0] @ smooth.face_normals.T
    assert (between < 0.9999).all()
    assert (between > smooth.face_normals[0] @ smooth.face_normals[1]).all()
    np.testing.assert_array_equal(smooth.corner_normals[0, 0], smooth.corner_normals[1, 0])


def test_triangles_without_area_are_left_out(tmp_path: Path) -> None:
    text = QUAD_PLY.replace("element face 2", "element face 3") + "3 1 1 2\n"
    (tmp_path / "quad.ply").write_text(text)
    scene = load(tmp_path, '<shape type="ply"><string name="filename" value="quad.ply"/></shape>')
    assert len(scene.triangles) == 2
    assert any("1 triangles without area" in note for note in scene.notes)


def test_obj_groups_and_polygons(tmp_path: Path) -> None:
    """Groups, materials, quads, negative indices: one mesh of three triangles; no other file is read."""
    (tmp_path / "mesh.obj").write_text(
        "mtllib absent.mtl\no a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl red\nf 1 2 3 4\n"
        "g b\nusemtl green\nv 0 0 1\nf -1 1 2\n"
    )
    scene = load(tmp_path, '<shape type="obj"><string name="filename" value="mesh.obj"/></shape>')
    assert len(scene.triangles) == 3
    area = 0.5 * np.linalg.norm(np.cross(*np.diff(scene.vertices[scene.triangles], axis=1).transpose(1, 0, 2)), axis=1)
    np.testing.assert_allclose(area, 0.5, rtol=1e-6)


HEADER = b"""ply
format %s 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
TEXT = HEADER % b"ascii"
BINARY = HEADER % b"binary_little_endian" + struct.pack("<9fB3i", 0, 0, 0, 1, 0, 0, 0, 1, 0, 3, 0, 1, 2)


def test_good_meshes_are_good(tmp_path: Path) -> None:
    """What the tests of damaged meshes damage is readable to begin with."""
    for data in (TEXT + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", BINARY):
        (tmp_path / "mesh.ply").write_bytes(data)
        body = shape('<string name="filename" value="mesh.ply"/>', "ply")
        (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{SENSOR}{LAMP}{body}</scene>')
        assert len(load_scene(tmp_path).triangles) == 1


RICH = BINARY.replace(b"little", b"big").split(b"end_header")[0].replace(
    b"property float z\n",
    b"property float z\nproperty float nx\nproperty float ny\nproperty double nz\nproperty uchar red\ncomment x\n",
).replace(b"uchar int vertex_indices", b"ushort uint vertex_index") + b"end_header\n" + b"".join(
    struct.pack(">5fdB", *corner, 0.6, 0, 0.8, 7) for corner in ((0, 0, 0), (1, 0, 0), (0, 1, 2))
) + struct.pack(">H3I", 3, 2, 0, 1)  # fmt: skip


@pytest.mark.parametrize("data", [BINARY, RICH])
def test_plain_files_are_read_as_trimesh_reads_them(data: bytes) -> None:
    ours, theirs = read_plain_ply(data), meshes._read_ply(data)
    assert ours is not None
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_array_equal(ours.faces, theirs.faces)
    assert (ours.normals is None) == (theirs.normals is None) == (data is BINARY)
    if ours.normals is not None and theirs.normals is not None:
        np.testing.assert_array_equal(ours.normals, theirs.normals)


@pytest.mark.parametrize(
    "data",
    [
        b"", TEXT + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", BINARY[:-1], BINARY + b"x",
        BINARY.replace(b"\x03\x00\x00\x00\x00\x01", b"\x04\x00\x00\x00\x00\x01"),
        BINARY.replace(b"float z", b"float w"), BINARY.replace(b"float x", b"half x"),
        BINARY.replace(b"ply", b"plY", 1),
        BINARY.replace(b"vertex 3", b"vertex " + b"9" * 5000), BINARY.replace(b"uchar int", b"uchar string"),
        BINARY.replace(b"element face", b"element edge 0\nelement face"), BINARY.replace(b"float y", b"float x"),
    ],
)  # fmt: skip
def test_whatever_is_not_plain_is_left_to_trimesh(data: bytes) -> None:
    assert read_plain_ply(data) is None


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("mesh.ply", b"", ["PLY"]),
        ("mesh.ply", bytes(range(256)) * 8, ["PLY"]),
        ("mesh.ply", b"ply\nformat ascii 1.0\n", ["PLY"]),
        ("mesh.ply", BINARY[:-4], ["cut off"]),
        ("mesh.ply", BINARY[:-20], ["cut off"]),
        ("mesh.ply", TEXT + b"0 0 0\n1 0 0\n", ["cut off"]),
        ("mesh.ply", TEXT + b"0 0 0\n1 0 0\n0 1 0\n", ["cut off"]),
        ("mesh.ply", TEXT + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", ["vertex 7", "of 3"]),
        ("mesh.ply", TEXT + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", ["vertex -1"]),
        ("mesh.ply", TEXT + b"0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n", ["not finite"]),
        ("mesh.ply", TEXT + b"0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n", ["no triangle", "on one line"]),
        ("mesh.ply", TEXT.replace(b"vertex 3", b"vertex 3000000000") + b"0 0 0\n", ["PLY"]),
        ("mesh.obj", b"", ["no faces"]),
        ("mesh.obj", bytes(range(256)) * 8, ["OBJ"]),
        ("mesh.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", ["no faces"]),
        ("mesh.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", ["its line 4", "item 4 of 3"]),
        ("mesh.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", ["its line 4", "item 0 of 3"]),
        ("mesh.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", ["three corners"]),
        ("mesh.obj", b"v 0 0 0\nv 1 0\n", ["its line 2", "2 numbers"]),
        ("mesh.obj", b"v 0 0 0\nv 1 zero 0\n", ["its line 2", "zero"]),
        ("mesh.obj", b"v 0 0 0\nv 1 inf 0\nv 0 1 0\nf 1 2 3\n", ["not finite"]),
        ("mesh.obj", b"v 0 0 0\nbanana\n", ["banana"]),
    ],
)
def test_damaged_mesh(tmp_path: Path, name: str, data: bytes, words: list[str]) -> None:
    (tmp_path / name).write_bytes(data)
    text = message(tmp_path, shape(f'<string name="filename" value="{name}"/>', name[-3:]))
    assert text.startswith(f"{tmp_path / 'scene.xml'}, line {FIRST_LINE}: "), text
    for word in words:
        assert word in text
