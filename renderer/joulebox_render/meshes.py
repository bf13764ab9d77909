"""Triangle meshes: OBJ and PLY files, and the mesh of a shape with its normals in world space."""

from __future__ import annotations

import io
import logging
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from joulebox_render.errors import SceneError
from joulebox_render.mesh_obj import MeshFile, read_obj
from joulebox_render.mesh_ply import read_plain_ply
from joulebox_render.records import F8, I8
from joulebox_render.scene_transforms import fits_single, normalized, transform_normals, transform_points

# trimesh logs what it guesses about odd files; here a file is either read or refused with a sentence.
logging.getLogger("trimesh").addHandler(logging.NullHandler())


@dataclass(frozen=True)
class Mesh:
    """Triangles in world space without degenerate ones.

    vertices (V, 3) [m]; triangles (T, 3); corner_normals (T, 3, 3) unit; face_normals (T, 3) unit;
    areas (T,) [m^2]; dropped: how many triangles without area were left out
    """

    vertices: F8
    triangles: I8
    corner_normals: F8
    face_normals: F8
    areas: F8
    dropped: int


def read_mesh(data: bytes, kind: str, file: str) -> MeshFile:
    """Decode an OBJ or PLY file.

    data  the file's bytes;  kind  "obj" | "ply";  file  its name for messages
    Raises SceneError if it is not such a file, is cut off, has no triangles, or holds NaN or infinities.
    """
    try:
        mesh = read_obj(data) if kind == "obj" else read_plain_ply(data) or _read_ply(data)
    except MemoryError:
        raise SceneError(f"{file}: it asks for more memory than there is; is the file damaged?") from None
    except ValueError as error:
        reason = " ".join(str(error).split())[:160]
        raise SceneError(f"{file}: not a readable {kind.upper()} mesh, or cut off ({reason})") from None
    _check(mesh, kind, file)
    return mesh


def _read_ply(data: bytes) -> MeshFile:
    """Decode any PLY file, text or binary; raises ValueError."""
    # Imported when a scene has a file that is not plain: trimesh takes half a second to load.
    from trimesh.exchange.ply import load_ply
    from trimesh.geometry import triangulate_quads

    try:
        with warnings.catch_warnings():
            # numpy only warns about numbers it cannot parse
            warnings.simplefilter("error")
            loaded: dict[str, Any] = load_ply(io.BytesIO(data), skip_materials=True, fix_texture=False)
    except MemoryError:
        raise
    except Exception as error:  # trimesh fails in many ways on damaged files
        raise ValueError(str(error)) from None
    if loaded.get("faces") is None or loaded.get("vertices") is None:
        raise ValueError("it has no triangles")
    raw = loaded.get("metadata", {}).get("_ply_raw", {})
    for name, key in (("vertex", "vertices"), ("face", "faces")):
        declared = raw.get(name, {}).get("length", 0)
        if len(loaded[key]) < declared:
            raise ValueError(f"its header promises {declared} {key}, {len(loaded[key])} are there")
    normals = loaded.get("vertex_normals")
    return MeshFile(
        np.asarray(loaded["vertices"], dtype=np.float64),
        np.asarray(triangulate_quads(loaded["faces"]), dtype=np.int64),
        None if normals is None else np.asarray(normals, dtype=np.float64),
    )


def _check(mesh: MeshFile, kind: str, file: str) -> None:
    if mesh.faces.ndim != 2 or mesh.faces.shape[1] != 3 or len(mesh.faces) == 0:
        raise SceneError(f"{file}: the {kind.upper()} mesh has no triangles")
    if mesh.vertices.ndim != 2 or mesh.vertices.shape[1] != 3:
        raise SceneError(f"{file}: the vertices of the {kind.upper()} mesh are not three numbers each")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        worst = mesh.faces.max() if mesh.faces.max() >= len(mesh.vertices) else mesh.faces.min()
        raise SceneError(f"{file}: a face uses vertex {worst}, counted from 0, of {len(mesh.vertices)}; is it cut off?")
    if not fits_single(mesh.vertices) or (mesh.normals is not None and not np.isfinite(mesh.normals).all()):
        raise SceneError(f"{file}: the mesh holds a number that is not finite in single precision")


def place_mesh(source: MeshFile, to_world: F8, smooth: bool, flip: bool) -> Mesh | None:
    """The mesh in world space; None when no area is left of it in single precision: too large, too small, a line.

    smooth   shade with the file's vertex normals, or with angle-weighted ones where it has none, as Mitsuba
             does; False: flat
    flip     turn all normals, and the winding with them

    Where a file's vertex normals contradict the winding (mirroring transforms, careless exporters), the
    winding is turned: Mitsuba's bsdfs and area lights take the front from the shading normal.
    """
    vertices = transform_points(to_world, source.vertices)
    if not fits_single(vertices):
        return None
    vertices = vertices.astype(np.float32).astype(np.float64)
    cross = _cross(vertices, source.faces)
    keep = np.linalg.norm(cross, axis=1) >= np.finfo(np.float32).tiny
    faces, cross = source.faces[keep], cross[keep]
    if not len(faces) or not fits_single(cross):
        return None
    double_areas = np.linalg.norm(cross, axis=1)
    face_normals = cross / double_areas[:, None]
    corners = np.repeat(face_normals[:, None, :], 3, axis=1)
    if smooth:
        if source.normals is None:
            given = _angle_weighted(vertices, faces, face_normals)[faces]
        else:
            given = transform_normals(to_world, source.normals)[faces]
            turned = np.einsum("tcx,tx->t", given, face_normals) < 0.0
            faces = np.where(turned[:, None], faces[:, ::-1], faces)
            given = np.where(turned[:, None, None], given[:, ::-1], given)
            face_normals = np.where(turned[:, None], -face_normals, face_normals)
        zero = ~np.any(given, axis=2, keepdims=True)
        corners = np.where(zero, face_normals[:, None, :], given)
    if flip:
        faces, corners, face_normals = faces[:, ::-1], -corners[:, ::-1], -face_normals
    return Mesh(vertices, faces, corners, face_normals, 0.5 * double_areas, int(np.count_nonzero(~keep)))


def _cross(vertices: F8, faces: I8) -> F8:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    crossed: F8 = np.cross(b - a, c - a)
    return crossed


def _angle_weighted(vertices: F8, faces: I8, face_normals: F8) -> F8:
    """(V, 3) unit vertex normals, each face weighted by its angle there (Thuermer and Wuethrich 1998)."""
    summed = np.zeros_like(vertices)
    for corner in range(3):
        here = vertices[faces[:, corner]]
        edges = [vertices[faces[:, (corner + i) % 3]] - here for i in (1, 2)]
        unit = [edge / np.linalg.norm(edge, axis=1, keepdims=True) for edge in edges]
        angle = np.arccos(np.clip(np.einsum("tx,tx->t", *unit), -1.0, 1.0))
        np.add.at(summed, faces[:, corner], face_normals * angle[:, None])
    # Opposite faces can cancel; such a vertex gets 0 and its corners fall back to the face's normal.
    return normalized(summed, shortest=1e-12)
