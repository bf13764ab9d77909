"""The records that travel between stages: frozen dataclasses of arrays, one row an item.

Lengths are in metres, directions unit vectors. `wi` and `wo` both point away from the surface. Arrays are
C-contiguous; f4 is float32, i4 int32. A primitive index counts the triangles first, then the analytic shapes;
-1 is a miss.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

F4 = npt.NDArray[np.float32]
F8 = npt.NDArray[np.float64]
I4 = npt.NDArray[np.int32]
I8 = npt.NDArray[np.int64]
I1 = npt.NDArray[np.int8]
U1 = npt.NDArray[np.uint8]
U8 = npt.NDArray[np.uint64]

# Photons of an estimate that are named with it.
WITNESSES = 8
# Codes shared with the kernels, which import only numbers.
DIFFUSE, MIRROR, GLASS, BLACK, PHONG = 0, 1, 2, 3, 4
SPHERE, DISK = 0, 1
POINT_LIGHT, SPOT_LIGHT, RECTANGLE_LIGHT, DISK_LIGHT, SPHERE_LIGHT, MESH_LIGHT, ENVIRONMENT = 0, 1, 2, 3, 4, 5, 6


@dataclass(frozen=True)
class Camera:
    """Perspective camera in Mitsuba's convention: camera space looks along +z, +x points left, +y up.

    to_world    (4, 4) f8  rigid transform (after normalising its columns), camera to world
    fov_deg     full angle of view along `fov_axis`
    fov_axis    "x" | "y" | "smaller" | "larger" | "diagonal"
    near_m, far_m          clip distances along the view axis [m]
    """

    to_world: F8
    fov_deg: float
    fov_axis: str
    near_m: float
    far_m: float


@dataclass(frozen=True)
class Materials:
    """One row a bsdf.

    kind       (M,) i4  DIFFUSE | MIRROR | GLASS | PHONG | BLACK (a bsdf that reflects nothing)
    albedo     (M, 3) f4  diffuse reflectance, or specular reflectance of a mirror, 0..1, linear Rec.709
    glossy     (M, 3) f4  reflectance of a Phong lobe, else 0; albedo + glossy <= 1
    exponent   (M,) f4  of a Phong lobe, else 0
    ior        (M,) f4  inside / outside index of refraction (glass), else 1
    two_sided  (M,) u1  1: the back reflects too (Mitsuba's `twosided`); 0: the back of a diffuse surface is black
    """

    kind: I4
    albedo: F4
    glossy: F4
    exponent: F4
    ior: F4
    two_sided: U1


@dataclass(frozen=True)
class Lights:
    """One row a light (all triangles of an emitting mesh are one light).

    kind       (L,) i4  POINT_LIGHT ... ENVIRONMENT
    radiance   (L, 3) f4  emitted radiance [W m^-2 sr^-1] of area lights and of the environment, intensity [W sr^-1]
               of point and spot
    position   (L, 3) f4  point/spot: position; rectangle: centre; disk and sphere: centre; environment: centre of a
               ball around the scene
    edge_u, edge_v (L, 3) f4  rectangle: half edges, so corners are position +-edge_u +-edge_v; disk: radius vectors
    normal     (L, 3) f4  unit, side that emits (rectangle, disk); sphere: as Scene.analytic_normal;
               spot: unit direction of its axis
    radius     (L,) f4  sphere; environment: of the ball around the scene
    area       (L,) f4  [m^2]; 0 for point, spot and environment
    cone_cos   (L, 2) f4  spot: cosines of beam_width and cutoff_angle
    triangle_first, triangle_count (L,) i4  mesh: rows of Scene.triangles
    power      (L, 3) f4  emitted flux [W]: pi * area * radiance, 4 pi * intensity for a point, and for the
               environment what enters its ball
    """

    kind: I4
    radiance: F4
    position: F4
    edge_u: F4
    edge_v: F4
    normal: F4
    radius: F4
    area: F4
    cone_cos: F4
    triangle_first: I4
    triangle_count: I4
    power: F4


@dataclass(frozen=True)
class Scene:
    """A scene ready to be intersected.

    vertices             (V, 3) f4
    triangles            (T, 3) i4  rows of vertices, counter-clockwise seen from the front
    corner_normals       (T, 3, 3) f4  unit shading normal at each corner; the geometric normal where a mesh is flat
    face_normals         (T, 3) f4  unit geometric normal, on the side of the counter-clockwise winding
    analytic_kind        (A,) i4  SPHERE | DISK
    analytic_center      (A, 3) f4
    analytic_normal      (A, 3) f4  disk: unit normal; sphere: (+1, 0, 0), or (-1, 0, 0) when its normals are flipped
    analytic_radius      (A,) f4
    material             (T + A,) i4  row of Materials of each primitive
    light                (T + A,) i4  row of Lights of each primitive, -1: it does not emit
    notes                what of the file was noticed and ignored, a sentence each
    """

    name: str
    folder: Path
    sha256: str
    camera: Camera
    film_width: int
    film_height: int
    vertices: F4
    triangles: I4
    corner_normals: F4
    face_normals: F4
    analytic_kind: I4
    analytic_center: F4
    analytic_normal: F4
    analytic_radius: F4
    material: I4
    light: I4
    materials: Materials
    lights: Lights
    notes: tuple[str, ...]


class Rays(NamedTuple):
    """A queue of rays: what each counts for whom, and its random key.

    origin [m], direction (unit), weight (N, 3) f4; owner (N,) i8, the row that the ray's result is added to
    (a pixel or a point); key (N,) u8 and sample (N,) i8, see kernels.rng: a family of paths, and the path's number
    in it. A photon's weight is its flux [W], its sample the number of its emission.
    """

    origin: F4
    direction: F4
    weight: F4
    owner: I8
    key: U8
    sample: I8

    @classmethod
    def empty(cls, count: int) -> Rays:
        """Room for `count` rays."""
        return cls(
            _f4(count), _f4(count), _f4(count),
            np.empty(count, np.int64), np.empty(count, np.uint64), np.empty(count, np.int64),
        )  # fmt: skip


class Hits(NamedTuple):
    """Nearest hits of rays: distance (N,) f4 [m], primitive (N,) i4 (-1: miss), u and v (N,) f4 of triangles."""

    distance: F4
    primitive: I4
    u: F4
    v: F4


class Points(NamedTuple):
    """Diffuse points that paths have reached.

    position (N, 3) f4 [m], lifted off the surface by the scene's epsilon; normal (shading) and geometric
    (N, 3) f4, unit, on the side of wo; albedo (of the diffuse part), weight (N, 3) f4; owner (N,) i8; key (N,) u8
    and sample (N,) i8 as in Rays; distance (N,) f4 [m], length of the last ray.
    """

    position: F4
    normal: F4
    geometric: F4
    albedo: F4
    weight: F4
    owner: I8
    key: U8
    sample: I8
    distance: F4

    @classmethod
    def empty(cls, count: int) -> Points:
        """Room for `count` points."""
        return cls(
            _f4(count), _f4(count), _f4(count), _f4(count), _f4(count), np.empty(count, np.int64),
            np.empty(count, np.uint64), np.empty(count, np.int64), np.empty(count, np.float32),
        )  # fmt: skip


class Lobes(NamedTuple):
    """Glossy lobes of the Phong surfaces that paths have reached.

    at: Points of which albedo is the lobe's reflectance; mirror (N, 3) f4, unit, the lobe's axis, where a mirror would
    send the path; exponent (N,) f4.
    """

    at: Points
    mirror: F4
    exponent: F4

    @classmethod
    def empty(cls, count: int) -> Lobes:
        """Room for `count` lobes."""
        return cls(Points.empty(count), _f4(count), np.empty(count, np.float32))

    def first(self, count: int) -> Lobes:
        """The first `count` lobes."""
        return Lobes(Points(*rows(self.at, slice(0, count))), self.mirror[:count], self.exponent[:count])


class ShadowRays(NamedTuple):
    """Rays towards one light.

    origin, direction (N, 3) f4; limit (N,) f4 [m], just short of the light; weight (N,) f4 [sr] and owner (N,) i4 as
    in kernels.lighting.shadow_rays.
    """

    origin: F4
    direction: F4
    limit: F4
    weight: F4
    owner: I4

    @classmethod
    def empty(cls, count: int) -> ShadowRays:
        """Room for `count` rays."""
        return cls(
            _f4(count), _f4(count), np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.int32)
        )


class Photons(NamedTuple):
    """Photons where they were stored.

    position (N, 3) f4 [m]; normal (N, 3) f4 of the surface, on the photon's side; wi (N, 3) f4, towards where it
    came from; flux (N, 3) f4 [W]; history (N,) u1: 0 straight from a light, 1 after specular and glossy bounces
    alone, 2 after a diffuse bounce; number (N,) i8 of the emission it belongs to.
    """

    position: F4
    normal: F4
    wi: F4
    flux: F4
    history: U1
    number: I8

    @classmethod
    def empty(cls, count: int) -> Photons:
        """Room for `count` photons."""
        return cls(_f4(count), _f4(count), _f4(count), _f4(count), np.empty(count, np.uint8), np.empty(count, np.int64))


class Aim(NamedTuple):
    """Which photons are emitted.

    choice (L,) f8 cumulative chance of each light; share (L,) f8 of a light's directions that are drawn; first
    (L + 1,) i8, cell (C,) i4: light l draws directions from cell[first[l]:first[l + 1]], from all where it has none.
    """

    choice: F8
    share: F8
    first: I8
    cell: I4


class Tree(NamedTuple):
    """A kd-tree: position and normal (N, 3) f4 in the tree's order, axis (nodes,) i1, plane (nodes,) f4."""

    position: F4
    normal: F4
    axis: I1
    plane: F4


class Scratch(NamedTuple):
    """What one thread's tree search writes: nodes yet to be visited with the squared distance to each, and the
    candidates for the nearest points.

    node, low, high (64,) i8, offset2 (64,) f8: deep enough for any tree; candidates (C,) i8, C well over k, each
    a squared distance and a row (see kernels.kdtree.candidate).
    """

    node: I8
    low: I8
    high: I8
    offset2: F8
    candidates: I8

    @classmethod
    def empty(cls, k: int) -> Scratch:
        """Room to find `k` points: cutting 4 k candidates down to k costs little more than having found them."""
        node, low, high = np.empty((3, 64), np.int64)
        return cls(node, low, high, np.empty(64), np.empty(4 * k + 64, np.int64))


class Estimates(NamedTuple):
    """Density estimates at points.

    irradiance (N, 3) f4 [W m^-2]; radius (N,) f4 of each one's disc [m]; found (N,) i4, the photons that make it;
    lopsided (N,) f4, the squared distance of their centroid from the point over what it is in the mean where
    photons fill the disc: exponentially distributed there, larger near edges; witness (N, WITNESSES) i4, rows of some
    of the photons in the tree's order, -1 where there are none.
    """

    irradiance: F4
    radius: F4
    found: I4
    lopsided: F4
    witness: I4

    @classmethod
    def empty(cls, count: int) -> Estimates:
        """Room for `count` estimates."""
        radius, lopsided = np.empty((2, count), np.float32)
        return cls(_f4(count), radius, np.empty(count, np.int32), lopsided, np.empty((count, WITNESSES), np.int32))


def _f4(count: int) -> F4:
    return np.empty((count, 3), np.float32)


def rows(record: NamedTuple, selection: slice | npt.NDArray[np.integer | np.bool_]) -> tuple[Any, ...]:
    """The selected rows of every column of a record; give it to the record's class.

    A slice gives views of the record's own arrays, which must then not be written to.
    """
    if isinstance(selection, slice):
        return tuple([column[selection] for column in record])
    chosen = np.flatnonzero(selection) if selection.dtype == np.bool_ else selection
    return tuple([column.take(chosen, axis=0) for column in record])
