"""Walks a bounding volume hierarchy over triangles, for machines that Embree has no build for.

A node is one row of 16 numbers, 64 bytes: the boxes of its two children (each lowest x y z, highest x y z), then in
columns 12 and 13, as whole numbers, where each child is: >= 0 the row of a node, else ~(8 first + count - 1) for a leaf
of `count` triangles that lie together from row `first`. `box` and `link` are the same memory as f4 and as i4.
"""

import numpy as np

from joulebox_render.kernels.bvh_build import MAX_LEAF
from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.vector import row3

ZERO, ONE = np.float32(0.0), np.float32(1.0)
# A direction's component counts as at least this: its reciprocal stays finite, no path bends by what float32 shows.
STEEP = np.float32(1e-15)
# Reciprocals are rounded by more than the three roundings of a slab's distance, so no box is missed (after Ize 2013).
INWARD, OUTWARD = np.float32(1.0 - 4 * 2.0**-23), np.float32(1.0 + 4 * 2.0**-23)


@device
def reciprocal(d):
    """1 / d, of finite size."""
    if abs(d) < STEEP:
        return -ONE / STEEP if d < ZERO else ONE / STEEP
    return ONE / d


@device
def slab_frame(ox, oy, oz, dx, dy, dz):
    """What boxes are tested with: origin, reciprocals rounded inwards and outwards, columns of the nearer faces."""
    ix, iy, iz = reciprocal(dx), reciprocal(dy), reciprocal(dz)
    near = (3 * (ix < ZERO), 1 + 3 * (iy < ZERO), 2 + 3 * (iz < ZERO))
    return (ox, oy, oz), (ix * INWARD, iy * INWARD, iz * INWARD), (ix * OUTWARD, iy * OUTWARD, iz * OUTWARD), near


@device
def box_entry(box, node, child, frame, limit):
    """Where a ray enters a node's child's box: (whether it does before `limit`, distance)."""
    (ox, oy, oz), (ix, iy, iz), (jx, jy, jz), (x, y, z) = frame
    c = 6 * child
    near = max((box[node, c + x] - ox) * ix, max((box[node, c + y] - oy) * iy, (box[node, c + z] - oz) * iz))
    x, y, z = 3 - x, 5 - y, 7 - z
    far = min((box[node, c + x] - ox) * jx, min((box[node, c + y] - oy) * jy, (box[node, c + z] - oz) * jz))
    return max(near, ZERO) <= min(far, limit), near


@device
def shear_frame(ox, oy, oz, dx, dy, dz):
    """What triangles are tested with: axes in turn, the direction's longest one last; origin and shear along them."""
    if abs(dx) > abs(dy) and abs(dx) > abs(dz):
        return (1, 2, 0), (oy, oz, ox), (dy / dx, dz / dx, ONE / dx)
    if abs(dy) > abs(dz):
        return (2, 0, 1), (oz, ox, oy), (dz / dy, dx / dy, ONE / dy)
    return (0, 1, 2), (ox, oy, oz), (dx / dz, dy / dz, ONE / dz)


@device
def triangle_hit(corner, row, frame):
    """Distance to one triangle and its barycentrics u, v (weights of the second and third corner); -1: a miss.

    Watertight: the corners are sheared into the ray's frame (Woop et al. 2013) in float32, alike for all triangles
    that share them, and the edges' signs follow exactly because float64 holds a product of two float32 unrounded.
    Where the signs of a, b and c differ, the ray passes outside.
    """
    (kx, ky, kz), (ox, oy, oz), (sx, sy, sz) = frame
    az, bz, cz = corner[row, kz] - oz, corner[row, 3 + kz] - oz, corner[row, 6 + kz] - oz
    ax, ay = np.float64((corner[row, kx] - ox) - sx * az), np.float64((corner[row, ky] - oy) - sy * az)
    bx, by = np.float64((corner[row, 3 + kx] - ox) - sx * bz), np.float64((corner[row, 3 + ky] - oy) - sy * bz)
    cx, cy = np.float64((corner[row, 6 + kx] - ox) - sx * cz), np.float64((corner[row, 6 + ky] - oy) - sy * cz)
    a, b, c = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    whole = a + b + c
    if (min(a, min(b, c)) < 0.0 and max(a, max(b, c)) > 0.0) or whole == 0.0:
        return -ONE, ZERO, ZERO
    share = 1.0 / whole
    return np.float32((a * az + b * bz + c * cz) * share * sz), np.float32(b * share), np.float32(c * share)


@device
def walk(bvh, ox, oy, oz, dx, dy, dz, limit, any_hit, stack):
    """The nearest triangle on a ray before `limit`, or any: distance, row of bvh.primitive (-1: none), u, v.

    Children are visited nearer first; stack.node and .distance hold those yet to be visited.
    """
    slabs, shear = slab_frame(ox, oy, oz, dx, dy, dz), shear_frame(ox, oy, oz, dx, dy, dz)
    best, found, u, v = limit, -1, ZERO, ZERO
    size = 0
    node = bvh.link[0, 12]
    while True:
        if node >= 0:
            first, second = bvh.link[node, 12], bvh.link[node, 13]
            hit1, near1 = box_entry(bvh.box, node, 0, slabs, best)
            hit2, near2 = box_entry(bvh.box, node, 1, slabs, best)
            if hit1 and hit2:
                if near2 < near1:
                    first, second, near2 = second, first, near1
                stack.node[size], stack.distance[size] = second, near2
                size += 1
            if hit1 or hit2:
                node = first if hit1 else second
                continue
        else:
            start = ~node // MAX_LEAF
            for row in range(start, start + 1 + ~node % MAX_LEAF):
                t, b, c = triangle_hit(bvh.corner, row, shear)
                if ZERO < t < best:
                    best, found, u, v = t, row, b, c
                    if any_hit:
                        return best, found, u, v
        while True:
            if size == 0:
                return best, found, u, v
            size -= 1
            if stack.distance[size] < best:
                break
        node = stack.node[size]


@kernel
def closest_triangles(bvh, origin, direction, stack, distance, primitive, u, v):
    """Nearest triangle of each ray; distance, u, v (N,) f4 and primitive (N,) i4 are overwritten where there is one."""
    for i in range(origin.shape[0]):
        ox, oy, oz = row3(origin, i)
        dx, dy, dz = row3(direction, i)
        t, row, b, c = walk(bvh, ox, oy, oz, dx, dy, dz, distance[i], False, stack)
        if row >= 0:
            distance[i], primitive[i], u[i], v[i] = t, bvh.primitive[row], b, c


@kernel
def occluded_triangles(bvh, origin, direction, limit, stack, blocked):
    """Mark rays that a triangle blocks before `limit` (N,) f4; blocked (N,) u1 is or-ed into."""
    for i in range(origin.shape[0]):
        ox, oy, oz = row3(origin, i)
        dx, dy, dz = row3(direction, i)
        _, row, _, _ = walk(bvh, ox, oy, oz, dx, dy, dz, limit[i], True, stack)
        if row >= 0:
            blocked[i] = 1
