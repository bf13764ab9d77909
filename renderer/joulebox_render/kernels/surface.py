"""Where rays meet surfaces: analytic shapes, and what is known of the surface at a hit.

`tables` is the named tuple `SceneTables` of tables.py; primitives count triangles first, then analytic shapes.
"""

import math

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.vector import normalized, row3

SPHERE = 0


@device
def analytic_distance(tables, shape, ox, oy, oz, dx, dy, dz):
    """Distance along a ray to one analytic shape, -1 where it misses; the direction is a unit vector.

    The sphere's roots are found from the point of the ray nearest to the centre, which keeps float32 origins far
    from a small sphere exact enough (Hearn & Baker's form, as in Ray Tracing Gems, ch. 7).
    """
    cx = ox - tables.analytic_center[shape, 0]
    cy = oy - tables.analytic_center[shape, 1]
    cz = oz - tables.analytic_center[shape, 2]
    radius = tables.analytic_radius[shape]
    if tables.analytic_kind[shape] == SPHERE:
        along = cx * dx + cy * dy + cz * dz
        px, py, pz = cx - along * dx, cy - along * dy, cz - along * dz
        discriminant = radius * radius - (px * px + py * py + pz * pz)
        if discriminant < 0.0:
            return -1.0
        half = math.sqrt(discriminant)
        near = -along - half
        return near if near > 0.0 else -along + half
    nx, ny, nz = row3(tables.analytic_normal, shape)
    slope = nx * dx + ny * dy + nz * dz
    if slope == 0.0:
        return -1.0
    distance = -(nx * cx + ny * cy + nz * cz) / slope
    px, py, pz = cx + distance * dx, cy + distance * dy, cz + distance * dz
    return distance if px * px + py * py + pz * pz <= radius * radius else -1.0


@kernel
def closest_analytic(tables, origin, direction, distance, primitive):
    """Replace hits by analytic shapes that are nearer.

    origin, direction (N, 3) f4; distance (N,) f4 and primitive (N,) i4 of the nearest hit so far, overwritten.
    """
    triangle_count = tables.triangles.shape[0]
    for i in range(origin.shape[0]):
        ox, oy, oz = row3(origin, i)
        dx, dy, dz = row3(direction, i)
        for shape in range(tables.analytic_kind.shape[0]):
            t = analytic_distance(tables, shape, ox, oy, oz, dx, dy, dz)
            if 0.0 < t < distance[i]:
                distance[i] = t
                primitive[i] = triangle_count + shape


@kernel
def occluded_analytic(tables, origin, direction, limit, blocked):
    """Mark rays that an analytic shape blocks before `limit`; blocked (N,) u1 is or-ed into."""
    for i in range(origin.shape[0]):
        if blocked[i]:
            continue
        ox, oy, oz = row3(origin, i)
        dx, dy, dz = row3(direction, i)
        for shape in range(tables.analytic_kind.shape[0]):
            t = analytic_distance(tables, shape, ox, oy, oz, dx, dy, dz)
            if 0.0 < t < limit[i]:
                blocked[i] = 1
                break


@device
def analytic_normal(tables, shape, px, py, pz):
    """Unit normal of an analytic shape at a point of it."""
    nx, ny, nz = row3(tables.analytic_normal, shape)
    if tables.analytic_kind[shape] == SPHERE:
        side = nx
        nx, ny, nz = normalized(
            side * (px - tables.analytic_center[shape, 0]),
            side * (py - tables.analytic_center[shape, 1]),
            side * (pz - tables.analytic_center[shape, 2]),
        )
    return nx, ny, nz


@device
def interpolated(tables, triangle, u, v, c):
    """Component c of a triangle's shading normal at barycentric (u, v), not normalised."""
    a = (1.0 - u - v) * tables.corner_normals[triangle, 0, c]
    return a + u * tables.corner_normals[triangle, 1, c] + v * tables.corner_normals[triangle, 2, c]


@device
def surface_normals(tables, primitive, px, py, pz, u, v):
    """Geometric and shading normal at a point of a primitive, both unit and on its front side."""
    triangle_count = tables.triangles.shape[0]
    if primitive >= triangle_count:
        gx, gy, gz = analytic_normal(tables, primitive - triangle_count, px, py, pz)
        sx, sy, sz = gx, gy, gz
    else:
        gx, gy, gz = row3(tables.face_normals, primitive)
        sx, sy, sz = normalized(
            interpolated(tables, primitive, u, v, 0),
            interpolated(tables, primitive, u, v, 1),
            interpolated(tables, primitive, u, v, 2),
        )
    return gx, gy, gz, sx, sy, sz


@device
def face_forward(gx, gy, gz, sx, sy, sz, dx, dy, dz):
    """Turn both normals against the direction of travel; the first result is 1 on the front, 0 on the back.

    A shading normal that ends on the far side of the ray is replaced by the geometric one.
    """
    front = 1
    if gx * dx + gy * dy + gz * dz > 0.0:
        front = 0
        gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
    if sx * dx + sy * dy + sz * dz > -1e-4:
        sx, sy, sz = gx, gy, gz
    return front, gx, gy, gz, sx, sy, sz


@device
def surface_at_hit(tables, rays, hits, i, primitive):
    """What ray i met: 1 on the front or 0 on the back, the point, and both normals turned against the ray."""
    dx, dy, dz = row3(rays.direction, i)
    ox, oy, oz = row3(rays.origin, i)
    t = hits.distance[i]
    px, py, pz = ox + t * dx, oy + t * dy, oz + t * dz
    gx, gy, gz, sx, sy, sz = surface_normals(tables, primitive, px, py, pz, hits.u[i], hits.v[i])
    front, gx, gy, gz, sx, sy, sz = face_forward(gx, gy, gz, sx, sy, sz, dx, dy, dz)
    return front, px, py, pz, gx, gy, gz, sx, sy, sz
