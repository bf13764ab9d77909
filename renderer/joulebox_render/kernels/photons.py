"""What a photon does where it hits: it is stored, and Russian roulette decides how it goes on."""

from joulebox_render.kernels.compilation import kernel
from joulebox_render.kernels.rng import child_key, uniform
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.transport import glass_bounce, push_ray
from joulebox_render.kernels.vector import cosine_direction, reflected, row3, set_row3

DIFFUSE, MIRROR, GLASS = 0, 1, 2
FIRST_HIT, CAUSTIC, BOUNCED = 0, 1, 2


@kernel
def scatter(tables, store_at_every_bounce, rays, history, hits, stored, following, following_history):
    """Store photons at diffuse hits and scatter them by Russian roulette.

    rays       Rays; weight is the photon's flux [W] before division by the number emitted, owner its number
    history    (N,) u1: FIRST_HIT as emitted, CAUSTIC after specular bounces alone, BOUNCED after a diffuse one
    stored     Photons, overwritten, in the order of the rays
    following, following_history  overwritten: photons that go on
    Returns (photons stored, photons going on).

    A diffuse surface reflects with the probability that leaves the mean of the photon's three channels as it
    was, so photons keep equal power. When photons are stored only where they are absorbed, each stands for all
    that arrived: its flux is divided by the chance of absorption. Source: Jensen 2001, sections 5.2 and 5.3.
    """
    epsilon = tables.epsilon[0]
    stored_count, ray_count = 0, 0
    for i in range(rays.origin.shape[0]):
        primitive = hits.primitive[i]
        fx, fy, fz = row3(rays.weight, i)
        if primitive < 0 or fx + fy + fz <= 0.0:
            continue
        dx, dy, dz = row3(rays.direction, i)
        front, px, py, pz, gx, gy, gz, sx, sy, sz = surface_at_hit(tables, rays, hits, i, primitive)
        material = tables.material[primitive]
        kind = tables.material_kind[material]
        key, number = rays.key[i], rays.owner[i]
        ex, ey, ez = epsilon * gx, epsilon * gy, epsilon * gz
        ax, ay, az = row3(tables.material_albedo, material)
        sees = front or tables.material_two_sided[material]
        keep = (fx * ax + fy * ay + fz * az) / (fx + fy + fz)
        survives = uniform(key, 0) < keep
        if kind == GLASS:
            share, rx, ry, rz, tx, ty, tz, _ = glass_bounce(
                tables, material, front, dx, dy, dz, gx, gy, gz, sx, sy, sz
            )
            side = 1.0
            if uniform(key, 1) >= share:
                rx, ry, rz, side = tx, ty, tz, -1.0
            push_ray(
                following, ray_count, px + side * ex, py + side * ey, pz + side * ez, rx, ry, rz,
                fx, fy, fz, number, child_key(key, 0),
            )  # fmt: skip
            following_history[ray_count] = CAUSTIC if history[i] == FIRST_HIT else history[i]
            ray_count += 1
        elif kind == MIRROR and sees and survives:
            rx, ry, rz = reflected(dx, dy, dz, sx, sy, sz)
            push_ray(
                following, ray_count, px + ex, py + ey, pz + ez, rx, ry, rz,
                fx * ax / keep, fy * ay / keep, fz * az / keep, number, child_key(key, 0),
            )  # fmt: skip
            following_history[ray_count] = CAUSTIC if history[i] == FIRST_HIT else history[i]
            ray_count += 1
        elif kind == DIFFUSE and sees:
            if store_at_every_bounce or not survives:
                scale = 1.0 if store_at_every_bounce else 1.0 / (1.0 - keep)
                set_row3(stored.position, stored_count, px, py, pz)
                set_row3(stored.normal, stored_count, sx, sy, sz)
                set_row3(stored.flux, stored_count, fx * scale, fy * scale, fz * scale)
                stored.history[stored_count] = history[i]
                stored.number[stored_count] = number
                stored_count += 1
            if survives:
                rx, ry, rz = cosine_direction(sx, sy, sz, uniform(key, 1), uniform(key, 2))
                if rx * gx + ry * gy + rz * gz > 0.0:
                    push_ray(
                        following, ray_count, px + ex, py + ey, pz + ez, rx, ry, rz,
                        fx * ax / keep, fy * ay / keep, fz * az / keep, number, child_key(key, 0),
                    )  # fmt: skip
                    following_history[ray_count] = BOUNCED
                    ray_count += 1
    return stored_count, ray_count
