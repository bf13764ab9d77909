"""Direct lighting: shadow rays to samples of the lights, and what they carry."""

import math

import numpy as np

from joulebox_render.kernels.close_lights import CLOSE
from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.lights import ENVIRONMENT, RECTANGLE_LIGHT, light_faces, light_sample
from joulebox_render.kernels.rng import child_key, fill_2d
from joulebox_render.kernels.vector import cosine_direction, row3, set_row3

LIGHT_BRANCH = 1000
# Shadow rays end this share of their length before the light. Squares of distances are not taken for less [m^2].
SHORT, NEAREST2 = np.float32(1.0 - 1e-4), np.float32(1e-30)
# In single precision: with Python's numbers numba would go over to double.
ZERO, ONE = np.float32(0.0), np.float32(1.0)
# How far away the environment is taken to be [m].
SKY_DISTANCE = 1e30


@device
def samples_in_a_row(points, row, last):
    """End of the points from `row` on that are paths of one family following each other: those of one pixel."""
    end = row + 1
    while end < last and points.key[end] == points.key[row] and points.sample[end] - points.sample[row] == end - row:
        end += 1
    return end


@device
def rectangle_frame(tables, light, points, row):
    """A rectangle seen from a point: vector to its first corner, its two edges, and area times height over its plane.

    In single precision, as all that is made of them for every sample.
    """
    px, py, pz = row3(points.position, row)
    cx, cy, cz = row3(tables.light_position, light)
    lx, ly, lz = row3(tables.light_normal, light)
    ux, uy, uz = row3(tables.light_edge_u, light)
    vx, vy, vz = row3(tables.light_edge_v, light)
    dx, dy, dz = cx - px, cy - py, cz - pz
    height = -(dx * lx + dy * ly + dz * lz)
    return (
        dx - ux - vx, dy - uy - vy, dz - uz - vz, ux + ux, uy + uy, uz + uz, vx + vx, vy + vy, vz + vz,
        height * tables.light_area[light],
    )  # fmt: skip


@device
def rectangle_rays(tables, light, points, row, first, begin, end, written, share, most, shadow):
    """Shadow rays of samples [begin, end) of a rectangle, from `written` on; returns how many there are then.

    What a sample brings is the height of the point above the light times that of the sample above the point over the
    fourth power of the distance. All rays are written and those that do not count overwritten: asking before would
    cost more by branches that are mispredicted.
    """
    ox, oy, oz, ux, uy, uz, vx, vy, vz, scale = rectangle_frame(tables, light, points, row)
    px, py, pz = row3(points.position, row)
    nx, ny, nz = row3(points.normal, row)
    gx, gy, gz = row3(points.geometric, row)
    scale *= share
    for i in range(begin, end):
        u, v = shadow.limit[i], shadow.weight[i]
        dx, dy, dz = ox + u * ux + v * vx, oy + u * uy + v * vy, oz + u * uz + v * vz
        d2 = max(dx * dx + dy * dy + dz * dz, NEAREST2)
        inverse2 = ONE / d2
        inverse = math.sqrt(inverse2)
        weight = (dx * nx + dy * ny + dz * nz) * inverse2 * (scale * inverse2)
        set_row3(shadow.origin, written, px, py, pz)
        set_row3(shadow.direction, written, dx * inverse, dy * inverse, dz * inverse)
        shadow.limit[written], shadow.weight[written], shadow.owner[written] = d2 * inverse * SHORT, weight, row - first
        written += (weight > ZERO) & (weight <= most) & (dx * gx + dy * gy + dz * gz > ZERO)
    return written


@device
def light_rays(tables, light, points, row, first, begin, end, written, share, most, shadow):
    """As `rectangle_rays`, of a light of any kind."""
    px, py, pz = row3(points.position, row)
    nx, ny, nz = row3(points.normal, row)
    gx, gy, gz = row3(points.geometric, row)
    for i in range(begin, end):
        u, v = shadow.limit[i], shadow.weight[i]
        if tables.light_kind[light] == ENVIRONMENT:
            dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
            distance, scale = SKY_DISTANCE, math.pi / max(1e-6, dx * nx + dy * ny + dz * nz)
        else:
            dx, dy, dz, distance, scale = light_sample(tables, light, px, py, pz, u, v)
        weight = scale * (dx * nx + dy * ny + dz * nz) * share
        if weight > 0.0 and weight <= most and dx * gx + dy * gy + dz * gz > 0.0:
            set_row3(shadow.origin, written, px, py, pz)
            set_row3(shadow.direction, written, dx, dy, dz)
            shadow.limit[written], shadow.weight[written], shadow.owner[written] = distance * SHORT, weight, row - first
            written += 1
    return written


@kernel
def shadow_rays(tables, light, count, columns, points, first, last, shadow):
    """Shadow rays from points [first, last) to stratified samples of one light; returns how many were written.

    Only samples that would light the point, and are not CLOSE, are written into shadow (ShadowRays, overwritten):
    weight times the light's radiance and the point's albedo is what each reflects if nothing blocks it, already
    divided by pi and `count`; owner is the point's row, counted from `first`; limit stops just short of the light.
    """
    share = np.float32(1.0 / (math.pi * count))
    most = np.float32(CLOSE / count if tables.light_close[light] > 0.0 else math.inf)
    written, row = 0, first
    while row < last:
        if not light_faces(tables, light, points, row):
            row += 1
            continue
        end, begin = samples_in_a_row(points, row, last), written
        # Samples wait where their rays' own numbers will be written, which no ray reaches before it is read.
        key = child_key(points.key[row], LIGHT_BRANCH + light)
        fill_2d(key, points.sample[row], 1, end - row, count, columns, shadow.limit, shadow.weight, begin)
        while row < end:
            if tables.light_kind[light] == RECTANGLE_LIGHT:
                written = rectangle_rays(
                    tables, light, points, row, first, begin, begin + count, written, share, most, shadow
                )
            else:
                written = light_rays(
                    tables, light, points, row, first, begin, begin + count, written, share, most, shadow
                )
            row, begin = row + 1, begin + count
    return written


@kernel
def add_unblocked(tables, light, points, first, blocked, shadow, radiance):
    """Add what unblocked shadow rays to a light carry to their owners; radiance (P, 3) f8 is added to in ray order.

    Rays of one owner follow each other; owner counts points from `first`.
    """
    lx, ly, lz = row3(tables.light_radiance, light)
    i, count = 0, blocked.shape[0]
    while i < count:
        point, total = shadow.owner[i], 0.0
        while i < count and shadow.owner[i] == point:
            if not blocked[i]:
                total += shadow.weight[i]
            i += 1
        ax, ay, az = row3(points.albedo, first + point)
        radiance[point, 0] += ax * lx * total
        radiance[point, 1] += ay * ly * total
        radiance[point, 2] += az * lz * total
