"""Light leaving the lights: samples towards a point (direct lighting) and photons into the scene (emission)."""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.rng import child_key, path_key, sample_2d, uniform
from joulebox_render.kernels.vector import cosine_direction, from_frame, row3, set_row3

POINT_LIGHT, SPOT_LIGHT, RECTANGLE_LIGHT, DISK_LIGHT, SPHERE_LIGHT, MESH_LIGHT = 0, 1, 2, 3, 4, 5
EMISSION_STREAM = 2


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
    distance = math.sqrt(d2)
    dx, dy, dz = dx / distance, dy / distance, dz / distance
    if kind == POINT_LIGHT:
        return dx, dy, dz, distance, 1.0 / d2
    if kind == SPOT_LIGHT:
        ax, ay, az = row3(tables.light_normal, light)
        cos_axis = -(dx * ax + dy * ay + dz * az)
        beam, cutoff = cone_cosines(tables, light)
        return dx, dy, dz, distance, spot_falloff(cos_axis, beam, cutoff) / d2
    cos_light = -(dx * nx + dy * ny + dz * nz)
    return dx, dy, dz, distance, max(0.0, cos_light) * tables.light_area[light] / d2


@kernel
def shadow_rays(tables, light, count, columns, points, first, last, origin, direction, limit, value, owner):
    """Shadow rays from points [first, last) to stratified samples of one light; returns how many were written.

    Only samples that would light the point are written. value (N, 3) f4 is the radiance that each reflects if
    nothing blocks it, already divided by `count`; owner (N,) i4 is the point's row, counted from `first`.
    limit (N,) f4 stops just short of the light [m].
    """
    written = 0
    for row in range(first, last):
        px, py, pz = row3(points.position, row)
        nx, ny, nz = row3(points.normal, row)
        gx, gy, gz = row3(points.geometric, row)
        key = child_key(points.key[row], 1000 + light)
        for i in range(count):
            u, v = sample_2d(key, 1, i, count, columns)
            dx, dy, dz, distance, scale = light_sample(tables, light, px, py, pz, u, v)
            cos_point = dx * nx + dy * ny + dz * nz
            if scale <= 0.0 or cos_point <= 0.0 or dx * gx + dy * gy + dz * gz <= 0.0:
                continue
            weight = scale * cos_point / (math.pi * count)
            set_row3(origin, written, px, py, pz)
            set_row3(direction, written, dx, dy, dz)
            limit[written] = distance * (1.0 - 1e-4)
            for c in range(3):
                value[written, c] = points.albedo[row, c] * tables.light_radiance[light, c] * weight
            owner[written] = row - first
            written += 1
    return written


@kernel
def add_unblocked(blocked, value, owner, radiance):
    """Add what unblocked rays carry to their owners; radiance (P, 3) f8 is added to in ray order."""
    for i in range(blocked.shape[0]):
        if not blocked[i]:
            for c in range(3):
                radiance[owner[i], c] += value[i, c]


@device
def emitted_direction(tables, light, nx, ny, nz, u, v):
    """Direction of a photon and its flux relative to the light's: cosine for surfaces, uniform for a point."""
    kind = tables.light_kind[light]
    if kind == POINT_LIGHT:
        z = 1.0 - 2.0 * u
        r = math.sqrt(max(0.0, 1.0 - z * z))
        return r * math.cos(2.0 * math.pi * v), r * math.sin(2.0 * math.pi * v), z, 1.0
    if kind == SPOT_LIGHT:
        beam, cutoff = cone_cosines(tables, light)
        z = 1.0 - u * (1.0 - cutoff)
        r = math.sqrt(max(0.0, 1.0 - z * z))
        ax, ay, az = row3(tables.light_normal, light)
        dx, dy, dz = from_frame(ax, ay, az, r * math.cos(2.0 * math.pi * v), r * math.sin(2.0 * math.pi * v), z)
        return dx, dy, dz, spot_falloff(z, beam, cutoff)
    dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
    return dx, dy, dz, 1.0


@kernel
def emit_photons(tables, seed, first, origin, direction, flux, key):
    """Emit photons number first, first + 1, ...: lights are chosen in proportion to power.

    origin, direction, flux (N, 3) f4 are overwritten; flux [W] is yet to be divided by the number emitted.
    A spot light's photons are drawn uniformly in its cone and weighted by its falloff; all others carry equal
    power. Source: Jensen 2001, section 5.1.
    """
    epsilon = tables.epsilon[0]
    light_count = tables.light_kind.shape[0]
    for i in range(origin.shape[0]):
        photon_key = path_key(seed, EMISSION_STREAM, first + i)
        # The first hit draws from a key of its own: with this one it would repeat the emission's numbers.
        key[i] = child_key(photon_key, 0)
        u = uniform(photon_key, 0)
        light = 0
        while light < light_count - 1 and u >= tables.light_choice[light]:
            light += 1
        chance = tables.light_choice[light] - (tables.light_choice[light - 1] if light > 0 else 0.0)
        kind = tables.light_kind[light]
        if kind in (POINT_LIGHT, SPOT_LIGHT):
            px, py, pz = row3(tables.light_position, light)
            nx, ny, nz = 0.0, 0.0, 0.0
        else:
            px, py, pz, nx, ny, nz = light_point(
                tables, light, uniform(photon_key, 1), uniform(photon_key, 2)
            )
        dx, dy, dz, share = emitted_direction(
            tables, light, nx, ny, nz, uniform(photon_key, 3), uniform(photon_key, 4)
        )
        if kind == SPOT_LIGHT:
            # light_power is what the spot emits; the cone's solid angle times full intensity is what is drawn.
            solid_angle = 2.0 * math.pi * (1.0 - tables.light_cone_cos[light, 1])
            for c in range(3):
                flux[i, c] = tables.light_radiance[light, c] * solid_angle * share / chance
        else:
            for c in range(3):
                flux[i, c] = tables.light_power[light, c] / chance
        set_row3(origin, i, px + epsilon * nx, py + epsilon * ny, pz + epsilon * nz)
        set_row3(direction, i, dx, dy, dz)
