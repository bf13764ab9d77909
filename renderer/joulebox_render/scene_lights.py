"""The lights of a scene as rows of Lights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from joulebox_render.meshes import Mesh
from joulebox_render.records import (
    DISK,
    DISK_LIGHT,
    ENVIRONMENT,
    F8,
    MESH_LIGHT,
    POINT_LIGHT,
    RECTANGLE_LIGHT,
    SPHERE_LIGHT,
    SPOT_LIGHT,
    Lights,
)
from joulebox_render.scene_shapes import Analytic, Shape
from joulebox_render.scene_transforms import fits_single, uniform_scale
from joulebox_render.scene_values import Properties
from joulebox_render.scene_xml import Element, suggest


def _zeros() -> F8:
    return np.zeros(3)


@dataclass(frozen=True)
class Light:
    """One row of Lights; see there."""

    kind: int
    radiance: F8
    position: F8
    power: F8
    edges: F8 = field(default_factory=lambda: np.zeros((2, 3)))
    normal: F8 = field(default_factory=_zeros)
    radius: float = 0.0
    area: float = 0.0
    cone_cos: tuple[float, float] = (0.0, 0.0)
    triangle_first: int = 0
    triangle_count: int = 0


def area_light(shape: Shape, radiance: F8, triangle_first: int) -> Light:
    """The light that a shape is; `triangle_first` is the row of its first triangle, if it has any."""
    surface = shape.surface
    if isinstance(surface, Analytic):
        kind = DISK_LIGHT if surface.kind == DISK else SPHERE_LIGHT
        area = math.pi * surface.radius**2 * (1.0 if kind == DISK_LIGHT else 4.0)
        return Light(
            kind,
            radiance,
            surface.center,
            math.pi * area * radiance,
            edges=np.zeros((2, 3)) if shape.half_edges is None else shape.half_edges,
            normal=surface.normal,
            radius=surface.radius,
            area=area,
        )
    area = float(surface.areas.sum())
    if shape.half_edges is not None:
        kind, position, edges = RECTANGLE_LIGHT, surface.vertices.mean(axis=0), shape.half_edges
    else:
        kind, position, edges = MESH_LIGHT, _centre(surface), np.zeros((2, 3))
    return Light(
        kind,
        radiance,
        position,
        math.pi * area * radiance,
        edges=edges,
        normal=surface.face_normals[0] if kind == RECTANGLE_LIGHT else np.zeros(3),
        area=area,
        triangle_first=triangle_first,
        triangle_count=len(surface.triangles),
    )


def _centre(mesh: Mesh) -> F8:
    centroids = mesh.vertices[mesh.triangles].mean(axis=1)
    return np.average(centroids, axis=0, weights=mesh.areas)


def read_light(element: Element, objects_by_id: Mapping[str, Element]) -> Light:
    """A point, spot or constant light that stands in the scene by itself; see `surround` for the last."""
    if element.type == "area":
        raise element.error('an "area" emitter belongs inside a <shape>')
    readers = {"point": _point, "spot": _spot, "constant": _constant}
    if element.type not in readers:
        raise element.error(f'unknown emitter "{element.type}"{suggest(element.type, (*readers, "area"))}')
    properties = Properties(element, objects_by_id)
    light = readers[element.type](properties)
    properties.finish()
    if not fits_single(light.power, light.position):
        raise element.error(f"the {element.type} light is too bright or too far away for single precision")
    return light


def _point(properties: Properties) -> Light:
    if properties.has("position") and properties.has("to_world"):
        raise properties.element.error("a point light has a position or a to_world, not both")
    to_world = properties.take_transform("to_world")
    position = properties.take_point("position", (0.0, 0.0, 0.0)) + to_world[:3, 3]
    intensity = properties.take_emission("intensity")
    return Light(POINT_LIGHT, intensity, position, 4.0 * math.pi * intensity)


def _constant(properties: Properties) -> Light:
    """Light from all around, for a ball of radius 1 for now."""
    radiance = properties.take_emission("radiance")
    return Light(ENVIRONMENT, radiance, np.zeros(3), 4.0 * math.pi**2 * radiance, radius=1.0)


def surround(light: Light, corners: F8) -> Light:
    """The environment around a scene, its ball that of the bounding box with corners (2, 3)."""
    radius = 0.5 * float(np.linalg.norm(corners[1] - corners[0])) * 1.0001
    power = 4.0 * (math.pi * radius) ** 2 * light.radiance
    return replace(light, position=corners.mean(axis=0), radius=radius, power=power)


def _spot(properties: Properties) -> Light:
    """At the origin of to_world, along its +z; full up to beam_width, linear in angle to cutoff_angle."""
    blame = properties.line_of("to_world")
    to_world = properties.take_transform("to_world")
    if uniform_scale(to_world[:3, :3]) is None:
        raise blame.error("to_world of a spot light must not stretch; rotate, move or use lookat")
    cutoff_element = properties.line_of("cutoff_angle")
    cutoff_deg = properties.take_float("cutoff_angle", 20.0, above=0.0)
    if cutoff_deg > 90.0:
        raise cutoff_element.error(f'"cutoff_angle" is {cutoff_deg:g}; it must be at most 90 degrees from the axis')
    beam_element = properties.line_of("beam_width")
    beam_deg = properties.take_float("beam_width", 0.75 * cutoff_deg, at_least=0.0)
    if beam_deg > cutoff_deg:
        raise beam_element.error(f'"beam_width" is {beam_deg:g}; it must not exceed cutoff_angle, {cutoff_deg:g}')
    beam, cutoff = math.radians(beam_deg), math.radians(cutoff_deg)
    intensity = properties.take_emission("intensity")
    # Integral of the falloff over the sphere: 2 pi (1 - mean cosine between the two angles).
    mean_cos = math.cos(cutoff) if beam == cutoff else (math.sin(cutoff) - math.sin(beam)) / (cutoff - beam)
    axis = to_world[:3, 2] / np.linalg.norm(to_world[:3, 2])
    return Light(
        SPOT_LIGHT,
        intensity,
        to_world[:3, 3].copy(),
        2.0 * math.pi * (1.0 - mean_cos) * intensity,
        normal=axis,
        cone_cos=(math.cos(beam), math.cos(cutoff)),
    )


def light_table(rows: list[Light]) -> Lights:
    """All rows as arrays."""

    def f4(values: list[F8]) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        return np.array(values, dtype=np.float32).reshape(-1, 3)

    return Lights(
        kind=np.array([row.kind for row in rows], dtype=np.int32),
        radiance=f4([row.radiance for row in rows]),
        position=f4([row.position for row in rows]),
        edge_u=f4([row.edges[0] for row in rows]),
        edge_v=f4([row.edges[1] for row in rows]),
        normal=f4([row.normal for row in rows]),
        radius=np.array([row.radius for row in rows], dtype=np.float32),
        area=np.array([row.area for row in rows], dtype=np.float32),
        cone_cos=np.array([row.cone_cos for row in rows], dtype=np.float32).reshape(-1, 2),
        triangle_first=np.array([row.triangle_first for row in rows], dtype=np.int32),
        triangle_count=np.array([row.triangle_count for row in rows], dtype=np.int32),
        power=f4([row.power for row in rows]),
    )
