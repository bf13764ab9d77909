"""Paths from the eye and into the scene: camera rays, and what a ray does where it hits."""

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.importance import warp_to_cells
from joulebox_render.kernels.rng import child_key, draw_1d, draw_2d, fill_2d, fill_lattice, path_key, sample_2d
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.vector import (
    cosine_direction,
    fresnel,
    normalized,
    reflected,
    refracted,
    row3,
    set_row3,
    specular_normal,
)

DIFFUSE, MIRROR, GLASS, PHONG = 0, 1, 2, 4
CAMERA_STREAM = 1
GATHER_BRANCH, LOBE_BRANCH = 100, 2
# A glass hit follows both branches while the weaker one still carries this much of the pixel: rays are cheap, and
# a light seen through several weak reflections is a bright dot where one branch is drawn at random.
SPLIT_WEIGHT = 0.001
# Lighting a point costs a hundred rays; those that count less than this are kept in proportion to what they count.
POINT_WEIGHT = 0.05


@device
def push_ray(rays, row, px, py, pz, dx, dy, dz, wx, wy, wz, owner, key, sample):
    """Write one ray into row `row` of a queue."""
    set_row3(rays.origin, row, px, py, pz)
    set_row3(rays.direction, row, dx, dy, dz)
    set_row3(rays.weight, row, wx, wy, wz)
    rays.owner[row], rays.key[row], rays.sample[row] = owner, key, sample


@device
def push_point(points, row, px, py, pz, gx, gy, gz, sx, sy, sz, ax, ay, az, wx, wy, wz, owner, key, sample, distance):
    """Write one diffuse point into row `row`: position, geometric and shading normal, albedo, weight."""
    set_row3(points.position, row, px, py, pz)
    set_row3(points.geometric, row, gx, gy, gz)
    set_row3(points.normal, row, sx, sy, sz)
    set_row3(points.albedo, row, ax, ay, az)
    set_row3(points.weight, row, wx, wy, wz)
    points.owner[row], points.key[row], points.sample[row] = owner, key, sample
    points.distance[row] = distance


@kernel
def camera_rays(seed, stream, first_pixel, samples, columns, jitter, width, height, frame, near, rays):
    """Rays through pixels first_pixel ...: `samples` a pixel, in raster order, then sample order.

    rays is overwritten: weight 1, owner the pixel counted from the first.

    frame (4, 3) f8: camera position, then the world vectors of film x (towards the right edge), film y (towards
    the bottom edge), and the view axis, so that a film position in [-1, 1]^2 maps to axis + x right + y down.
    Without jitter, samples sit at the centres of their strata.
    """
    for i in range(rays.sample.shape[0]):
        pixel = first_pixel + i // samples
        sample = i % samples
        pixel_key = path_key(seed, stream, pixel)
        if jitter:
            u, v = sample_2d(pixel_key, 0, 1, sample, samples, columns)
        elif columns > 0:
            u = (sample % columns + 0.5) / columns
            v = (sample // columns + 0.5) / (samples // columns)
        elif columns < -1:
            u, v = (sample + 0.5) / samples, ((-sample * columns) % samples + 0.5) / samples
        else:
            u, v = 0.5, 0.5
        x = 2.0 * (pixel % width + u) / width - 1.0
        y = 2.0 * (pixel // width + v) / height - 1.0
        dx = frame[3, 0] + x * frame[1, 0] + y * frame[2, 0]
        dy = frame[3, 1] + x * frame[1, 1] + y * frame[2, 1]
        dz = frame[3, 2] + x * frame[1, 2] + y * frame[2, 2]
        px, py, pz = frame[0, 0] + near * dx, frame[0, 1] + near * dy, frame[0, 2] + near * dz
        dx, dy, dz = normalized(dx, dy, dz)
        push_ray(rays, i, px, py, pz, dx, dy, dz, 1.0, 1.0, 1.0, i // samples, pixel_key, sample)


@device
def glass_bounce(tables, material, front, dx, dy, dz, gx, gy, gz, sx, sy, sz):
    """Both ways on from a smooth dielectric: (reflectance, reflected direction, refracted direction, eta)."""
    ior = tables.material_ior[material]
    eta = 1.0 / ior if front else ior
    sx, sy, sz = specular_normal(dx, dy, dz, gx, gy, gz, sx, sy, sz)
    cos_i = min(1.0, -(dx * sx + dy * sy + dz * sz))
    reflectance, cos_t = fresnel(cos_i, eta)
    rx, ry, rz = reflected(dx, dy, dz, sx, sy, sz)
    tx, ty, tz = dx, dy, dz
    if reflectance < 1.0:
        tx, ty, tz = refracted(dx, dy, dz, sx, sy, sz, cos_i, cos_t, eta)
        if tx * gx + ty * gy + tz * gz >= 0.0:  # the shading normal leads back to this side
            cos_i = min(1.0, -(dx * gx + dy * gy + dz * gz))
            _, cos_t = fresnel(cos_i, eta)
            tx, ty, tz = refracted(dx, dy, dz, gx, gy, gz, cos_i, cos_t, eta)
    return reflectance, rx, ry, rz, tx, ty, tz, eta


@device
def follow_glass(tables, material, split, sobol, rays, i, at, following, row):
    """Write the ray or rays that go on from glass at `at` from `row` on; returns how many rays there are then."""
    front, px, py, pz, gx, gy, gz, sx, sy, sz = at
    dx, dy, dz = row3(rays.direction, i)
    wx, wy, wz = row3(rays.weight, i)
    owner, key, sample = rays.owner[i], rays.key[i], rays.sample[i]
    epsilon = tables.epsilon[0]
    ex, ey, ez = epsilon * gx, epsilon * gy, epsilon * gz
    share, rx, ry, rz, tx, ty, tz, eta = glass_bounce(tables, material, front, dx, dy, dz, gx, gy, gz, sx, sy, sz)
    both = split and max(wx, wy, wz) * min(share, 1.0 - share) > SPLIT_WEIGHT
    reflect = both or draw_1d(sobol, key, sample, 0) < share
    if reflect:
        scale = share if both else 1.0
        push_ray(
            following, row, px + ex, py + ey, pz + ez, rx, ry, rz,
            wx * scale, wy * scale, wz * scale, owner, child_key(key, 0), sample,
        )  # fmt: skip
        row += 1
    if both or not reflect:
        scale = eta * eta * (1.0 - share if both else 1.0)
        push_ray(
            following, row, px - ex, py - ey, pz - ez, tx, ty, tz,
            wx * scale, wy * scale, wz * scale, owner, child_key(key, 1), sample,
        )  # fmt: skip
        row += 1
    return row


@device
def lifted(tables, at):
    """The place of a hit, off the surface."""
    _, px, py, pz, gx, gy, gz, _, _, _ = at
    epsilon = tables.epsilon[0]
    return px + epsilon * gx, py + epsilon * gy, pz + epsilon * gz


@device
def mirrored(rays, i, at):
    """Where a mirror at `at` would send a ray."""
    dx, dy, dz = row3(rays.direction, i)
    return reflected(dx, dy, dz, at[7], at[8], at[9])


@device
def follow_mirror(tables, material, rays, i, at, following, row):
    """Write the ray that goes on from a mirror at `at`."""
    px, py, pz = lifted(tables, at)
    _, _, _, _, gx, gy, gz, sx, sy, sz = at
    dx, dy, dz = row3(rays.direction, i)
    rx, ry, rz = reflected(dx, dy, dz, *specular_normal(dx, dy, dz, gx, gy, gz, sx, sy, sz))
    wx, wy, wz = row3(rays.weight, i)
    ax, ay, az = row3(tables.material_albedo, material)
    push_ray(
        following, row, px, py, pz, rx, ry, rz,
        wx * ax, wy * ay, wz * az, rays.owner[i], child_key(rays.key[i], 0), rays.sample[i],
    )  # fmt: skip


@device
def phong_parts(tables, material, split, sobol, rays, i):
    """What a path's weight is multiplied with in the diffuse part and in the lobe of a Phong surface; 0 goes no way."""
    ax, ay, az = row3(tables.material_albedo, material)
    cx, cy, cz = row3(tables.material_glossy, material)
    if max(ax, ay, az) <= 0.0:
        return 0.0, 1.0
    if split:
        return 1.0, 1.0
    chance = max(cx, cy, cz) / (max(cx, cy, cz) + max(ax, ay, az))
    if draw_1d(sobol, rays.key[i], rays.sample[i], 2) < chance:
        return 0.0, 1.0 / chance
    return 1.0 / (1.0 - chance), 0.0


@device
def push_hit(rays, hits, i, at, place, albedo, scale, key, points, row):
    """Write what a ray meets at `at` as a point that reflects `albedo`, at `place`, for `scale` of the ray's weight."""
    _, _, _, _, gx, gy, gz, sx, sy, sz = at
    (px, py, pz), (ax, ay, az) = place, albedo
    wx, wy, wz = row3(rays.weight, i)
    push_point(
        points, row, px, py, pz, gx, gy, gz, sx, sy, sz, ax, ay, az, wx * scale, wy * scale, wz * scale,
        rays.owner[i], key, rays.sample[i], hits.distance[i],
    )  # fmt: skip


@device
def push_lobe(tables, material, rays, hits, i, at, scale, lobes, row):
    """Write the lobe of a Phong surface at `at`."""
    glossy, key = row3(tables.material_glossy, material), child_key(rays.key[i], LOBE_BRANCH)
    push_hit(rays, hits, i, at, lifted(tables, at), glossy, scale, key, lobes.at, row)
    rx, ry, rz = mirrored(rays, i, at)
    set_row3(lobes.mirror, row, rx, ry, rz)
    lobes.exponent[row] = tables.material_exponent[material]


@device
def kept_weight(sobol, rays, i):
    """Factor on the weight of a point by Russian roulette among those that count for little; 0: it is dropped."""
    wx, wy, wz = row3(rays.weight, i)
    weight = np.float64(max(wx, wy, wz))
    if weight >= POINT_WEIGHT:
        return 1.0
    return POINT_WEIGHT / weight if draw_1d(sobol, rays.key[i], rays.sample[i], 1) * POINT_WEIGHT < weight else 0.0


@kernel
def advance(tables, split, sobol, rays, hits, points, lobes, following):
    """One step of paths through mirrors, glass and glossy lobes until they meet a diffuse surface.

    split      whether glass follows both branches where they still matter, Phong surfaces their diffuse part and their
               lobe, and points that count for little are subject to Russian roulette; else a path goes one way on,
               chosen at random
    rays       Rays that were traced; hits what they met
    points     Points, overwritten: the diffuse hits (weight = what they count for their owner)
    lobes      Lobes, overwritten: the glossy hits; no room is needed where no surface is glossy
    following  Rays, overwritten (room for 2 N when split): the specular paths that go on
    Returns (points written, lobes written, rays written), all in the order of the rays.

    Refraction scales radiance by the square of the ratio of indices (Veach 1997, section 5.2), which cancels
    for paths that leave the glass again.
    """
    point_count, lobe_count, ray_count = 0, 0, 0
    for i in range(rays.origin.shape[0]):
        primitive = hits.primitive[i]
        if primitive < 0:
            continue
        material = tables.material[primitive]
        kind = tables.material_kind[material]
        at = surface_at_hit(tables, rays, hits, i, primitive)
        if kind == GLASS:
            ray_count = follow_glass(tables, material, split, sobol, rays, i, at, following, ray_count)
            continue
        if not (at[0] or tables.material_two_sided[material]):
            continue
        if kind == MIRROR:
            follow_mirror(tables, material, rays, i, at, following, ray_count)
            ray_count += 1
            continue
        diffuse, scale = 1.0 * (kind == DIFFUSE), 0.0
        if kind == PHONG:
            diffuse, scale = phong_parts(tables, material, split, sobol, rays, i)
        if scale > 0.0:
            push_lobe(tables, material, rays, hits, i, at, scale, lobes, lobe_count)
            lobe_count += 1
        if diffuse > 0.0 and split:
            diffuse *= kept_weight(sobol, rays, i)
        if diffuse > 0.0:
            albedo = row3(tables.material_albedo, material)
            push_hit(rays, hits, i, at, lifted(tables, at), albedo, diffuse, rays.key[i], points, point_count)
            point_count += 1
    return point_count, lobe_count, ray_count


@kernel
def gather_rays(points, first, last, count, columns, lattice, chance, u, v, rays):
    """Cosine-distributed rays into the hemisphere over points [first, last), `count` a point.

    They are placed by `fill_2d`, or where `lattice` by `fill_lattice`.
    chance (last - first, cells) f4 of kernels.importance bends the distribution; without rows it has no say. A
    ray's weight is the cosine density over its own, 0 where an interpolated normal sends it below the surface: pi
    times the mean of weight x incident radiance is the irradiance. owner is the ray's own row. rays is overwritten,
    as are u, v (N,) f4, what the rays are made of. Source: Jensen 2001, eq. 8.6.
    """
    bent = chance.shape[0] > 0
    row = 0
    for point in range(first, last):
        px, py, pz = row3(points.position, point)
        nx, ny, nz = row3(points.normal, point)
        gx, gy, gz = row3(points.geometric, point)
        key, sample = child_key(points.key[point], GATHER_BRANCH), points.sample[point]
        onward = child_key(key, 0)
        if lattice:
            fill_lattice(key, sample, count, columns, u, v, row)
        else:
            fill_2d(key, sample, 1, 1, count, columns, u, v, row)
        for i in range(count):
            a, b, weight = np.float64(u[row]), np.float64(v[row]), 1.0
            if bent:
                a, b, weight = warp_to_cells(chance, point - first, a, b)
            dx, dy, dz = cosine_direction(nx, ny, nz, a, b)
            if dx * gx + dy * gy + dz * gz <= 0.0:
                weight = 0.0
            push_ray(rays, row, px, py, pz, dx, dy, dz, weight, weight, weight, row, onward, sample * count + i)
            row += 1


@kernel
def continue_paths(points, sobol, bounce, rays):
    """Extend paths from diffuse points by one cosine-distributed ray, with Russian roulette after two bounces.

    rays is overwritten, in the order of the points; returns how many go on. A ray's weight is the point's times
    its albedo over the chance to go on.
    """
    row = 0
    for point in range(points.owner.shape[0]):
        key, sample = child_key(points.key[point], GATHER_BRANCH), points.sample[point]
        wx = points.weight[point, 0] * points.albedo[point, 0]
        wy = points.weight[point, 1] * points.albedo[point, 1]
        wz = points.weight[point, 2] * points.albedo[point, 2]
        chance = 1.0
        if bounce >= 2:
            before = max(points.weight[point, 0], points.weight[point, 1], points.weight[point, 2])
            chance = min(0.95, max(wx, wy, wz) / before) if before > 0.0 else 0.0
            if draw_1d(sobol, key, sample, 0) >= chance:
                continue
        px, py, pz = row3(points.position, point)
        nx, ny, nz = row3(points.normal, point)
        gx, gy, gz = row3(points.geometric, point)
        u, v = draw_2d(sobol, key, sample, 1)
        dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
        if dx * gx + dy * gy + dz * gz <= 0.0:
            continue
        push_ray(
            rays, row, px, py, pz, dx, dy, dz,
            wx / chance, wy / chance, wz / chance, points.owner[point], child_key(key, 0), sample,
        )  # fmt: skip
        row += 1
    return row
