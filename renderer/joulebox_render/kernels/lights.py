"""Lights: their points, and samples of them as seen from a point."""

import math

import numpy as np

from joulebox_render.kernels.compilation import device
from joulebox_render.kernels.vector import from_frame, row3

POINT_LIGHT, SPOT_LIGHT, RECTANGLE_LIGHT, DISK_LIGHT, SPHERE_LIGHT, MESH_LIGHT, ENVIRONMENT = 0, 1, 2, 3, 4, 5, 6


@device
def spot_falloff(cos_axis, cos_beam, cos_cutoff):
    """Share of a spot light's intensity at an angle from its axis: 1 in the beam, linear in angle to the cutoff."""
    if cos_axis <= cos_cutoff:
        return 0.0
    if cos_axis >= cos_beam:
        return 1.0
    cutoff = math.acos(cos_cutoff)
    return (cutoff - math.acos(cos_axis)) / (cutoff - math.acos(cos_beam))


@device
def cone_cosines(tables, light):
    """Cosines of a spot light's beam and cutoff angles."""
    return tables.light_cone_cos[light, 0], tables.light_cone_cos[light, 1]


@device
def mesh_triangle(tables, light, u):
    """Triangle of a mesh light chosen by area with u, and u made uniform again."""
    first = tables.light_triangle_first[light]
    low, high = first, first + tables.light_triangle_count[light] - 1
    while low < high:
        middle = (low + high) // 2
        if u < tables.mesh_area[middle]:
            high = middle
        else:
            low = middle + 1
    below = tables.mesh_area[low - 1] if low > first else 0.0
    return low, min((u - below) / (tables.mesh_area[low] - below), 0.9999999)


@device
def light_faces(tables, light, points, row):
    """Whether any of a light may shine on a point, as far as the planes of both tell."""
    kind = tables.light_kind[light]
    if kind != RECTANGLE_LIGHT and kind != DISK_LIGHT:
        return True
    px, py, pz = row3(points.position, row)
    cx, cy, cz = row3(tables.light_position, light)
    lx, ly, lz = row3(tables.light_normal, light)
    dx, dy, dz = cx - px, cy - py, cz - pz
    if dx * lx + dy * ly + dz * lz >= 0.0:
        return False
    nx, ny, nz = row3(points.normal, row)
    ux, uy, uz = row3(tables.light_edge_u, light)
    vx, vy, vz = row3(tables.light_edge_v, light)
    # How high the highest corner stands above the point's horizon.
    return dx * nx + dy * ny + dz * nz + abs(ux * nx + uy * ny + uz * nz) + abs(vx * nx + vy * ny + vz * nz) > 0.0


@device
def light_point(tables, light, u, v):
    """Uniform point of an area light and its normal there: (px, py, pz, nx, ny, nz).

    A sphere's light_normal is (1, 0, 0), or (-1, 0, 0) where it emits inwards.
    """
    kind = tables.light_kind[light]
    cx, cy, cz = row3(tables.light_position, light)
    nx, ny, nz = row3(tables.light_normal, light)
    if kind == SPHERE_LIGHT:
        z = 1.0 - 2.0 * u
        r = math.sqrt(max(0.0, 1.0 - z * z))
        phi = 2.0 * math.pi * v
        side = nx
        nx, ny, nz = r * math.cos(phi), r * math.sin(phi), z
        radius = tables.light_radius[light]
        return cx + radius * nx, cy + radius * ny, cz + radius * nz, side * nx, side * ny, side * nz
    if kind == MESH_LIGHT:
        triangle, u = mesh_triangle(tables, light, u)
        root = math.sqrt(u)
        b, c = root * (1.0 - v), root * v
        a = 1.0 - b - c
        i, j, k = row3(tables.triangles, triangle)
        ix, iy, iz = row3(tables.vertices, i)
        jx, jy, jz = row3(tables.vertices, j)
        kx, ky, kz = row3(tables.vertices, k)
        nx, ny, nz = row3(tables.face_normals, triangle)
        return a * ix + b * jx + c * kx, a * iy + b * jy + c * ky, a * iz + b * jz + c * kz, nx, ny, nz
    if kind == DISK_LIGHT:
        r = math.sqrt(u)
        x, y = r * math.cos(2.0 * math.pi * v), r * math.sin(2.0 * math.pi * v)
    else:
        x, y = 2.0 * u - 1.0, 2.0 * v - 1.0
    ux, uy, uz = row3(tables.light_edge_u, light)
    vx, vy, vz = row3(tables.light_edge_v, light)
    return cx + x * ux + y * vx, cy + x * uy + y * vy, cz + x * uz + y * vz, nx, ny, nz


@device
def sphere_light_sample(tables, light, px, py, pz, u, v):
    """Direction uniform in the cone of a sphere seen from outside: (dx, dy, dz, distance, solid angle)."""
    cx, cy, cz = row3(tables.light_position, light)
    # In double precision: r2 is a small difference of squares for small, distant spheres.
    ax, ay, az = np.float64(cx) - px, np.float64(cy) - py, np.float64(cz) - pz
    d2 = ax * ax + ay * ay + az * az
    r2 = np.float64(tables.light_radius[light]) ** 2
    inverse = 1.0 / math.sqrt(d2)
    sin2_max = r2 / d2
    # 1 - cos(theta_max) without cancellation for small, distant spheres.
    spread = sin2_max / (1.0 + math.sqrt(max(0.0, 1.0 - sin2_max)))
    cos_theta = 1.0 - u * spread
    sin_theta = math.sqrt(max(0.0, 1.0 - cos_theta * cos_theta))
    phi = 2.0 * math.pi * v
    dx, dy, dz = from_frame(
        ax * inverse, ay * inverse, az * inverse, sin_theta * math.cos(phi), sin_theta * math.sin(phi), cos_theta
    )
    along = ax * dx + ay * dy + az * dz
    distance = along - math.sqrt(max(0.0, r2 - (d2 - along * along)))
    return dx, dy, dz, distance, 2.0 * math.pi * spread


@device
def light_sample(tables, light, px, py, pz, u, v):
    """Light arriving at a point from one sample of a light: (dx, dy, dz, distance, scale).

    scale * light_radiance = radiance / density of the sample per solid angle [sr] for area lights, and
    intensity / distance^2 for point and spot lights; 0 where the light does not shine at the point.
    """
    kind = tables.light_kind[light]
    if kind == SPHERE_LIGHT and tables.light_normal[light, 0] > 0.0:
        cx, cy, cz = row3(tables.light_position, light)
        d2 = (cx - px) ** 2 + (cy - py) ** 2 + (cz - pz) ** 2
        if d2 <= tables.light_radius[light] ** 2:
            return 0.0, 0.0, 1.0, 0.0, 0.0
        return sphere_light_sample(tables, light, px, py, pz, u, v)
    if kind in (POINT_LIGHT, SPOT_LIGHT):
        qx, qy, qz = row3(tables.light_position, light)
        nx, ny, nz = 0.0, 0.0, 0.0
    else:
        qx, qy, qz, nx, ny, nz = light_point(tables, light, u, v)
    dx, dy, dz = qx - px, qy - py, qz - pz
    d2 = dx * dx + dy * dy + dz * dz
    if d2 == 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0
    # One division: there are many in this loop otherwise, and they are what it waits for.
    inverse = 1.0 / math.sqrt(d2)
    distance = d2 * inverse
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    if kind == POINT_LIGHT:
        return dx, dy, dz, distance, inverse * inverse
    if kind == SPOT_LIGHT:
        ax, ay, az = row3(tables.light_normal, light)
        cos_axis = -(dx * ax + dy * ay + dz * az)
        beam, cutoff = cone_cosines(tables, light)
        return dx, dy, dz, distance, spot_falloff(cos_axis, beam, cutoff) * inverse * inverse
    cos_light = -(dx * nx + dy * ny + dz * nz)
    return dx, dy, dz, distance, max(0.0, cos_light) * tables.light_area[light] * inverse * inverse
