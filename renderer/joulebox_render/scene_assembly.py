"""The shapes of a scene as the arrays of Scene: all triangles first, then the analytic shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from joulebox_render.meshes import Mesh
from joulebox_render.records import F4, F8, I4
from joulebox_render.scene_lights import Light, area_light
from joulebox_render.scene_shapes import Analytic, Shape
from joulebox_render.scene_transforms import fits_single


@dataclass(frozen=True)
class Geometry:
    """The geometric fields of Scene, see there; `lights` holds one row an emitting shape."""

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
    lights: list[Light]

    @property
    def corners(self) -> F8:
        """Corners (2, 3) of the bounding box [m]."""
        reach = self.analytic_radius[:, None]
        low = np.concatenate([self.vertices, self.analytic_center - reach]).min(axis=0)
        high = np.concatenate([self.vertices, self.analytic_center + reach]).max(axis=0)
        return np.array([low, high], dtype=np.float64)


def assemble(shapes: Sequence[Shape], notes: list[str]) -> Geometry:
    """All shapes in one set of arrays; adds a sentence to `notes` for what is left out.

    A shape that emits nothing at all is no light: it could be sampled for nothing.
    """
    meshes = [(shape, shape.surface) for shape in shapes if isinstance(shape.surface, Mesh)]
    analytics = [(shape, shape.surface) for shape in shapes if isinstance(shape.surface, Analytic)]
    lights: list[Light] = []
    material: list[int] = []
    light: list[int] = []
    vertex_first, triangle_first, triangles = 0, 0, []
    for shape, mesh in meshes:
        count = len(mesh.triangles)
        triangles.append(mesh.triangles + vertex_first)
        light += [_light_row(shape, triangle_first, lights, notes)] * count
        material += [shape.material] * count
        vertex_first += len(mesh.vertices)
        triangle_first += count
        if mesh.dropped:
            notes.append(f"line {shape.element.line}: {mesh.dropped} triangles without area are left out.")
    for shape, _ in analytics:
        light.append(_light_row(shape, 0, lights, notes))
        material.append(shape.material)
    return Geometry(
        vertices=_stack([mesh.vertices for _, mesh in meshes], (0, 3)),
        triangles=np.ascontiguousarray(np.concatenate([np.zeros((0, 3), np.int64), *triangles]), dtype=np.int32),
        corner_normals=_stack([mesh.corner_normals for _, mesh in meshes], (0, 3, 3)),
        face_normals=_stack([mesh.face_normals for _, mesh in meshes], (0, 3)),
        analytic_kind=np.array([surface.kind for _, surface in analytics], dtype=np.int32),
        analytic_center=np.array([surface.center for _, surface in analytics], dtype=np.float32).reshape(-1, 3),
        analytic_normal=np.array([surface.normal for _, surface in analytics], dtype=np.float32).reshape(-1, 3),
        analytic_radius=np.array([surface.radius for _, surface in analytics], dtype=np.float32),
        material=np.array(material, dtype=np.int32),
        light=np.array(light, dtype=np.int32),
        lights=lights,
    )


def _light_row(shape: Shape, triangle_first: int, lights: list[Light], notes: list[str]) -> int:
    """The row of the shape's light, appended to `lights`; -1 when it emits nothing."""
    if shape.radiance is None:
        return -1
    if not shape.radiance.any():
        notes.append(f"line {shape.element.line}: the emitter has radiance 0 and is no light.")
        return -1
    light = area_light(shape, shape.radiance, triangle_first)
    if not fits_single(light.power):
        raise shape.element.error("the shape emits too much light for single precision; lower its radiance")
    lights.append(light)
    return len(lights) - 1


def _stack(parts: list[F8], empty: tuple[int, ...]) -> F4:
    return np.ascontiguousarray(np.concatenate([np.zeros(empty), *parts]), dtype=np.float32)
