"""Irradiance from photons: density estimates, and what points reflect of it."""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.kdtree import candidate_distance2, candidate_row, nearest_points
from joulebox_render.kernels.rng import member_key, uniform
from joulebox_render.kernels.transport import push_point
from joulebox_render.kernels.vector import row3, set_row3

CONSTANT, CONE, EPANECHNIKOV = 0, 1, 2
# Jensen's cone filter falls to 1 - 1 / CONE_STEEPNESS at the edge of the disc.
CONE_STEEPNESS = 1.1
# Dimension of the number that decides which gather rays are short.
SHORT_DIMENSION = 9


@device
def kernel_weight(kind, share2):
    """Weight of a photon at squared relative distance share2 in [0, 1]; its mean over the unit disc is 1."""
    if kind == CONE:
        return (1.0 - math.sqrt(share2) / CONE_STEEPNESS) / (1.0 - 2.0 / (3.0 * CONE_STEEPNESS))
    if kind == EPANECHNIKOV:
        return 2.0 * (1.0 - share2)
    return 1.0


@kernel
def estimate_irradiance(tree, flux, position, normal, k, reach, cos_limit, filter_kind, scratch, estimates):
    """Irradiance at points from their nearest photons [W m^-2].

    E = sum_p w(d_p / r) flux_p / (pi r^2)

    flux (P, 3) f4 in the tree's order [W], already divided by the number emitted; position, normal (Q, 3) f4;
    k nearest within `reach` [m]; estimates is overwritten: irradiance, radius r, how many photons were found, and how
    lopsided they lie: the squared distance of their centroid over what it is in the mean where they fill a disc.
    Where k photons are found, r is the distance of the k-th and the sum leaves that one out: with it, the
    estimate would be too large by k / (k - 1) in the mean. With fewer, r is `reach`. Near edges the disc hangs
    over the surface and the estimate is too dark (boundary bias). Source: Jensen 1996, eq. 5; Jensen 2001,
    section 7.2.
    """
    for q in range(position.shape[0]):
        x, y, z = row3(position, q)
        nx, ny, nz = row3(normal, q)
        found = nearest_points(tree, x, y, z, nx, ny, nz, cos_limit, reach * reach, k, scratch)
        inside, radius2 = found, np.float64(reach) * reach
        if found == k:
            inside, radius2 = k - 1, np.float64(candidate_distance2(scratch.candidates[k - 1]))
        red, green, blue = 0.0, 0.0, 0.0
        ax, ay, az = 0.0, 0.0, 0.0
        if radius2 > 0.0:
            for i in range(inside):
                entry = scratch.candidates[i]
                weight = kernel_weight(filter_kind, candidate_distance2(entry) / radius2)
                row = candidate_row(entry)
                ax += tree.position[row, 0] - x
                ay += tree.position[row, 1] - y
                az += tree.position[row, 2] - z
                red += weight * flux[row, 0]
                green += weight * flux[row, 1]
                blue += weight * flux[row, 2]
            scale = 1.0 / (math.pi * radius2)
            red, green, blue = red * scale, green * scale, blue * scale
        set_row3(estimates.irradiance, q, red, green, blue)
        for w in range(estimates.witness.shape[1]):
            spread = w * inside // estimates.witness.shape[1]
            estimates.witness[q, w] = candidate_row(scratch.candidates[spread]) if inside > 0 else -1
        estimates.radius[q], estimates.found[q] = math.sqrt(radius2), inside
        square = ax * ax + ay * ay + az * az
        estimates.lopsided[q] = 2.0 * square / (radius2 * inside) if radius2 * inside > 0.0 else 0.0


@kernel
def aim_at_witnesses(tree, witness, position, normal, epsilon, lift, origin, direction, limit):
    """Rays from points to the photons named in witness (Q, W) i4; a ray of length 0 for -1 and for a point's own.

    origin, direction (Q W, 3) and limit (Q W,) f4 [m] are overwritten. Both ends are raised along their normals by
    epsilon [m] and `lift` of the distance.
    """
    for q in range(position.shape[0]):
        for w in range(witness.shape[1]):
            out, row = q * witness.shape[1] + w, witness[q, w]
            px, py, pz = row3(position, q)
            nx, ny, nz = row3(normal, q)
            set_row3(origin, out, px + epsilon * nx, py + epsilon * ny, pz + epsilon * nz)
            set_row3(direction, out, nx, ny, nz)
            limit[out] = 0.0
            if row < 0:
                continue
            ex, ey, ez = row3(tree.position, row)
            mx, my, mz = row3(tree.normal, row)
            distance = math.sqrt((ex - px) ** 2 + (ey - py) ** 2 + (ez - pz) ** 2)
            if distance <= 4.0 * epsilon:
                continue
            up = epsilon + lift * distance
            px, py, pz = px + up * nx, py + up * ny, pz + up * nz
            dx, dy, dz = ex + up * mx - px, ey + up * my - py, ez + up * mz - pz
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            set_row3(origin, out, px, py, pz)
            set_row3(direction, out, dx / distance, dy / distance, dz / distance)
            limit[out] = distance


@device
def short_ray(key, sample, distance, resolution):
    """Whether a path's last ray is shorter than about `resolution` [m].

    The limit varies from 0.5 to 1.5 of it by chance, so that no line shows where the method changes.
    """
    if distance >= 1.5 * resolution:
        return False
    return distance < resolution * (0.5 + uniform(member_key(key, sample), SHORT_DIMENSION))


@kernel
def take_unsure(points, unsure, resolution, near):
    """Move points marked in unsure (N,) u1, or with a last ray shorter than about `resolution` [m], to `near`.

    Returns how many. Their weights in `points` become 0. near is overwritten, in the order of the points.
    """
    count = 0
    for q in range(points.owner.shape[0]):
        key, sample = points.key[q], points.sample[q]
        if not (unsure[q] or short_ray(key, sample, points.distance[q], resolution)):
            continue
        px, py, pz = row3(points.position, q)
        gx, gy, gz = row3(points.geometric, q)
        sx, sy, sz = row3(points.normal, q)
        ax, ay, az = row3(points.albedo, q)
        wx, wy, wz = row3(points.weight, q)
        push_point(
            near, count, px, py, pz, gx, gy, gz, sx, sy, sz, ax, ay, az, wx, wy, wz,
            points.owner[q], key, sample, points.distance[q],
        )  # fmt: skip
        set_row3(points.weight, q, 0.0, 0.0, 0.0)
        count += 1
    return count


@kernel
def reflect_mean(points, first, last, count, incident, radiance):
    """Radiance that points [first, last) reflect of `count` cosine-distributed gather rays each.

    incident (rays, 3) f8; radiance (last - first, 3) f8 is overwritten with albedo x mean.
    """
    row = 0
    for q in range(last - first):
        red, green, blue = 0.0, 0.0, 0.0
        for _ in range(count):
            red += incident[row, 0]
            green += incident[row, 1]
            blue += incident[row, 2]
            row += 1
        ax, ay, az = row3(points.albedo, first + q)
        set_row3(radiance, q, ax * red / count, ay * green / count, az * blue / count)


@kernel
def add_weighted(points, value, radiance):
    """Add weight x value of each point to its owner, in the points' order; value (Q, 3), radiance (owners, 3) f8."""
    for q in range(points.owner.shape[0]):
        owner = points.owner[q]
        for c in range(3):
            radiance[owner, c] += points.weight[q, c] * value[q, c]
