"""Make the meshes of scenes/cornell-bunny: `python docs/bunny_meshes.py bunny.obj`.

bunny.obj is the 69,666-triangle Stanford bunny of Debian's package glmark2-data (`apt download glmark2-data`, then
`dpkg-deb -x glmark2-data_*.deb .`; it lies in usr/share/glmark2/models). Needs `pip install fast-simplification`,
which nothing else in joulebox uses, so it is no dependency.

Each mesh is moved and scaled alike: height 1, lowest vertex at y = 0, middle of its bounding box at x = z = 0. The
coarser ones are decimated by quadric error (Garland and Heckbert 1997, as fast-simplification does it). A handful of
vertices are smoothed where a fold turns a triangle away from the shading normals at its corners: renderers would take
its front for its back.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import fast_simplification
import numpy as np
import trimesh

FOLDER = Path(__file__).resolve().parent.parent / "scenes" / "cornell-bunny"
TRIANGLES = (69_666, 16_300, 3_850, 948)
LEAST_COSINE = 0.02
"""Between a triangle's normal and the shading normal at each of its corners."""
HEADER = """ply
format binary_little_endian 1.0
comment Stanford bunny of the Stanford Computer Graphics Laboratory, {triangles} triangles, height 1
element vertex {vertices}
property float x
property float y
property float z
element face {triangles}
property list uchar int vertex_indices
end_header
"""


def decimated(mesh: Any, triangles: int) -> Any:
    """A closed mesh of exactly `triangles` triangles, or the mesh itself when it has that many."""
    if len(mesh.faces) == triangles:
        return mesh
    vertices, faces = fast_simplification.simplify(
        np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32), target_count=triangles, agg=5
    )
    coarse = trimesh.Trimesh(vertices, faces, process=False)
    if len(faces) != triangles or not coarse.is_watertight or not coarse.is_winding_consistent:
        sys.exit(f"{triangles} triangles asked for: the result has {len(faces)}, closed: {coarse.is_watertight}.")
    return coarse


def unfolded(vertices: Any, faces: Any) -> Any:
    """(V, 3) the vertices, those of folds moved half-way to their neighbours' mean until no fold is left."""
    vertices = vertices.copy()
    for _ in range(100):
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        facing = np.einsum("tcx,tx->tc", mesh.vertex_normals[faces], mesh.face_normals)
        folded = np.unique(faces[(facing < LEAST_COSINE).any(axis=1)])
        if not len(folded):
            return vertices
        around = np.array([mesh.vertices[mesh.vertex_neighbors[vertex]].mean(axis=0) for vertex in folded])
        vertices[folded] = 0.5 * (vertices[folded] + around)
    sys.exit("The folds of the mesh do not go away.")


def upright(vertices: Any) -> Any:
    """(V, 3) f4 the vertices at height 1, standing on y = 0 around the y axis."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = (low + high) / 2.0
    return ((vertices - [middle[0], low[1], middle[2]]) / (high[1] - low[1])).astype("<f4")


def write_ply(path: Path, vertices: Any, faces: Any) -> None:
    """Positions and triangles alone: both renderers make the same smooth normals of them."""
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"] = 3
    rows["corners"] = faces
    header = HEADER.format(vertices=len(vertices), triangles=len(faces))
    path.write_bytes(header.encode("ascii") + vertices.tobytes() + rows.tobytes())


def main(source: str) -> None:
    """Write the four meshes."""
    full = trimesh.load(source, process=False)
    for triangles in TRIANGLES:
        mesh = decimated(full, triangles)
        path = FOLDER / f"bunny-{triangles}.ply"
        vertices = unfolded(np.asarray(mesh.vertices, np.float64), mesh.faces)
        write_ply(path, upright(vertices), mesh.faces)
        print(f"{path.name}: {len(mesh.faces)} triangles, {path.stat().st_size} bytes")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("Use: python docs/bunny_meshes.py bunny.obj")
    main(sys.argv[1])
