"""Phong's glossy lobes: rays of the lobe, samples of the lights, and how the two share a light between them.

A light that a lobe shows is found in two ways, by rays that follow the lobe and by samples of the light. Each is good
where the other is noisy: narrow lobes and large lights, wide lobes and small ones. Both are weighed by the balance
heuristic (Veach 1997, section 9.2.2), so that every light counts once. The sky is left to rays of the lobe: it is the
same everywhere, so that these have the density of what they look for, and samples of it would add noise.

    f(wi, wo) = glossy (n + 2) / (2 pi) cos^n alpha,  alpha between wi and the mirror image of wo

Source of the lobe: Lafortune & Willems 1994, as in Mitsuba 0.6.
"""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.lights import POINT_LIGHT, SPHERE_LIGHT, SPOT_LIGHT, light_sample
from joulebox_render.kernels.rng import child_key, fill_2d, member_key, sample_2d, uniform
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.transport import push_ray
from joulebox_render.kernels.vector import from_frame, reflected, row3, set_row3

# Families of the samples of each light, apart from those of the diffuse points that the lobe's rays reach.
LIGHT_BRANCH, KEPT_BRANCH = 2_000_000, 3_000_000
# What a ray may meet instead of the row of a light.
NO_LIGHT, SKY = -1, -2
# Samples of a light where the lobe reflects less than this share of what it does in its middle are traced in
# proportion to what it reflects: most lie outside a narrow lobe.
FAINT = 0.01


@device
def lobe_power(exponent, dx, dy, dz, mx, my, mz):
    """cos^exponent of the angle between unit vectors d and m, 0 beyond a right angle.

    From the chord, which keeps the digits of narrow lobes: cos = 1 - |d - m|^2 / 2.
    """
    half = 0.5 * ((dx - mx) ** 2 + (dy - my) ** 2 + (dz - mz) ** 2)
    return math.exp(exponent * math.log1p(-half)) if half < 1.0 else 0.0


@device
def lobe_direction(exponent, mx, my, mz, gx, gy, gz, sx, sy, sz, u, v):
    """A direction from the lobe about the unit vector m: (direction, scale, density [1/sr]).

    density = (n + 1) / (2 pi) cos^n; scale = (n + 2) / (n + 1) cos theta is what it reflects relative to the lobe's
    reflectance, 0 where the lobe dips below the surface.
    """
    rest = 1.0 - u
    cos_lobe = math.pow(rest, 1.0 / (exponent + 1.0))
    r = math.sqrt(max(0.0, 1.0 - cos_lobe * cos_lobe))
    phi = 2.0 * math.pi * v
    ox, oy, oz = from_frame(mx, my, mz, r * math.cos(phi), r * math.sin(phi), cos_lobe)
    cos_out = ox * sx + oy * sy + oz * sz
    density = (exponent + 1.0) / (2.0 * math.pi) * math.pow(rest, exponent / (exponent + 1.0))
    if cos_out <= 0.0 or ox * gx + oy * gy + oz * gz <= 0.0:
        return ox, oy, oz, 0.0, density
    return ox, oy, oz, (exponent + 2.0) / (exponent + 1.0) * cos_out, density


@device
def phong_bounce(exponent, dx, dy, dz, gx, gy, gz, sx, sy, sz, u, v):
    """As lobe_direction for light that travels along d: (direction, scale)."""
    mx, my, mz = reflected(dx, dy, dz, sx, sy, sz)
    ox, oy, oz, scale, _ = lobe_direction(exponent, mx, my, mz, gx, gy, gz, sx, sy, sz, u, v)
    return ox, oy, oz, scale


@kernel
def lobe_rays(lobes, fan, columns, first, rays, density):
    """`fan` rays from each lobe, written to rays from row `first` on; returns how many rows are then filled.

    density (N,) f4 of the rays times `fan` is written beside [1/sr].
    """
    row = first
    for i in range(lobes.exponent.shape[0]):
        px, py, pz = row3(lobes.at.position, i)
        gx, gy, gz = row3(lobes.at.geometric, i)
        sx, sy, sz = row3(lobes.at.normal, i)
        mx, my, mz = row3(lobes.mirror, i)
        cx, cy, cz = row3(lobes.at.albedo, i)
        wx, wy, wz = row3(lobes.at.weight, i)
        key, sample = lobes.at.key[i], lobes.at.sample[i]
        for j in range(fan):
            u, v = sample_2d(key, sample, 1, j, fan, columns)
            dx, dy, dz, scale, of_one = lobe_direction(lobes.exponent[i], mx, my, mz, gx, gy, gz, sx, sy, sz, u, v)
            if scale <= 0.0:
                continue
            scale /= fan
            push_ray(
                rays, row, px, py, pz, dx, dy, dz, wx * cx * scale, wy * cy * scale, wz * cz * scale,
                lobes.at.owner[i], key, sample * fan + j,
            )  # fmt: skip
            density[row] = fan * of_one
            row += 1
    return row


@device
def light_density(tables, light, px, py, pz, distance, cos_light):
    """Density [1/sr] with which samples of an area light, seen from p, have the direction that meets it so."""
    if tables.light_kind[light] == SPHERE_LIGHT and tables.light_normal[light, 0] > 0.0:
        cx, cy, cz = row3(tables.light_position, light)
        d2 = (np.float64(cx) - px) ** 2 + (np.float64(cy) - py) ** 2 + (np.float64(cz) - pz) ** 2
        sin2_max = np.float64(tables.light_radius[light]) ** 2 / d2
        # As lights.sphere_light_sample, without cancellation for small, distant spheres.
        return (1.0 + math.sqrt(max(0.0, 1.0 - sin2_max))) / (2.0 * math.pi * sin2_max)
    return np.float64(distance) * distance / (tables.light_area[light] * cos_light)


@kernel
def lobe_shadow_rays(tables, light, count, fan, columns, lobes, first, last, shadow):
    """As lighting.shadow_rays for the lobes [first, last), each followed by `fan` rays besides; not for the sky.

    Only samples that the lobe reflects are written into shadow (ShadowRays), and of those that are FAINT a part. weight
    times the light's radiance and the lobe's albedo is what each reflects, as its share between samples and
    rays of the lobe.
    """
    written, limit, weight = 0, shadow.limit, shadow.weight
    # Rays cannot meet a point.
    met = 0.0 if tables.light_kind[light] in (POINT_LIGHT, SPOT_LIGHT) else np.float64(fan)
    for row in range(first, last):
        px, py, pz = row3(lobes.at.position, row)
        nx, ny, nz = row3(lobes.at.normal, row)
        gx, gy, gz = row3(lobes.at.geometric, row)
        mx, my, mz = row3(lobes.mirror, row)
        exponent = np.float64(lobes.exponent[row])
        # Samples wait where their rays' own numbers will be written, which no ray reaches before it is read.
        begin, key = written, lobes.at.key[row]
        fill_2d(child_key(key, LIGHT_BRANCH + light), lobes.at.sample[row], 1, 1, count, columns, limit, weight, begin)
        path = member_key(child_key(key, KEPT_BRANCH + light), lobes.at.sample[row])
        for i in range(begin, begin + count):
            u, v = limit[i], weight[i]
            dx, dy, dz, distance, scale = light_sample(tables, light, px, py, pz, u, v)
            cos_point = dx * nx + dy * ny + dz * nz
            if scale <= 0.0 or cos_point <= 0.0 or dx * gx + dy * gy + dz * gz <= 0.0:
                continue
            power = lobe_power(exponent, dx, dy, dz, mx, my, mz)
            if power < FAINT and uniform(path, i - begin) * FAINT >= power:
                continue
            own = met * (exponent + 1.0) / (2.0 * math.pi) * power
            set_row3(shadow.origin, written, px, py, pz)
            set_row3(shadow.direction, written, dx, dy, dz)
            limit[written] = distance * (1.0 - 1e-4)
            # What chance kept stands for what it did not.
            value = (exponent + 2.0) / (2.0 * math.pi) * max(power, FAINT)
            weight[written] = value * cos_point / (count / scale + own)
            shadow.owner[written] = row - first
            written += 1
    return written


@kernel
def add_emission(tables, samples, rays, density, hits, radiance):
    """Add light emitted where rays end, and the sky where they meet nothing, to their owners; radiance (owners, 3) f8.

    density  (N,) f4 of lobe_rays, 0 for rays that are of no lobe; without rows none is
    samples  of each light that the lobes took besides their rays
    """
    for i in range(rays.origin.shape[0]):
        primitive = hits.primitive[i]
        light = tables.light[primitive] if primitive >= 0 else SKY
        if light == NO_LIGHT:
            continue
        owner = rays.owner[i]
        wx, wy, wz = row3(rays.weight, i)
        if light == SKY:
            radiance[owner, 0] += wx * tables.sky[0]
            radiance[owner, 1] += wy * tables.sky[1]
            radiance[owner, 2] += wz * tables.sky[2]
            continue
        front, _, _, _, gx, gy, gz, _, _, _ = surface_at_hit(tables, rays, hits, i, primitive)
        if not front:
            continue
        share = 1.0
        if density.shape[0] > 0 and density[i] > 0.0:
            own = np.float64(density[i])
            ox, oy, oz = row3(rays.origin, i)
            dx, dy, dz = row3(rays.direction, i)
            cos_light = -(dx * gx + dy * gy + dz * gz)
            other = light_density(tables, light, ox, oy, oz, hits.distance[i], cos_light)
            share = own / (own + samples * other)
        radiance[owner, 0] += wx * share * tables.light_radiance[light, 0]
        radiance[owner, 1] += wy * share * tables.light_radiance[light, 1]
        radiance[owner, 2] += wz * share * tables.light_radiance[light, 2]
