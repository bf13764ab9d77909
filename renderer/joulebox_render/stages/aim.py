"""Which way photons are emitted: everywhere, or only where a mirror, glass or a glossy surface may be met.

Jensen's projection map (2001, section 5.3): a light's directions are cut into cells of equal probability, and a
cell is drawn only if a ray in its directions, from anywhere on the light, can meet a ball around such an object.
Every caustic photon meets one first, so none is lost; all that are drawn carry the same share of the light's
flux, so caustics keep their power.
"""

from __future__ import annotations

import math

import numpy as np

from joulebox_render.kernels.emission import AIM_COLUMNS, AIM_ROWS
from joulebox_render.kernels.vector import from_frame
from joulebox_render.records import (
    DISK_LIGHT,
    F8,
    GLASS,
    MIRROR,
    PHONG,
    POINT_LIGHT,
    RECTANGLE_LIGHT,
    SPHERE_LIGHT,
    SPOT_LIGHT,
    Aim,
)
from joulebox_render.tables import SceneTables

# More balls than this cost more to test than they save; then one holds all triangles.
MOST_BALLS = 256
# Points on each edge of a cell that its angular radius is found from, and what is added for the curve between them.
EDGE_POINTS, SLACK_RAD = 9, 1e-3


def aim_everywhere(tables: SceneTables) -> Aim:
    """All directions of all lights, by power."""
    return _aim(tables, [np.zeros(0, np.int32)] * len(tables.light_kind), np.ones(len(tables.light_kind)))


def aim_at_specular(tables: SceneTables) -> Aim:
    """Directions that may meet specular or glossy objects first.

    The directions of mesh lights, whose normals differ from place to place, and of the environment are not limited.
    """
    balls = specular_balls(tables)
    cells, shares = [], []
    for light in range(len(tables.light_kind)):
        marked = _marked_cells(tables, light, balls)
        if marked is None or marked.all():
            cells.append(np.zeros(0, np.int32))
            shares.append(1.0)
        else:
            cells.append(np.flatnonzero(marked).astype(np.int32))
            shares.append(len(cells[-1]) / (AIM_ROWS * AIM_COLUMNS))
    return _aim(tables, cells, np.array(shares))


def _aim(tables: SceneTables, cells: list[np.ndarray], share: F8) -> Aim:
    power = tables.light_power.astype(np.float64).mean(axis=1) * share
    choice = np.cumsum(power) / power.sum() if power.sum() > 0 else np.zeros(len(power))
    first = np.concatenate([[0], np.cumsum([len(rows) for rows in cells])]).astype(np.int64)
    return Aim(choice, share, first, np.concatenate([np.zeros(0, np.int32), *cells]))


def specular_balls(tables: SceneTables) -> F8:
    """Centres and radii (B, 4) of balls that hold everything specular or glossy."""
    specular = np.isin(tables.material_kind[tables.material], (MIRROR, GLASS, PHONG))
    triangle_count = len(tables.triangles)
    analytic = specular[triangle_count:]
    balls = np.column_stack([tables.analytic_center, tables.analytic_radius])[analytic].astype(np.float64)
    triangles = tables.triangles[specular[:triangle_count]]
    if not len(triangles):
        return balls
    # Imported where there are hints to make: scipy takes a while to load.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Triangles that share corners make one object; corners at one place count as one.
    _, corner = np.unique(tables.vertices, axis=0, return_inverse=True)
    corners = corner.reshape(-1)[triangles]
    links = coo_array(
        (np.ones(2 * len(corners)), (np.repeat(corners[:, 0], 2), corners[:, 1:].reshape(-1))),
        shape=(len(tables.vertices),) * 2,
    )
    _, group = connected_components(links, directed=False)
    groups = group[corners[:, 0]]
    if len(np.unique(groups)) > MOST_BALLS:
        groups = np.zeros_like(groups)
    found = [_ball(tables.vertices[triangles[groups == g]].reshape(-1, 3)) for g in np.unique(groups)]
    return np.concatenate([balls, found])


def _ball(points: np.ndarray) -> F8:
    """A ball (4,) around points: the middle of their bounding box and the farthest point from it."""
    exact = points.astype(np.float64)
    centre = 0.5 * (exact.min(axis=0) + exact.max(axis=0))
    return np.append(centre, np.linalg.norm(exact - centre, axis=1).max())


def _marked_cells(tables: SceneTables, light: int, balls: F8) -> np.ndarray | None:
    """Which cells (AIM_ROWS * AIM_COLUMNS,) of a light's directions may meet a ball; None: not to be told."""
    kind = int(tables.light_kind[light])
    if kind not in (POINT_LIGHT, SPOT_LIGHT, RECTANGLE_LIGHT, DISK_LIGHT, SPHERE_LIGHT):
        return None
    edge_u, edge_v = (float(np.linalg.norm(edge[light])) for edge in (tables.light_edge_u, tables.light_edge_v))
    size = {
        RECTANGLE_LIGHT: math.hypot(edge_u, edge_v),
        DISK_LIGHT: edge_u,
        SPHERE_LIGHT: float(tables.light_radius[light]),
    }.get(kind, 0.0)
    axis, radius = _cell_cones(tables, light, kind)
    marked = np.zeros(len(axis), np.bool_)
    for ball in balls:
        towards = ball[:3] - tables.light_position[light]
        distance, reach = float(np.linalg.norm(towards)), ball[3] + size
        if distance <= reach:
            return np.ones(len(axis), np.bool_)
        angle = np.arccos(np.clip(axis @ (towards / distance), -1.0, 1.0))
        marked |= angle <= radius + math.asin(reach / distance) + SLACK_RAD
    return marked


def _cell_cones(tables: SceneTables, light: int, kind: int) -> tuple[F8, F8]:
    """Cones around the directions of each cell: axes (cells, 3) and half angles (cells,) [rad]."""
    row, column = np.divmod(np.arange(AIM_ROWS * AIM_COLUMNS), AIM_COLUMNS)
    middle = _directions(tables, light, kind, (row + 0.5) / AIM_ROWS, (column + 0.5) / AIM_COLUMNS)
    half_angle = np.zeros(len(row))
    for a, b in np.ndindex(EDGE_POINTS, EDGE_POINTS):
        across, along = a / (EDGE_POINTS - 1), b / (EDGE_POINTS - 1)
        edge = _directions(tables, light, kind, (row + across) / AIM_ROWS, (column + along) / AIM_COLUMNS)
        half_angle = np.maximum(half_angle, np.arccos(np.clip((middle * edge).sum(axis=1), -1.0, 1.0)))
    return middle, half_angle


def _directions(tables: SceneTables, light: int, kind: int, u: F8, v: F8) -> F8:
    """Directions (N, 3) that kernels.emission.emitted_ray makes of u and v."""
    phi = 2.0 * np.pi * v
    if kind in (POINT_LIGHT, SPHERE_LIGHT):
        z = 1.0 - 2.0 * u
    elif kind == SPOT_LIGHT:
        z = 1.0 - u * (1.0 - float(tables.light_cone_cos[light, 1]))
    else:
        z = np.sqrt(np.maximum(0.0, 1.0 - u))
    r = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    local = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
    if kind in (POINT_LIGHT, SPHERE_LIGHT):
        return local
    normal = [float(x) for x in tables.light_normal[light]]
    frame = np.array([from_frame(*normal, *axis) for axis in np.eye(3).tolist()])
    turned: F8 = local @ frame
    return turned
