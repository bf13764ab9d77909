"""Wavefront OBJ: the vertices, vertex normals and faces of a file, read strictly.

trimesh reads OBJ too, but skips what it does not understand, and counts negative indices from the file's end.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from joulebox_render.records import F8, I8

# Statements without effect here: texture coordinates, names, smoothing groups, materials, lines, points.
_IGNORED = frozenset({"vt", "g", "o", "s", "usemtl", "mtllib", "l", "p", "usemap", "maplib"})


@dataclass(frozen=True)
class MeshFile:
    """What a mesh file holds.

    vertices (V, 3); faces (T, 3) rows of vertices, counter-clockwise from the front; normals (V, 3) or None.
    """

    vertices: F8
    faces: I8
    normals: F8 | None


def read_obj(data: bytes) -> MeshFile:
    """Decode an OBJ file; polygons become fans, and corners with differing normals vertices of their own.

    Raises ValueError that names the line.
    """
    positions: list[list[float]] = []
    normals: list[list[float]] = []
    # A corner is (position, normal); normal -1: none.
    rows: dict[tuple[int, int], int] = {}
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(data.decode("utf-8").replace("\\\n", " ").splitlines(), start=1):
        keyword, *fields = line.partition("#")[0].split() or [""]
        try:
            if keyword == "v":
                positions.append(_three(fields))
            elif keyword == "vn":
                normals.append(_three(fields))
            elif keyword == "f":
                corners = [_corner(field, len(positions), len(normals)) for field in fields]
                if len(corners) < 3:
                    raise ValueError("a face needs three corners")
                polygon = [rows.setdefault(corner, len(rows)) for corner in corners]
                faces += [(polygon[0], b, c) for b, c in pairwise(polygon[1:])]
            elif keyword and keyword not in _IGNORED:
                raise ValueError(f'unknown statement "{keyword[:20]}"')
        except ValueError as error:
            raise ValueError(f"its line {number}: {error}") from None
    if not faces:
        raise ValueError("it has no faces")
    corner_rows = np.array(list(rows), dtype=np.int64)
    smooth = bool((corner_rows[:, 1] >= 0).all())
    return MeshFile(
        np.array(positions)[corner_rows[:, 0]],
        np.array(faces, dtype=np.int64),
        np.array(normals)[corner_rows[:, 1]] if smooth else None,
    )


def _three(fields: list[str]) -> list[float]:
    """The first three numbers; colours may follow."""
    if len(fields) < 3:
        raise ValueError(f"{len(fields)} numbers where three are needed")
    return [float(field) for field in fields[:3]]


def _corner(field: str, position_count: int, normal_count: int) -> tuple[int, int]:
    """v, v/vt, v//vn or v/vt/vn as rows counted from 0."""
    parts = field.split("/")
    normal = _row(parts[2], normal_count) if len(parts) > 2 and parts[2] else -1
    return _row(parts[0], position_count), normal


def _row(text: str, count: int) -> int:
    """Files count from 1, or with negative numbers back from the latest."""
    index = int(text)
    row = index - 1 if index > 0 else count + index
    if index == 0 or not 0 <= row < count:
        raise ValueError(f"it refers to item {index} of {count}")
    return row
