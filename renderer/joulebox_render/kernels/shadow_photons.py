"""Direct and shadow photons: where light rays run through the scene, what they tell, and how it is looked up."""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.lights import DISK_LIGHT, RECTANGLE_LIGHT, SPHERE_LIGHT, light_sample
from joulebox_render.kernels.rng import child_key, mix, path_key, uniform
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.transport import push_ray
from joulebox_render.kernels.vector import row3, set_row3

DIFFUSE, PHONG = 0, 4
UNKNOWN, LIT, HIDDEN, ABSTAINS = 0, 1, 2, 3
BORDER_STREAM = 4
# Points on a light's border that each photon looks at, a multiple of four, and how far out they lie.
BORDER_RAYS = 8
BORDER = 0.995
# A cell's key is three numbers of so many bits.
CELL_BITS = 20
CELLS = 1 << CELL_BITS
EMPTY = np.uint64(0xFFFFFFFFFFFFFFFF)


@kernel
def drop_photons(tables, depth, rays, hits, stored, following):
    """Leave a photon where each ray meets a surface that can be lit there, and send the ray straight on behind it.

    depth      surfaces already met: 0 stores direct photons, more shadow photons
    rays       Rays; owner is the light, sample the number of the emission
    stored     LightPhotons, overwritten, in the order of the rays
    following  Rays, overwritten
    Returns (photons stored, rays going on). Source: Jensen & Christensen 1995.
    """
    epsilon = tables.epsilon[0]
    stored_count, ray_count = 0, 0
    for i in range(rays.origin.shape[0]):
        primitive = hits.primitive[i]
        if primitive < 0:
            continue
        dx, dy, dz = row3(rays.direction, i)
        front, px, py, pz, gx, gy, gz, _, _, _ = surface_at_hit(tables, rays, hits, i, primitive)
        ex, ey, ez = epsilon * gx, epsilon * gy, epsilon * gz
        material = tables.material[primitive]
        kind = tables.material_kind[material]
        if kind in (DIFFUSE, PHONG) and (front or tables.material_two_sided[material]):
            set_row3(stored.position, stored_count, px + ex, py + ey, pz + ez)
            set_row3(stored.normal, stored_count, gx, gy, gz)
            stored.light[stored_count] = rays.owner[i]
            stored.is_shadow[stored_count] = depth > 0
            stored.number[stored_count] = rays.sample[i]
            stored_count += 1
        wx, wy, wz = row3(rays.weight, i)
        push_ray(
            following, ray_count, px - ex, py - ey, pz - ez, dx, dy, dz,
            wx, wy, wz, rays.owner[i], rays.key[i], rays.sample[i],
        )  # fmt: skip
        ray_count += 1
    return stored_count, ray_count


@device
def border_place(kind, i, key):
    """Where point `i` of BORDER_RAYS lies on a light, for `light_sample`: on its outline, or anywhere on a mesh."""
    if kind == RECTANGLE_LIGHT:
        along = BORDER * (8 * (i % (BORDER_RAYS // 4)) / BORDER_RAYS - 1.0)
        side = i * 4 // BORDER_RAYS
        x, y = along, -BORDER
        if side == 1:
            x, y = BORDER, along
        elif side == 2:
            x, y = -along, BORDER
        elif side == 3:
            x, y = -BORDER, -along
        return 0.5 + 0.5 * x, 0.5 + 0.5 * y
    if kind in (DISK_LIGHT, SPHERE_LIGHT):
        return BORDER, i / BORDER_RAYS
    return uniform(key, 2 * i), uniform(key, 2 * i + 1)


@kernel
def border_rays(tables, seed, light, photons, first, last, origin, direction, limit, owner):
    """Shadow rays from photons [first, last) to the border of one light; returns how many were written.

    Only rays above the surface towards what shines at the photon; BORDER_RAYS a photon at most. owner (N,) i8 is the
    photon's row counted from `first`; limit (N,) f4 [m] stops just short of the light.
    """
    written = 0
    stream = path_key(seed, BORDER_STREAM, light)
    for row in range(first, last):
        px, py, pz = row3(photons.position, row)
        gx, gy, gz = row3(photons.normal, row)
        key = child_key(stream, row)
        for i in range(BORDER_RAYS):
            u, v = border_place(tables.light_kind[light], i, key)
            dx, dy, dz, distance, scale = light_sample(tables, light, px, py, pz, u, v)
            if scale <= 0.0 or dx * gx + dy * gy + dz * gz <= 0.0:
                continue
            set_row3(origin, written, px, py, pz)
            set_row3(direction, written, dx, dy, dz)
            limit[written] = distance * (1.0 - 1e-4)
            owner[written] = row - first
            written += 1
    return written


@kernel
def fill_slots(key, cells):
    """Put cell i with key[i] (C,) u8 into a free slot of `cells`, whose number of slots is a power of two."""
    mask = np.uint64(cells.key.shape[0] - 1)
    for i in range(key.shape[0]):
        slot = np.int64(mix(key[i]) & mask)
        while cells.key[slot] != EMPTY:
            slot = np.int64(np.uint64(slot + 1) & mask)
        cells.key[slot] = key[i]
        cells.cell[slot] = i


@kernel
def find_cells(cells, points, first, last, cell):
    """The cell that each point [first, last) lies in, -1 where none is known, into cell (last - first,) i4."""
    mask = np.uint64(cells.key.shape[0] - 1)
    scale = cells.per_m[0]
    for row in range(first, last):
        px, py, pz = row3(points.position, row)
        x, y, z = (px - cells.corner[0]) * scale, (py - cells.corner[1]) * scale, (pz - cells.corner[2]) * scale
        found = -1
        if min(x, y, z) >= 0.0 and max(x, y, z) < CELLS:
            i, j, k = np.uint64(math.floor(x)), np.uint64(math.floor(y)), np.uint64(math.floor(z))
            key = (i << np.uint64(2 * CELL_BITS)) | (j << np.uint64(CELL_BITS)) | k
            slot = np.int64(mix(key) & mask)
            while cells.key[slot] != EMPTY and cells.key[slot] != key:
                slot = np.int64(np.uint64(slot + 1) & mask)
            if cells.key[slot] == key:
                found = cells.cell[slot]
        cell[row - first] = found
