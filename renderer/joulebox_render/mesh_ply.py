"""PLY files as most programs write them: binary, triangles alone. trimesh reads all others, and says what ails them.

trimesh takes half a second to import, longer than everything else from a bunny's file to its picture's first photon.
Other readers of Python are as slow as that on 70,000 faces, or under licences that ours cannot carry.
"""

from __future__ import annotations

import re

import numpy as np

from joulebox_render.mesh_obj import MeshFile

# Headers are far shorter; a damaged file is not searched to its end.
LONGEST_HEADER = 10_000
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
FACES = re.compile(r"property list (\w+) (\w+) vertex_ind(?:ices|ex)")


def read_plain_ply(data: bytes) -> MeshFile | None:
    """Vertices, with their normals if there are any, and triangles of a file that holds nothing else; None for others.

    Raises nothing: where anything is not as it should be, another reader shall tell.
    """
    head, mark, _ = data[:LONGEST_HEADER].partition(b"end_header\n")
    lines = [line for line in head.decode("latin-1").splitlines() if not line.startswith(("comment", "obj_info"))]
    words = [line.split() for line in lines]
    if not mark or len(lines) < 5 or lines[0] != "ply" or len(words[1]) != 3 or words[1][1] not in BYTE_ORDERS:
        return None
    order, counts = BYTE_ORDERS[words[1][1]], [row[1:] for row in words if row and row[0] == "element"]
    columns = [row[1:] for row in words[3:-2] if len(row) == 3 and row[0] == "property" and row[1] in TYPES]
    listed = FACES.fullmatch(lines[-1])
    plain = (
        words[2][:2] == ["element", "vertex"] and words[-2][:2] == ["element", "face"]
        and len(columns) == len(words) - 5
        and all(len(row) == 2 and row[1].isdecimal() and len(row[1]) < 19 for row in counts)
        and listed is not None and set(listed.groups()) <= TYPES.keys()
    )  # fmt: skip
    names = [name for _, name in columns]
    if not plain or listed is None or len(set(names)) < len(names) or not {"x", "y", "z"} <= set(names):
        return None
    vertex = np.dtype([(name, order + TYPES[kind]) for kind, name in columns])
    face = np.dtype([("corners", order + TYPES[listed[1]]), ("vertex", order + TYPES[listed[2]], (3,))])
    vertices, faces = (int(row[1]) for row in counts)
    first = len(head) + len(mark)
    if min(vertices, faces) == 0 or len(data) - first != vertices * vertex.itemsize + faces * face.itemsize:
        return None
    table = np.frombuffer(data, vertex, vertices, first)
    triangles = np.frombuffer(data, face, faces, first + table.nbytes)
    if not (triangles["corners"] == 3).all():
        return None
    position, normal = (
        np.stack([table[name] for name in axes], axis=1).astype(np.float64) if set(axes) <= set(names) else None
        for axes in (("x", "y", "z"), ("nx", "ny", "nz"))
    )
    assert position is not None
    return MeshFile(position, triangles["vertex"].astype(np.int64), normal)
