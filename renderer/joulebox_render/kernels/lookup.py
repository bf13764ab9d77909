"""Look-ups of precomputed irradiance: the nearest record, and a hash table over cells of place and normal.

A cell is a cube of the table's edge and a range of normals. Normals in one range are at most 44 degrees apart, so
the two sides of a wall and the walls of a corner never share a cell.
"""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.gathering import short_ray
from joulebox_render.kernels.kdtree import nearest_point
from joulebox_render.kernels.rng import mix
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.transport import push_point
from joulebox_render.kernels.vector import row3, set_row3, tangent_frame

DIFFUSE = 0
# A cell's key: 19 bits for each coordinate and 7 for the normal; no normal's code reaches 127.
CELLS_A_SIDE = 1 << 19
NO_CELL = np.uint64(0xFFFFFFFFFFFFFFFF)
# Ranges of a normal's components. Their bounds, +-0.217 and +-0.652, keep clear of the components of normals that
# scenes are full of (0, 1 and the sines of multiples of 15 degrees), which rounding must not scatter.
RANGES = 2.3
# Distance of the points that mark cells, in edges: closer ones would meet few cells more.
LATTICE = 0.75
# What a cell is trusted with: nothing, rays that come from far away, all rays that are not short.
NEVER, FROM_AFAR, ALWAYS = 0.0, 0.5, 1.0
# How many times as far a ray must come to be told by a cell beside which something stands.
BESIDE = 2.0
INVERSE_PI = 1.0 / math.pi
# Rays that feel whether a cell is all in one place.
FEELERS = 5
# What is unsure about a point because no cell holds it.
OUTSIDE = 2


@device
def cell_key(table, x, y, z, nx, ny, nz):
    """Key of the cell of a point and its normal, NO_CELL beyond the table's cube."""
    u = (x - table.low[0]) * table.cells_per_m
    v = (y - table.low[1]) * table.cells_per_m
    w = (z - table.low[2]) * table.cells_per_m
    if min(u, v, w) < 0.0 or max(u, v, w) >= CELLS_A_SIDE:
        return NO_CELL
    i, j, k = np.int64(u), np.int64(v), np.int64(w)
    a, b, c = np.int64(nx * RANGES + 2.5), np.int64(ny * RANGES + 2.5), np.int64(nz * RANGES + 2.5)
    return np.uint64((((i << 19 | j) << 19 | k) << 7) | ((a * 5 + b) * 5 + c))


@device
def find_slot(keys, key):
    """Slot of a key, or the empty one where it would go; linear probing from a hash of the key."""
    last = np.uint64(keys.shape[0] - 1)
    slot = mix(key) & last
    while keys[slot] != key and keys[slot] != NO_CELL:
        slot = (slot + np.uint64(1)) & last
    return slot


@kernel
def mark_cells(table, position, normal, lift, steps, recent, cells):
    """List the cells at and around records, in the records' order; returns how many.

    Of the table it asks only where cells lie. position, normal (R, 3) f4 are the records'. A record marks the cells
    that a lattice of LATTICE of a cell's edge on its tangent plane meets, `steps` points to each side, lifted by `lift`
    [m] as the points are that will be looked up. cells (MarkedCells with room for all these points) is overwritten: key
    of each cell, position and normal of the place that stands for it, its centre dropped onto the plane, which unlike
    the record's place does not depend on where photons happened to land. recent (a power of two,) u8 holds NO_CELL at
    first, and then the keys listed last: of a cell's further mentions it keeps out nearly all, never its first.
    """
    count = 0
    edge = 1.0 / table.cells_per_m
    mask = np.uint64(recent.shape[0] - 1)
    for record in range(position.shape[0]):
        px, py, pz = row3(position, record)
        nx, ny, nz = row3(normal, record)
        sx, sy, sz, tx, ty, tz = tangent_frame(nx, ny, nz)
        for along in range(-steps, steps + 1):
            for across in range(-steps, steps + 1):
                a, b = LATTICE * edge * along, LATTICE * edge * across
                x, y, z = px + a * sx + b * tx, py + a * sy + b * ty, pz + a * sz + b * tz
                key = cell_key(table, x + lift * nx, y + lift * ny, z + lift * nz, nx, ny, nz)
                place = mix(key) & mask
                if key == NO_CELL or recent[place] == key:
                    continue
                recent[place] = cells.key[count] = key
                cx = table.low[0] + (np.int64(key >> np.uint64(45)) + 0.5) * edge
                cy = table.low[1] + (np.int64((key >> np.uint64(26)) & np.uint64(CELLS_A_SIDE - 1)) + 0.5) * edge
                cz = table.low[2] + (np.int64((key >> np.uint64(7)) & np.uint64(CELLS_A_SIDE - 1)) + 0.5) * edge
                above = (cx - px) * nx + (cy - py) * ny + (cz - pz) * nz
                set_row3(cells.position, count, cx - above * nx, cy - above * ny, cz - above * nz)
                set_row3(cells.normal, count, nx, ny, nz)
                count += 1
    return count


@kernel
def enter_cells(keys, marked, slots, rows):
    """Enter marked cells (M,) u8 into a table's keys, in order; returns how many, -1 where it would be over half full.

    keys (a power of two,) u8 holds NO_CELL everywhere. For the n-th new cell slots[n] gets its slot, rows[n] the row of
    its first mention. One thread does this, so that the table is always the same.
    """
    most = keys.shape[0] // 2
    count = 0
    for row in range(marked.shape[0]):
        key = marked[row]
        slot = find_slot(keys, key)
        if keys[slot] == key:
            continue
        if count == most:
            return -1
        keys[slot] = key
        slots[count], rows[count] = slot, row
        count += 1
    return count


@kernel
def nearest_records(tree, position, normal, reach, cos_limit, scratch, row):
    """Row (Q,) i4 of the record nearest to each point, -1 where none lies within `reach` [m]."""
    for q in range(position.shape[0]):
        x, y, z = row3(position, q)
        nx, ny, nz = row3(normal, q)
        row[q] = nearest_point(tree, x, y, z, nx, ny, nz, cos_limit, reach * reach, scratch)


@kernel
def aim_feelers(tree, row, position, normal, lift, length, origin, direction, limit):
    """FEELERS rays from each place: along the surface to four sides, `length` [m] far, and to the record of its row.

    position, normal (Q, 3) f4; origin, direction (FEELERS Q, 3) and limit (FEELERS Q,) f4 are overwritten. Rays start
    and end `lift` [m] above the surface.
    """
    for q in range(position.shape[0]):
        nx, ny, nz = row3(normal, q)
        px, py, pz = row3(position, q)
        px, py, pz = px + lift * nx, py + lift * ny, pz + lift * nz
        sx, sy, sz, tx, ty, tz = tangent_frame(nx, ny, nz)
        rx, ry, rz = px + sx, py + sy, pz + sz
        if row[q] >= 0:
            ex, ey, ez = row3(tree.position, row[q])
            mx, my, mz = row3(tree.normal, row[q])
            rx, ry, rz = ex + lift * mx, ey + lift * my, ez + lift * mz
        dx, dy, dz = rx - px, ry - py, rz - pz
        distance = max(1e-30, math.sqrt(dx * dx + dy * dy + dz * dz))
        for side in range(FEELERS):
            out = FEELERS * q + side
            set_row3(origin, out, px, py, pz)
            limit[out] = length
            if side == 0:
                set_row3(direction, out, dx / distance, dy / distance, dz / distance)
                limit[out] = distance
            elif side < 3:
                sign = 3.0 - 2.0 * side
                set_row3(direction, out, sign * sx, sign * sy, sign * sz)
            else:
                sign = 7.0 - 2.0 * side
                set_row3(direction, out, sign * tx, sign * ty, sign * tz)


@kernel
def look_up_irradiance(table, tree, records, doubtful, position, normal, reach, cos_limit, scratch, irradiance, unsure):
    """Irradiance of each point's cell, or of the record nearest to it where the table has no such cell.

    irradiance (Q, 3) f4 [W m^-2] and unsure (Q,) u1 are overwritten; unsure is 1 where the cell is, OUTSIDE where there
    is none; in a table without cells 1 where no record lies within `reach` [m] or it is marked in doubtful (R,) u1. As
    the nearest record but for a cell's size, and five to ten times as fast; returns how many cells were met.
    Source: Christensen 1999.
    """
    met, has_cells = 0, table.key.shape[0] > 1
    for q in range(position.shape[0]):
        x, y, z = row3(position, q)
        nx, ny, nz = row3(normal, q)
        key = cell_key(table, x, y, z, nx, ny, nz)
        slot = find_slot(table.key, key)
        if table.key[slot] != NO_CELL:
            for c in range(3):
                irradiance[q, c] = table.light[slot, c]
            unsure[q] = table.light[slot, 3] < ALWAYS
            met += 1
            continue
        row = nearest_point(tree, x, y, z, nx, ny, nz, cos_limit, reach * reach, scratch)
        # Nothing is known of the way from a place between the cells to its record.
        unsure[q] = OUTSIDE if has_cells else row < 0 or doubtful[row] > 0
        for c in range(3):
            irradiance[q, c] = records[row, c] if row >= 0 else 0.0
    return met


@device
def trusted(table, slot, key, sample, distance, resolution):
    """Whether a slot may answer a ray that came so far [m]; see IrradianceTable.light."""
    if table.key[slot] == NO_CELL or table.light[slot, 3] == NEVER:
        return False
    beside = BESIDE if table.light[slot, 3] == FROM_AFAR else 1.0
    return not short_ray(key, sample, distance, beside * resolution)


@kernel
def answer_rays(tables, table, resolution, rays, hits, radiance, near, rest):
    """Add weight x albedo / pi x irradiance of the cell that each ray ends in to its owner, where it may be trusted.

    Diffuse points whose cell may not, or that have none, go to near (Points), as `advance` would write them; the rows
    of rays that end at other surfaces to rest (N,) i4. Both are overwritten, in the order of the rays; returns how
    many there are of either. radiance (owners, 3) f8.
    """
    epsilon = tables.epsilon[0]
    near_count, rest_count = 0, 0
    for i in range(rays.owner.shape[0]):
        primitive = hits.primitive[i]
        if primitive < 0:
            continue
        material = tables.material[primitive]
        if tables.material_kind[material] != DIFFUSE:
            rest[rest_count] = i
            rest_count += 1
            continue
        front, px, py, pz, gx, gy, gz, sx, sy, sz = surface_at_hit(tables, rays, hits, i, primitive)
        if not (front or tables.material_two_sided[material]):
            continue
        x, y, z = px + epsilon * gx, py + epsilon * gy, pz + epsilon * gz
        slot = find_slot(table.key, cell_key(table, x, y, z, sx, sy, sz))
        owner, key, sample = rays.owner[i], rays.key[i], rays.sample[i]
        ax, ay, az = row3(tables.material_albedo, material)
        wx, wy, wz = row3(rays.weight, i)
        if trusted(table, slot, key, sample, hits.distance[i], resolution):
            radiance[owner, 0] += wx * ax * INVERSE_PI * table.light[slot, 0]
            radiance[owner, 1] += wy * ay * INVERSE_PI * table.light[slot, 1]
            radiance[owner, 2] += wz * az * INVERSE_PI * table.light[slot, 2]
            continue
        push_point(
            near, near_count, x, y, z, gx, gy, gz, sx, sy, sz, ax, ay, az, wx, wy, wz,
            owner, key, sample, hits.distance[i],
        )  # fmt: skip
        near_count += 1
    return near_count, rest_count
