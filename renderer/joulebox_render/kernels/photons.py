"""What a photon does where it hits: it is stored, and Russian roulette decides how it goes on."""

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.lobes import phong_bounce
from joulebox_render.kernels.rng import child_key, draw_1d, draw_2d
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.transport import glass_bounce, push_ray
from joulebox_render.kernels.vector import cosine_direction, reflected, row3, set_row3, specular_normal

DIFFUSE, MIRROR, GLASS, PHONG = 0, 1, 2, 4
FIRST_HIT, CAUSTIC, BOUNCED = 0, 1, 2


@device
def store_photon(rays, i, at, scale, history, stored, row):
    """Write the photon that arrives at `at` into row `row`, its flux scaled."""
    _, px, py, pz, _, _, _, sx, sy, sz = at
    dx, dy, dz = row3(rays.direction, i)
    fx, fy, fz = row3(rays.weight, i)
    set_row3(stored.position, row, px, py, pz)
    set_row3(stored.normal, row, sx, sy, sz)
    set_row3(stored.wi, row, -dx, -dy, -dz)
    set_row3(stored.flux, row, fx * scale, fy * scale, fz * scale)
    stored.history[row], stored.number[row] = history, rays.sample[i]


@device
def specular_bounce(tables, material, sobol, rays, i, at):
    """How a photon leaves a mirror or a glossy lobe: direction, and what of each channel goes there."""
    kind = tables.material_kind[material]
    _, _, _, _, gx, gy, gz, sx, sy, sz = at
    dx, dy, dz = row3(rays.direction, i)
    if kind == MIRROR:
        rx, ry, rz = reflected(dx, dy, dz, *specular_normal(dx, dy, dz, gx, gy, gz, sx, sy, sz))
        cx, cy, cz = row3(tables.material_albedo, material)
        return rx, ry, rz, cx, cy, cz
    if kind != PHONG:
        return dx, dy, dz, np.float32(0.0), np.float32(0.0), np.float32(0.0)
    u, v = draw_2d(sobol, rays.key[i], rays.sample[i], 3)
    rx, ry, rz, scale = phong_bounce(tables.material_exponent[material], dx, dy, dz, gx, gy, gz, sx, sy, sz, u, v)
    cx, cy, cz = row3(tables.material_glossy, material)
    return rx, ry, rz, cx * scale, cy * scale, cz * scale


@device
def diffuse_albedo(tables, material):
    """What of each channel a surface that is not glass reflects diffusely."""
    if tables.material_kind[material] == MIRROR:
        return np.float32(0.0), np.float32(0.0), np.float32(0.0)
    return row3(tables.material_albedo, material)


@device
def shows_photons(tables, material):
    """Whether light on a surface can be seen from anywhere: it is diffuse, or Phong with a diffuse part."""
    kind = tables.material_kind[material]
    ax, ay, az = row3(tables.material_albedo, material)
    return kind == DIFFUSE or (kind == PHONG and max(ax, ay, az) > 0.0)


@device
def reflection_chances(fx, fy, fz, ax, ay, az, cx, cy, cz):
    """Chances to go on from the diffuse part and from the mirror or lobe; what is left is absorbed.

    A lobe can reflect more into one direction than arrives; the excess goes into the flux.
    """
    flux = fx + fy + fz
    diffuse, specular = (fx * ax + fy * ay + fz * az) / flux, (fx * cx + fy * cy + fz * cz) / flux
    excess = max(1.0, diffuse + specular)
    return diffuse / excess, specular / excess


@device
def stored_scale(store_at_every_bounce, choice, diffuse, specular):
    """Factor on the flux of a photon stored where it goes on with these chances; 0: it is not stored.

    Stored only where it is absorbed, a photon stands for all that arrived.
    """
    if store_at_every_bounce:
        return 1.0
    if choice < diffuse + specular or diffuse + specular >= 1.0:
        return 0.0
    return 1.0 / (1.0 - diffuse - specular)


@device
def glass_direction(tables, material, choice, rays, i, at):
    """Where a photon goes on from glass, by Fresnel reflectance, and on which side of it: 1 reflected, -1 refracted."""
    front, _, _, _, gx, gy, gz, sx, sy, sz = at
    dx, dy, dz = row3(rays.direction, i)
    share, rx, ry, rz, tx, ty, tz, _ = glass_bounce(tables, material, front, dx, dy, dz, gx, gy, gz, sx, sy, sz)
    if choice >= share:
        return tx, ty, tz, -1.0
    return rx, ry, rz, 1.0


@device
def push_onward(tables, rays, i, at, turn, rx, ry, rz, fx, fy, fz, following, row):
    """Write the photon that goes on from `at`, on the side it came from where `turn` is 1, behind it where -1."""
    side = tables.epsilon[0] * turn
    push_ray(
        following, row, at[1] + side * at[4], at[2] + side * at[5], at[3] + side * at[6], rx, ry, rz,
        fx, fy, fz, 0, child_key(rays.key[i], 0), rays.sample[i],
    )  # fmt: skip


@kernel
def scatter(tables, store_at_every_bounce, sobol, wanted, rays, history, hits, stored, following, following_history):
    """Store photons at diffuse hits and scatter them by Russian roulette.

    wanted     (3,) u1: whether photons of each history are stored; where BOUNCED ones are not, none is followed
               after a diffuse bounce
    rays       Rays; weight is the photon's flux [W] before division by the number emitted, sample its number
    history    (N,) u1: FIRST_HIT as emitted, CAUSTIC after specular and glossy bounces alone, BOUNCED after a
               diffuse one
    stored     Photons, overwritten, in the order of the rays
    following, following_history  overwritten: photons that go on
    Returns (photons stored, photons going on).

    A surface reflects with the probability that leaves the mean of the photon's three channels as it was, so
    photons keep equal power. Source: Jensen 2001, sections 5.2 and 5.3.
    """
    stored_count, ray_count = 0, 0
    for i in range(rays.origin.shape[0]):
        primitive = hits.primitive[i]
        fx, fy, fz = row3(rays.weight, i)
        if primitive < 0 or fx + fy + fz <= 0.0:
            continue
        at = surface_at_hit(tables, rays, hits, i, primitive)
        material = tables.material[primitive]
        glass = tables.material_kind[material] == GLASS
        if not (at[0] or glass or tables.material_two_sided[material]):
            continue
        choice, turn = draw_1d(sobol, rays.key[i], rays.sample[i], 0), 1.0
        going = CAUSTIC if history[i] == FIRST_HIT else history[i]
        if glass:
            rx, ry, rz, turn = glass_direction(tables, material, choice, rays, i, at)
        else:
            ax, ay, az = diffuse_albedo(tables, material)
            rx, ry, rz, cx, cy, cz = specular_bounce(tables, material, sobol, rays, i, at)
            diffuse, specular = reflection_chances(fx, fy, fz, ax, ay, az, cx, cy, cz)
            scale = stored_scale(store_at_every_bounce, choice, diffuse, specular)
            if scale > 0.0 and wanted[history[i]] and shows_photons(tables, material):
                store_photon(rays, i, at, scale, history[i], stored, stored_count)
                stored_count += 1
            if choice >= diffuse + specular:
                continue
            if choice < diffuse:
                u, v = draw_2d(sobol, rays.key[i], rays.sample[i], 1)
                rx, ry, rz = cosine_direction(at[7], at[8], at[9], u, v)
                if not wanted[BOUNCED] or rx * at[4] + ry * at[5] + rz * at[6] <= 0.0:
                    continue
                going = BOUNCED
                fx, fy, fz = fx * ax / diffuse, fy * ay / diffuse, fz * az / diffuse
            else:
                fx, fy, fz = fx * cx / specular, fy * cy / specular, fz * cz / specular
        push_onward(tables, rays, i, at, turn, rx, ry, rz, fx, fy, fz, following, ray_count)
        following_history[ray_count] = going
        ray_count += 1
    return stored_count, ray_count
