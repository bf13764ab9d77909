"""The shapes of a scene in world space: triangles, or analytic spheres and disks; with bsdf and radiance."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Protocol

import numpy as np

from joulebox_render.mesh_obj import MeshFile
from joulebox_render.meshes import Mesh, place_mesh, read_mesh
from joulebox_render.records import DISK, F8, SPHERE
from joulebox_render.scene_bsdfs import MaterialTable
from joulebox_render.scene_transforms import fits_single, mirrors, transform_normals, transform_points, uniform_scale
from joulebox_render.scene_values import Properties
from joulebox_render.scene_xml import Element, suggest


@dataclass(frozen=True)
class Analytic:
    """A sphere or disk: kind SPHERE | DISK, center (3,), normal (3,) as Scene.analytic_normal, radius [m]."""

    kind: int
    center: F8
    normal: F8
    radius: float


@dataclass(frozen=True)
class Shape:
    """One shape.

    half_edges   rectangle: its half edges, disk: two radius vectors; (2, 3), edge_u x edge_v along the normal
    radiance     (3,) of its area light, or None
    material     row of Materials
    """

    element: Element
    surface: Mesh | Analytic
    half_edges: F8 | None
    radiance: F8 | None
    material: int


class _Hash(Protocol):
    def update(self, data: bytes, /) -> None: ...


class SceneFolder:
    """The only folder a scene may read from; every file read goes into the scene's hash."""

    def __init__(self, folder: Path, digest: _Hash) -> None:
        self.folder = folder
        self._digest = digest

    def read(self, blame: Element, name: str) -> bytes:
        """The bytes of a file inside the folder; SceneError at `blame` for any other."""
        pure = PurePosixPath(name)
        if not name or pure.is_absolute() or PureWindowsPath(name).anchor or ".." in PureWindowsPath(name).parts:
            raise blame.error(f'"{name}" is outside the scene\'s folder; give a path relative to and inside it')
        root = self.folder.resolve()
        try:
            path = (root / pure).resolve()
            if not path.is_relative_to(root):
                raise blame.error(f'"{name}" leads outside the scene\'s folder; put the file into the folder')
            if not path.is_file():
                raise blame.error(f'there is no file "{name}" in the scene\'s folder {self.folder}')
            data = path.read_bytes()
        except (OSError, RuntimeError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise blame.error(f'cannot read "{name}": {reason}') from None
        self._digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(data).digest())
        return data


# Reads what is particular to one type: (properties, to_world, flip_normals) -> (surface, half edges).
_Reader = Callable[[Properties, F8, bool], tuple[Mesh | Analytic, F8 | None]]


class ShapeReader:
    """Reads <shape> elements."""

    def __init__(self, objects_by_id: Mapping[str, Element], folder: SceneFolder, materials: MaterialTable) -> None:
        self._objects_by_id = objects_by_id
        self._folder = folder
        self._materials = materials
        self._mesh_files: dict[tuple[str, str], MeshFile] = {}

    def read(self, element: Element) -> Shape:
        """One shape in world space; SceneError for what this renderer does not have."""
        readers: dict[str, _Reader] = {
            "rectangle": self._rectangle,
            "cube": self._cube,
            "sphere": self._sphere,
            "disk": self._disk,
            "obj": self._mesh,
            "ply": self._mesh,
        }
        if element.type not in readers:
            raise element.error(f'unknown shape "{element.type}"{suggest(element.type, readers)}')
        properties = Properties(element, self._objects_by_id)
        to_world = properties.take_transform("to_world")
        flip = properties.take_boolean("flip_normals", False)
        radiance = self._radiance(properties)
        material = self._material(properties, radiance is not None)
        surface, half_edges = readers[element.type](properties, to_world, flip)
        properties.finish()
        if isinstance(surface, Analytic) and not fits_single(surface.center, surface.radius**2):
            raise element.error(f"the {element.type} is too large for single precision; change its scale")
        return Shape(element, surface, half_edges, radiance, material)

    def _radiance(self, properties: Properties) -> F8 | None:
        emitters = properties.take_objects("emitter")
        if len(emitters) > 1:
            raise emitters[1].error("a shape has one emitter; remove the others")
        if not emitters:
            return None
        if emitters[0].type != "area":
            raise emitters[0].error(f'a shape\'s emitter is "area", not "{emitters[0].type}"')
        emitter = Properties(emitters[0], self._objects_by_id)
        radiance = emitter.take_emission("radiance")
        emitter.finish()
        return radiance

    def _material(self, properties: Properties, emits: bool) -> int:
        bsdfs = properties.take_objects("bsdf")
        if len(bsdfs) > 1:
            raise bsdfs[1].error(f"the shape on line {properties.element.line} has {len(bsdfs)} bsdfs; give it one")
        return self._materials.row(bsdfs[0]) if bsdfs else self._materials.default_row(emits)

    def _placed(self, element: Element, source: MeshFile, to_world: F8, smooth: bool, flip: bool) -> Mesh:
        mesh = place_mesh(source, to_world, smooth, flip)
        if mesh is None:
            raise element.error(
                f"no triangle of the {element.type} has an area that single precision can tell; "
                "its corners must not lie on one line, nor its size be beyond 1e-19 to 1e19"
            )
        return mesh

    def _rectangle(self, properties: Properties, to_world: F8, flip: bool) -> tuple[Mesh, F8]:
        """[-1, 1]^2 in z = 0, facing +z."""
        mesh = self._placed(properties.element, _RECTANGLE, to_world, True, flip)
        return mesh, _half_edges(to_world, 1.0, mesh.face_normals[0])

    def _cube(self, properties: Properties, to_world: F8, flip: bool) -> tuple[Mesh, None]:
        """[-1, 1]^3, facing outwards."""
        return self._placed(properties.element, _CUBE, to_world, True, flip), None

    def _mesh(self, properties: Properties, to_world: F8, flip: bool) -> tuple[Mesh, None]:
        element = properties.element
        if not properties.has("filename"):
            raise element.error(f'the {element.type} shape has no <string name="filename" value="..."/>')
        blame = properties.line_of("filename")
        name = properties.take_string("filename", "")
        smooth = not properties.take_boolean("face_normals", False)
        # Only textures would use it.
        properties.take_boolean("flip_tex_coords", True)
        key = (element.type, name)
        if key not in self._mesh_files:
            data = self._folder.read(blame, name)
            self._mesh_files[key] = read_mesh(data, element.type, f"{blame.file}, line {blame.line}: {name}")
        return self._placed(element, self._mesh_files[key], to_world, smooth, flip), None

    def _sphere(self, properties: Properties, to_world: F8, flip: bool) -> tuple[Analytic, None]:
        """Unit sphere around the origin; center and radius act before to_world."""
        center = properties.take_point("center", (0.0, 0.0, 0.0))
        radius = properties.take_float("radius", 1.0, above=0.0)
        scale = uniform_scale(to_world[:3, :3])
        if scale is None:
            raise properties.element.error(
                "to_world stretches the sphere into an ellipsoid; scale x, y and z alike, or use a mesh"
            )
        side = -1.0 if flip != mirrors(to_world) else 1.0
        world_center = transform_points(to_world, center[None, :])[0]
        return Analytic(SPHERE, world_center, np.array([side, 0.0, 0.0]), radius * scale), None

    def _disk(self, properties: Properties, to_world: F8, flip: bool) -> tuple[Analytic, F8]:
        """Unit disk in z = 0, facing +z."""
        scale = uniform_scale(to_world[:3, :2])
        if scale is None:
            raise properties.element.error("to_world stretches the disk into an ellipse; scale x and y alike")
        normal = transform_normals(to_world, np.array([[0.0, 0.0, -1.0 if flip else 1.0]]))[0]
        return Analytic(DISK, to_world[:3, 3].copy(), normal, scale), _half_edges(to_world, 1.0, normal)


def _half_edges(to_world: F8, half: float, normal: F8) -> F8:
    edges = half * to_world[:3, :2].T
    if np.dot(np.cross(edges[0], edges[1]), normal) < 0.0:
        edges = edges * np.array([[1.0], [-1.0]])
    return edges


def _cube_file() -> MeshFile:
    vertices: list[F8] = []
    normals: list[F8] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            normal = np.eye(3)[axis] * side
            u = np.eye(3)[(axis + 1) % 3]
            v = np.cross(normal, u)
            start = len(vertices)
            vertices += [normal - u - v, normal + u - v, normal + u + v, normal - u + v]
            faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
            normals += [normal] * 4
    return MeshFile(np.array(vertices), np.array(faces, dtype=np.int64), np.array(normals))


_CUBE = _cube_file()
_RECTANGLE = MeshFile(
    np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int64),
    np.array([[0.0, 0.0, 1.0]] * 4),
)
