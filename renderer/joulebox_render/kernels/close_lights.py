"""Flat lights from close by: what a light's own samples leave out there is found by rays distributed by cosine."""

import math

import numpy as np

from joulebox_render.kernels.compilation import kernel
from joulebox_render.kernels.lights import light_faces
from joulebox_render.kernels.rng import child_key, fill_2d
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.vector import cosine_direction, row3, set_row3

CLOSE_BRANCH = 1_000_000
# Samples of a flat light that bring more than this many times a whole sky of its radiance are left to rays by cosine,
# whose every hit brings one sky: near a light and where lights meet, the inverse square has no bound.
CLOSE = 2.0


@kernel
def close_points(tables, light, points, first, last, row):
    """Rows of points [first, last) that may be lit from close by; row (last - first,) i4; returns how many.

    A ceiling around its lamp is close to it and gets nothing.
    """
    count, reach = 0, tables.light_close[light]
    cx, cy, cz = row3(tables.light_position, light)
    for i in range(first, last):
        px, py, pz = row3(points.position, i)
        near = (px - cx) ** 2 + (py - cy) ** 2 + (pz - cz) ** 2 < reach * reach
        if near and light_faces(tables, light, points, i):
            row[count] = i
            count += 1
    return count


@kernel
def cosine_rays(points, row, light, count, columns, u, v, rays):
    """Rays by cosine from the points named in row (N,) i4, `count` a point; rays is overwritten, owner the point's row.

    u, v (N count,) f4 are overwritten with what the rays were made of.
    """
    for i in range(row.shape[0]):
        px, py, pz = row3(points.position, row[i])
        nx, ny, nz = row3(points.normal, row[i])
        key = child_key(points.key[row[i]], CLOSE_BRANCH + light)
        fill_2d(key, points.sample[row[i]], 1, 1, count, columns, u, v, i * count)
        for out in range(i * count, (i + 1) * count):
            dx, dy, dz = cosine_direction(nx, ny, nz, u[out], v[out])
            set_row3(rays.origin, out, px, py, pz)
            set_row3(rays.direction, out, dx, dy, dz)
            rays.owner[out] = row[i]


@kernel
def add_close(tables, light, points, first, count, rays, hits, radiance):
    """Add what rays by cosine find of a light that its own samples leave out; radiance (P, 3) f8 counts from `first`.

    A ray finds the light with the density that a sample of it has where this brings more than CLOSE skies, and
    nothing elsewhere: the two estimates share the light's surface between them, so their sum has no bias.
    """
    lx, ly, lz = row3(tables.light_radiance, light)
    for i in range(rays.owner.shape[0]):
        primitive = hits.primitive[i]
        if primitive < 0 or tables.light[primitive] != light:
            continue
        front, _, _, _, gx, gy, gz, _, _, _ = surface_at_hit(tables, rays, hits, i, primitive)
        point, distance = rays.owner[i], np.float64(hits.distance[i])
        dx, dy, dz = row3(rays.direction, i)
        nx, ny, nz = row3(points.normal, point)
        hx, hy, hz = row3(points.geometric, point)
        cos_light, cos_point = -(dx * gx + dy * gy + dz * gz), dx * nx + dy * ny + dz * nz
        skies = tables.light_area[light] * cos_light * cos_point / (math.pi * distance * distance)
        if not front or skies <= CLOSE or dx * hx + dy * hy + dz * hz <= 0.0:
            continue
        ax, ay, az = row3(points.albedo, point)
        radiance[point - first, 0] += ax * lx / count
        radiance[point - first, 1] += ay * ly / count
        radiance[point - first, 2] += az * lz / count
