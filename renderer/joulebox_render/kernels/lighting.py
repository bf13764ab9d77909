"""Light leaving the lights: samples towards a point (direct lighting) and photons into the scene (emission)."""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.rng import child_key, draw_1d, draw_2d, fill_2d
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.vector import cosine_direction, from_frame, row3, set_row3

POINT_LIGHT, SPOT_LIGHT, RECTANGLE_LIGHT, DISK_LIGHT, SPHERE_LIGHT, MESH_LIGHT, ENVIRONMENT = 0, 1, 2, 3, 4, 5, 6
LIGHT_BRANCH, CLOSE_BRANCH = 1000, 1_000_000
# Samples of a flat light that bring more than this many times a whole sky of its radiance are left to rays by cosine,
# whose every hit brings one sky: near a light and where lights meet, the inverse square has no bound.
CLOSE = 2.0
# Shadow rays end this share of their length before the light. Squares of distances are not taken for less [m^2].
SHORT, NEAREST2 = np.float32(1.0 - 1e-4), np.float32(1e-30)
# In single precision: with Python's numbers numba would go over to double.
ZERO, ONE = np.float32(0.0), np.float32(1.0)
# How far away the environment is taken to be [m].
SKY_DISTANCE = 1e30
# Directions of emission that photons can be aimed at: cells of equal probability.
AIM_ROWS, AIM_COLUMNS = 32, 64


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
    # One division: there are many in this loop otherwise, and they are what it waits for.
    inverse = 1.0 / math.sqrt(d2)
    distance = d2 * inverse
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    if kind == POINT_LIGHT:
        return dx, dy, dz, distance, inverse * inverse
    if kind == SPOT_LIGHT:
        ax, ay, az = row3(tables.light_normal, light)
        cos_axis = -(dx * ax + dy * ay + dz * az)
        beam, cutoff = cone_cosines(tables, light)
        return dx, dy, dz, distance, spot_falloff(cos_axis, beam, cutoff) * inverse * inverse
    cos_light = -(dx * nx + dy * ny + dz * nz)
    return dx, dy, dz, distance, max(0.0, cos_light) * tables.light_area[light] * inverse * inverse


@device
def light_faces(tables, light, points, row):
    """Whether any of a light may shine on a point, as far as the planes of both tell."""
    kind = tables.light_kind[light]
    if kind != RECTANGLE_LIGHT and kind != DISK_LIGHT:
        return True
    px, py, pz = row3(points.position, row)
    cx, cy, cz = row3(tables.light_position, light)
    lx, ly, lz = row3(tables.light_normal, light)
    dx, dy, dz = cx - px, cy - py, cz - pz
    if dx * lx + dy * ly + dz * lz >= 0.0:
        return False
    nx, ny, nz = row3(points.normal, row)
    ux, uy, uz = row3(tables.light_edge_u, light)
    vx, vy, vz = row3(tables.light_edge_v, light)
    # How high the highest corner stands above the point's horizon.
    return dx * nx + dy * ny + dz * nz + abs(ux * nx + uy * ny + uz * nz) + abs(vx * nx + vy * ny + vz * nz) > 0.0


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


@kernel
def close_points(tables, light, points, first, last, row):
    """Rows of points [first, last) that may be close to a light; row (last - first,) i4; returns how many."""
    count, reach = 0, tables.light_close[light]
    cx, cy, cz = row3(tables.light_position, light)
    for i in range(first, last):
        px, py, pz = row3(points.position, i)
        if (px - cx) ** 2 + (py - cy) ** 2 + (pz - cz) ** 2 < reach * reach:
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


@device
def sphere_direction(u, v):
    """Uniform direction."""
    z = 1.0 - 2.0 * u
    r = math.sqrt(max(0.0, 1.0 - z * z))
    return r * math.cos(2.0 * math.pi * v), r * math.sin(2.0 * math.pi * v), z


@device
def emitted_ray(tables, light, a, b, u, v):
    """Where and how one photon leaves a light: (origin, direction, chance that it is emitted at all).

    a, b place the origin; u, v choose the direction alone: from a sphere and from the environment it is uniform, and
    the origin follows it; from flat lights it has the cosine density about the normal. A spot's directions are uniform
    in its cone, and its falloff is the chance. Source: Jensen 2001, section 5.1.
    """
    epsilon = tables.epsilon[0]
    kind = tables.light_kind[light]
    px, py, pz = row3(tables.light_position, light)
    nx, ny, nz = row3(tables.light_normal, light)
    if kind == SPOT_LIGHT:
        beam, cutoff = cone_cosines(tables, light)
        z = 1.0 - u * (1.0 - cutoff)
        r = math.sqrt(max(0.0, 1.0 - z * z))
        dx, dy, dz = from_frame(nx, ny, nz, r * math.cos(2.0 * math.pi * v), r * math.sin(2.0 * math.pi * v), z)
        return px, py, pz, dx, dy, dz, spot_falloff(z, beam, cutoff)
    if kind in (POINT_LIGHT, SPHERE_LIGHT, ENVIRONMENT):
        dx, dy, dz = sphere_direction(u, v)
        radius = tables.light_radius[light]
        if kind == SPHERE_LIGHT:
            side = nx
            nx, ny, nz = cosine_direction(dx, dy, dz, a, b)
            px, py, pz = px + side * radius * nx, py + side * radius * ny, pz + side * radius * nz
            return px + epsilon * nx, py + epsilon * ny, pz + epsilon * nz, dx, dy, dz, 1.0
        if kind == ENVIRONMENT:
            r = math.sqrt(a)
            x, y, z = from_frame(dx, dy, dz, r * math.cos(2.0 * math.pi * b), r * math.sin(2.0 * math.pi * b), -1.0)
            px, py, pz = px + radius * x, py + radius * y, pz + radius * z
        return px, py, pz, dx, dy, dz, 1.0
    px, py, pz, nx, ny, nz = light_point(tables, light, a, b)
    dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
    return px + epsilon * nx, py + epsilon * ny, pz + epsilon * nz, dx, dy, dz, 1.0


@device
def drawn_flux(tables, light):
    """Flux of the rays drawn over the flux that leaves the light: above 1 for a spot, whose falloff loses some."""
    if tables.light_kind[light] != SPOT_LIGHT:
        return 1.0
    cos_beam, cos_cutoff = cone_cosines(tables, light)
    beam, cutoff = math.acos(cos_beam), math.acos(cos_cutoff)
    mean = cos_cutoff if beam == cutoff else (math.sin(cutoff) - math.sin(beam)) / (cutoff - beam)
    return (1.0 - cos_cutoff) / (1.0 - mean)


@kernel
def emit_photons(tables, aim, sobol, family, first, rays):
    """Emit photons number first, first + 1, ...: lights are chosen in proportion to the power they send on aimed paths.

    rays is overwritten; owner is the light, weight flux [W], yet to be divided by the number emitted, equal for all
    photons of a light; 0 for one that a spot's falloff swallows. Where `aim` lists cells of a light's directions,
    only these are drawn, and the flux is their share of the light's.
    """
    light_count = tables.light_kind.shape[0]
    for i in range(rays.sample.shape[0]):
        number = first + i
        choice = draw_1d(sobol, family, number, 0)
        light = 0
        while light < light_count - 1 and choice >= aim.choice[light]:
            light += 1
        chance = aim.choice[light] - (aim.choice[light - 1] if light > 0 else 0.0)
        a, b = draw_2d(sobol, family, number, 1)
        u, v = draw_2d(sobol, family, number, 3)
        cells = aim.first[light + 1] - aim.first[light]
        if cells > 0:
            place = min(np.int64(u * cells), cells - 1)
            cell = aim.cell[aim.first[light] + place]
            u, v = (cell // AIM_COLUMNS + (u * cells - place)) / AIM_ROWS, (cell % AIM_COLUMNS + v) / AIM_COLUMNS
        px, py, pz, dx, dy, dz, leaves = emitted_ray(tables, light, a, b, u, v)
        share = drawn_flux(tables, light) * aim.share[light] / chance
        if leaves < 1.0 and draw_1d(sobol, family, number, 5) >= leaves:
            share = 0.0
        fx, fy, fz = row3(tables.light_power, light)
        set_row3(rays.origin, i, px, py, pz)
        set_row3(rays.direction, i, dx, dy, dz)
        set_row3(rays.weight, i, fx * share, fy * share, fz * share)
        # A family of its own: the first bounce must not use the numbers that placed the photon on its light.
        rays.owner[i], rays.key[i], rays.sample[i] = light, child_key(family, 0), number
