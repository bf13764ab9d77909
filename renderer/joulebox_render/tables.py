"""The scene as flat arrays that kernels take as one argument."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.close_lights import CLOSE
from joulebox_render.records import DISK_LIGHT, ENVIRONMENT, F4, F8, I4, MESH_LIGHT, RECTANGLE_LIGHT, U1, Scene


class SceneTables(NamedTuple):
    """Arrays of `records.Scene`, `Materials` (material_*) and `Lights` (light_*), with what is derived from them.

    mesh_area      (T,) f8  cumulative share of a mesh light's area up to each triangle, 0 elsewhere
    light_close    (L,) f8  distance from a flat light's position [m] within which points may be close to it, see
                   kernels.close_lights; 0 for lights that are never close
    sky            (3,) f4  radiance of the environment, black where there is none
    epsilon        (1,) f8  distance by which ray origins leave a surface [m]
    """

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
    material_kind: I4
    material_albedo: F4
    material_glossy: F4
    material_exponent: F4
    material_ior: F4
    material_two_sided: U1
    light_kind: I4
    light_radiance: F4
    light_position: F4
    light_edge_u: F4
    light_edge_v: F4
    light_normal: F4
    light_radius: F4
    light_area: F4
    light_cone_cos: F4
    light_triangle_first: I4
    light_triangle_count: I4
    light_power: F4
    mesh_area: F8
    light_close: F8
    sky: F4
    epsilon: F8


def bounding_radius(scene: Scene) -> float:
    """Half the diagonal of the scene's bounding box, surfaces and camera included [m]."""
    low = [scene.camera.to_world[:3, 3]]
    high = [scene.camera.to_world[:3, 3]]
    if len(scene.vertices):
        low.append(scene.vertices.min(axis=0))
        high.append(scene.vertices.max(axis=0))
    if len(scene.analytic_kind):
        low.append((scene.analytic_center - scene.analytic_radius[:, None]).min(axis=0))
        high.append((scene.analytic_center + scene.analytic_radius[:, None]).max(axis=0))
    return float(0.5 * np.linalg.norm(np.max(high, axis=0) - np.min(low, axis=0)))


def scene_tables(scene: Scene) -> SceneTables:
    """Flatten a scene for the kernels."""
    materials, lights = scene.materials, scene.lights
    corners = scene.vertices[scene.triangles].astype(np.float64).reshape(-1, 3, 3)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = np.zeros(len(area))
    for row in np.flatnonzero(lights.kind == MESH_LIGHT):
        first = lights.triangle_first[row]
        rows = slice(first, first + lights.triangle_count[row])
        share[rows] = np.cumsum(area[rows]) / area[rows].sum()
    return SceneTables(
        **{name: np.ascontiguousarray(getattr(scene, name)) for name in SceneTables._fields[:10]},
        **{f"material_{name}": np.ascontiguousarray(column) for name, column in vars(materials).items()},
        **{f"light_{name}": np.ascontiguousarray(column) for name, column in vars(lights).items()},
        mesh_area=share,
        light_close=_close_distances(scene),
        sky=lights.radiance[lights.kind == ENVIRONMENT].sum(axis=0, dtype=np.float32),
        epsilon=np.array([1e-5 * bounding_radius(scene)]),
    )


def _close_distances(scene: Scene) -> F8:
    """See SceneTables.light_close: the radius of a ball around each light, and how far from it samples can be CLOSE."""
    lights = scene.lights
    distances = np.zeros(len(lights.kind))
    for row, kind in enumerate(lights.kind):
        if kind == RECTANGLE_LIGHT:
            radius = float(np.hypot(np.linalg.norm(lights.edge_u[row]), np.linalg.norm(lights.edge_v[row])))
        elif kind == DISK_LIGHT:
            radius = float(np.linalg.norm(lights.edge_u[row]))
        elif kind == MESH_LIGHT:
            first = lights.triangle_first[row]
            corners = scene.vertices[scene.triangles[first : first + lights.triangle_count[row]]]
            radius = float(np.linalg.norm(corners - lights.position[row], axis=-1).max())
        else:
            continue
        distances[row] = radius + np.sqrt(float(lights.area[row]) / (np.pi * CLOSE))
    return distances
