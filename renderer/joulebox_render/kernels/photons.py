"""What a photon does where it hits: it is stored, and Russian roulette decides how it goes on."""

from joulebox_render.kernels.compilation import kernel
from joulebox_render.kernels.lobes import phong_bounce
from joulebox_render.kernels.rng import child_key, draw_1d, draw_2d
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.transport import glass_bounce, push_ray
from joulebox_render.kernels.vector import cosine_direction, reflected, row3, set_row3

DIFFUSE, MIRROR, GLASS, PHONG = 0, 1, 2, 4
FIRST_HIT, CAUSTIC, BOUNCED = 0, 1, 2


@kernel
def scatter(tables, store_at_every_bounce, sobol, rays, history, hits, stored, following, following_history):
    """Store photons at diffuse hits and scatter them by Russian roulette.

    rays       Rays; weight is the photon's flux [W] before division by the number emitted, sample its number
    history    (N,) u1: FIRST_HIT as emitted, CAUSTIC after specular and glossy bounces alone, BOUNCED after a
               diffuse one
    stored     Photons, overwritten, in the order of the rays
    following, following_history  overwritten: photons that go on
    Returns (photons stored, photons going on).

    A surface reflects with the probability that leaves the mean of the photon's three channels as it was, so
    photons keep equal power. When photons are stored only where they are absorbed, each stands for all that
    arrived: its flux is divided by the chance of absorption. Source: Jensen 2001, sections 5.2 and 5.3.
    """
    epsilon = tables.epsilon[0]
    stored_count, ray_count = 0, 0
    for i in range(rays.origin.shape[0]):
        primitive = hits.primitive[i]
        fx, fy, fz = row3(rays.weight, i)
        flux = fx + fy + fz
        if primitive < 0 or flux <= 0.0:
            continue
        dx, dy, dz = row3(rays.direction, i)
        front, px, py, pz, gx, gy, gz, sx, sy, sz = surface_at_hit(tables, rays, hits, i, primitive)
        material = tables.material[primitive]
        kind = tables.material_kind[material]
        key, number = rays.key[i], rays.sample[i]
        ex, ey, ez = epsilon * gx, epsilon * gy, epsilon * gz
        specular_history = CAUSTIC if history[i] == FIRST_HIT else history[i]
        choice = draw_1d(sobol, key, number, 0)
        if kind == GLASS:
            share, rx, ry, rz, tx, ty, tz, _ = glass_bounce(
                tables, material, front, dx, dy, dz, gx, gy, gz, sx, sy, sz
            )
            side = 1.0
            if choice >= share:
                rx, ry, rz, side = tx, ty, tz, -1.0
            push_ray(
                following, ray_count, px + side * ex, py + side * ey, pz + side * ez, rx, ry, rz,
                fx, fy, fz, 0, child_key(key, 0), number,
            )  # fmt: skip
            following_history[ray_count] = specular_history
            ray_count += 1
            continue
        if not (front or tables.material_two_sided[material]):
            continue
        ax, ay, az = row3(tables.material_albedo, material)
        cx, cy, cz = row3(tables.material_glossy, material)
        # Chances to go on from the diffuse part and from the mirror or lobe; what is left is absorbed.
        diffuse, specular = (fx * ax + fy * ay + fz * az) / flux, 0.0
        rx, ry, rz = dx, dy, dz
        if kind == MIRROR:
            cx, cy, cz = ax, ay, az
            diffuse, specular = 0.0, diffuse
            rx, ry, rz = reflected(dx, dy, dz, sx, sy, sz)
        elif kind == PHONG:
            u, v = draw_2d(sobol, key, number, 3)
            rx, ry, rz, scale = phong_bounce(
                tables.material_exponent[material], dx, dy, dz, gx, gy, gz, sx, sy, sz, u, v
            )
            cx, cy, cz = cx * scale, cy * scale, cz * scale
            specular = (fx * cx + fy * cy + fz * cz) / flux
            # A lobe can reflect more into one direction than arrives; the excess goes into the flux.
            excess = max(1.0, diffuse + specular)
            diffuse, specular = diffuse / excess, specular / excess
        absorbed = 1.0 - diffuse - specular
        shows = kind == DIFFUSE or (kind == PHONG and max(ax, ay, az) > 0.0)
        if shows and (store_at_every_bounce or (choice >= diffuse + specular and absorbed > 0.0)):
            scale = 1.0 if store_at_every_bounce else 1.0 / absorbed
            set_row3(stored.position, stored_count, px, py, pz)
            set_row3(stored.normal, stored_count, sx, sy, sz)
            set_row3(stored.wi, stored_count, -dx, -dy, -dz)
            set_row3(stored.flux, stored_count, fx * scale, fy * scale, fz * scale)
            stored.history[stored_count] = history[i]
            stored.number[stored_count] = number
            stored_count += 1
        if choice < diffuse:
            u, v = draw_2d(sobol, key, number, 1)
            rx, ry, rz = cosine_direction(sx, sy, sz, u, v)
            if rx * gx + ry * gy + rz * gz > 0.0:
                push_ray(
                    following, ray_count, px + ex, py + ey, pz + ez, rx, ry, rz,
                    fx * ax / diffuse, fy * ay / diffuse, fz * az / diffuse, 0, child_key(key, 0), number,
                )  # fmt: skip
                following_history[ray_count] = BOUNCED
                ray_count += 1
        elif choice < diffuse + specular:
            push_ray(
                following, ray_count, px + ex, py + ey, pz + ez, rx, ry, rz,
                fx * cx / specular, fy * cy / specular, fz * cz / specular, 0, child_key(key, 0), number,
            )  # fmt: skip
            following_history[ray_count] = specular_history
            ray_count += 1
    return stored_count, ray_count
