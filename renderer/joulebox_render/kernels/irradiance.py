"""The irradiance cache: what a final gather tells about its neighbourhood, and how others use it.

Sources: Ward, Rubinstein & Clear 1988 (reuse by harmonic mean distance); Ward & Heckbert 1992 (gradients);
Krivanek et al. 2006 (neighbour clamping); Tabellion & Lamorlette 2004 (weights that fall to zero).
"""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.vector import row3, set_row3, tangent_frame

# A record is not used for points this far behind its tangent plane, relative to its radius.
BEHIND = 0.05
# sin^2 of the polar angle, 80 degrees, from which on a surface is seen edge-on.
EDGE_ON = 0.97
# The square of a gather's mean radiance below which it counts as dark, and not as doubtful.
DARK = 1e-30
_P1, _P2, _P3 = np.uint64(73856093), np.uint64(19349663), np.uint64(83492791)


@device
def bucket_of(cx, cy, cz, mask):
    """Bucket of an integer cell."""
    return np.int64((np.uint64(cx) * _P1 ^ np.uint64(cy) * _P2 ^ np.uint64(cz) * _P3) & np.uint64(mask))


@device
def grid_gradients(incident, nearness, row, strata, c):
    """What channel c of a gather's grid, whose first ray is `row`, says of irradiance: (mean incident radiance, its
    translational gradient, its rotational gradient), each gradient as its two components in the tangent frame.

    nearness (N,) f4 is one over the rays' lengths [1/m]. Source: Ward & Heckbert 1992, with exact integrals over a
    stratum's side.
    """
    polar, azimuth = strata.ring.shape[0], strata.spoke.shape[0]
    total, across_x, across_y, turn_x, turn_y = 0.0, 0.0, 0.0, 0.0, 0.0
    before = row + (azimuth - 1) * polar
    for k in range(azimuth):
        here = row + k * polar
        outward, sideways, turning = 0.0, 0.0, 0.0
        inner, inner_nearness = 0.0, np.float32(0.0)
        for j in range(polar):
            light, near = incident[here + j, c], nearness[here + j]
            total += light
            turning += light * strata.ring[j, 0]
            outward += strata.ring[j, 1] * max(near, inner_nearness) * (light - inner)
            sideways += strata.ring[j, 2] * max(near, nearness[before + j]) * (light - incident[before + j, c])
            inner, inner_nearness = light, near
        before = here
        cos_phi, sin_phi, cos_edge, sin_edge = (
            strata.spoke[k, 0], strata.spoke[k, 1], strata.spoke[k, 2], strata.spoke[k, 3],
        )  # fmt: skip
        across_x += cos_phi * outward - sin_edge * sideways
        across_y += sin_phi * outward + cos_edge * sideways
        turn_x -= sin_phi * turning
        turn_y += cos_phi * turning
    count = polar * azimuth
    return total / count, across_x, across_y, turn_x * math.pi / count, turn_y * math.pi / count


@device
def reach_of_gather(distance, row, strata, tolerance):
    """Harmonic mean distance of a gather's rays, or the nearest not seen edge-on over the tolerance if less [m].

    distance is overwritten with one over itself.
    """
    polar, count = strata.ring.shape[0], strata.ring.shape[0] * strata.spoke.shape[0]
    total, nearest = 0.0, np.float32(0.0)
    for first in range(row, row + count, polar):
        for j in range(polar):
            near = np.float32(1.0) / max(np.float32(1e-12), distance[first + j])
            distance[first + j] = near
            total += near
            if (j + 0.5) < EDGE_ON * polar:
                nearest = max(nearest, near)
    return min(count / total, 1.0 / (nearest * tolerance))


@kernel
def summarize_gather(points, first, strata, tolerance, incident, distance, near, far, cache, row):
    """Make records of final gathers over stratified cosine grids; returns nothing.

    points    Points; their rows from `first` on become cache rows from `row` on, one for each gather in incident
    strata    Strata of the grid
    incident  (gathers * azimuth * polar, 3) f8 radiance, polar strata fastest
    distance  (gathers * azimuth * polar,) f4 [m] to what was hit, overwritten with one over itself
    near, far (gathers,) f4 least and largest radius that a record may have [m]
    cache     CacheRecords, rows overwritten

    radius is the harmonic mean distance, but with the tolerance it reaches no farther than the nearest surface that is
    not seen edge-on, so that no record shines through a wall (as in Mitsuba 0.6), and no farther than lets the
    translational gradient change the irradiance by as much as itself (Krivanek 2006); within [near, far]. Where
    `near` wins, the gradient is scaled down alike. Of the gradients, in column c of a record's nine numbers
    3 c ... 3 c + 2 stands the world vector of channel c.
    """
    rays = strata.ring.shape[0] * strata.spoke.shape[0]
    for gather in range(near.shape[0]):
        point, out, start = first + gather, row + gather, gather * rays
        nx, ny, nz = row3(points.normal, point)
        sx, sy, sz, tx, ty, tz = tangent_frame(nx, ny, nz)
        radius = reach_of_gather(distance, start, strata, tolerance)
        steepest = 0.0
        for c in range(3):
            mean, ax, ay, bx, by = grid_gradients(incident, distance, start, strata, c)
            irradiance = math.pi * mean
            cache.irradiance[out, c] = irradiance
            slope = math.sqrt(ax * ax + ay * ay)
            if slope > steepest * max(1e-30, irradiance):
                steepest = slope / max(1e-30, irradiance)
            e = 3 * c
            cache.translation[out, e] = ax * sx + ay * tx
            cache.translation[out, e + 1] = ax * sy + ay * ty
            cache.translation[out, e + 2] = ax * sz + ay * tz
            cache.rotation[out, e] = bx * sx + by * tx
            cache.rotation[out, e + 1] = bx * sy + by * ty
            cache.rotation[out, e + 2] = bx * sz + by * tz
        if steepest * radius > 1.0:
            radius = 1.0 / steepest
        limited = max(near[gather], min(far[gather], radius))
        if limited > radius:
            for e in range(9):
                cache.translation[out, e] *= radius / limited
        cache.radius[out] = limited
        px, py, pz = row3(points.position, point)
        set_row3(cache.position, out, px, py, pz)
        set_row3(cache.normal, out, nx, ny, nz)


@kernel
def doubt_gathers(incident, doubt):
    """Doubt (gathers,) f8 in each gather, overwritten: its mean's standard error over the mean, as if its rays were
    independent.

    incident (gathers * rays, 3) f8 radiance; its three channels count as one.
    """
    rays = incident.shape[0] // doubt.shape[0]
    for gather in range(doubt.shape[0]):
        total, square = 0.0, 0.0
        for row in range(gather * rays, (gather + 1) * rays):
            light = incident[row, 0] + incident[row, 1] + incident[row, 2]
            total += light
            square += light * light
        # Of n numbers with mean m and mean square s the mean's standard error is sqrt((s - m^2) / n).
        mean2 = (total / rays) ** 2
        doubt[gather] = math.sqrt(max(0.0, square / rays - mean2) / (rays * max(mean2, DARK)))


@kernel
def list_cells(cache, reach, cell, first, member, fill):
    """Count (fill = 0) or list (fill = 1) the records whose sphere of influence may meet each bucket's cells.

    reach is the share of a record's radius that it reaches. first (buckets + 1,) i8: counts are added to
    first[bucket + 1]; listing advances first[bucket] and writes member (M,) i4.
    """
    mask = first.shape[0] - 2
    for i in range(cache.radius.shape[0]):
        r = reach * cache.radius[i]
        x, y, z = row3(cache.position, i)
        for cx in range(math.floor((x - r) / cell), math.floor((x + r) / cell) + 1):
            for cy in range(math.floor((y - r) / cell), math.floor((y + r) / cell) + 1):
                for cz in range(math.floor((z - r) / cell), math.floor((z + r) / cell) + 1):
                    bucket = bucket_of(cx, cy, cz, mask)
                    if fill:
                        member[first[bucket]] = i
                        first[bucket] += 1
                    else:
                        first[bucket + 1] += 1


@device
def bucket_at(grid, x, y, z):
    """Bucket of the cell that a point lies in."""
    cell = grid.cell[0]
    return bucket_of(
        np.int64(math.floor(x / cell)), np.int64(math.floor(y / cell)), np.int64(math.floor(z / cell)),
        grid.first.shape[0] - 2,
    )  # fmt: skip


@kernel
def clamp_neighbours(cache, grid, reach, pending):
    """Make no record's radius exceed that of a `pending` neighbour plus the distance between them.

    pending (R,) u1 marks the records that others are held against, each once, in order: it is 0 for those that were
    held against since they last shrank, and 1 for those that shrank later.
    """
    for j in range(cache.radius.shape[0]):
        if not pending[j]:
            continue
        pending[j] = 0
        x, y, z = row3(cache.position, j)
        bucket = bucket_at(grid, x, y, z)
        for m in range(grid.first[bucket], grid.first[bucket + 1]):
            i = grid.member[m]
            if cache.radius[i] <= cache.radius[j]:
                continue
            dx, dy, dz = cache.position[i, 0] - x, cache.position[i, 1] - y, cache.position[i, 2] - z
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            if distance < reach * cache.radius[i] and cache.radius[j] + distance < cache.radius[i]:
                cache.radius[i] = cache.radius[j] + distance
                pending[i] = 1


@kernel
def interpolate_irradiance(cache, grid, tolerance, gradients, points, irradiance, radius):
    """Irradiance (N, 3) f4 at points from the records that are good enough there, and their mean radius (N,) f4 [m].

    radius is 0 where no record is good enough. w_i = 1 - (|x - x_i| / R_i + sqrt(1 - n . n_i)) / tolerance, where that
    is positive (Tabellion & Lamorlette): Ward's inverse of the error shows the noise of each record around its place,
    this blends it with its neighbours'. Records' order in the grid is fixed, so sums do not depend on how the points
    were cut into chunks.
    """
    for q in range(points.owner.shape[0]):
        x, y, z = row3(points.position, q)
        nx, ny, nz = row3(points.normal, q)
        red, green, blue, weight_sum, radius_sum = 0.0, 0.0, 0.0, 0.0, 0.0
        bucket = bucket_at(grid, x, y, z)
        for m in range(grid.first[bucket], grid.first[bucket + 1]):
            i = grid.member[m]
            # Two of a record's cells may have one bucket; the two entries then follow each other.
            if m > grid.first[bucket] and grid.member[m - 1] == i:
                continue
            dx, dy, dz = x - cache.position[i, 0], y - cache.position[i, 1], z - cache.position[i, 2]
            d2 = dx * dx + dy * dy + dz * dz
            r = cache.radius[i]
            if d2 >= (tolerance * r) ** 2:
                continue
            mx, my, mz = row3(cache.normal, i)
            cosine = nx * mx + ny * my + nz * mz
            error = math.sqrt(d2) / r + math.sqrt(max(0.0, 1.0 - cosine))
            if error >= tolerance:
                continue
            if dx * (nx + mx) + dy * (ny + my) + dz * (nz + mz) < -2.0 * BEHIND * r:
                continue
            weight = 1.0 - error / tolerance
            er, eg, eb = row3(cache.irradiance, i)
            if gradients:
                # n_i x n: the axis about which the normal turned, as long as the sine of the angle.
                ax, ay, az = my * nz - mz * ny, mz * nx - mx * nz, mx * ny - my * nx
                er += change(cache.translation, i, 0, dx, dy, dz) + change(cache.rotation, i, 0, ax, ay, az)
                eg += change(cache.translation, i, 1, dx, dy, dz) + change(cache.rotation, i, 1, ax, ay, az)
                eb += change(cache.translation, i, 2, dx, dy, dz) + change(cache.rotation, i, 2, ax, ay, az)
            red += weight * max(0.0, er)
            green += weight * max(0.0, eg)
            blue += weight * max(0.0, eb)
            weight_sum += weight
            radius_sum += weight * r
        scale = 1.0 / weight_sum if weight_sum > 0.0 else 0.0
        radius[q] = radius_sum * scale
        set_row3(irradiance, q, red * scale, green * scale, blue * scale)


@device
def change(gradient, i, channel, x, y, z):
    """A channel's gradient times a vector."""
    return gradient[i, 3 * channel] * x + gradient[i, 3 * channel + 1] * y + gradient[i, 3 * channel + 2] * z
