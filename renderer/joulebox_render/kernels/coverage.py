"""How much of a density estimate's disc lies on the surface: what corrects boundary bias."""

import math

import numpy as np

from joulebox_render.kernels.compilation import kernel
from joulebox_render.kernels.gathering import kernel_weight
from joulebox_render.kernels.rng import uniform
from joulebox_render.kernels.surface import surface_at_hit
from joulebox_render.kernels.vector import normalized, row3, set_row3, tangent_frame

DIFFUSE, GLASS, PHONG = 0, 2, 4
# Dimensions of a point's key that its probes use; paths use low ones.
ROTATION, SHIFT = 40, 41
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
# Probes start this many radii above the surface: high enough to see a curved disc, low enough to stay in corners.
HEIGHT = 0.5
# A disc on a curved surface lies off its tangent plane: a probe may go this many times as far as the plane.
FARTHEST = 1.5
# Surfaces whose normal's cosine with the point's is less hang over the disc.
OVERHANG = -0.2


@kernel
def aim_probes(tables, position, normal, key, radius, chosen, count, probes):
    """Rays from above chosen points to `count` places spread evenly over the disc of each one's estimate.

    position, normal (N, 3) f4; key (N,) u8; radius (N,) f4 [m]; chosen (C,) i8, rows of these. The places are those
    of a sunflower's seeds (Vogel 1979), turned and shifted by the point's key. probes, of C x (1 + count) rows in
    the order of `chosen`, is overwritten; length is the distance to the tangent plane. The first of each point's
    goes straight up, to see whether there is room.
    """
    lift = tables.epsilon[0]
    row = 0
    for c in range(chosen.shape[0]):
        point = chosen[c]
        px, py, pz = row3(position, point)
        nx, ny, nz = row3(normal, point)
        sx, sy, sz, tx, ty, tz = tangent_frame(nx, ny, nz)
        r = np.float64(radius[point])
        turn, shift = 2.0 * math.pi * uniform(key[point], ROTATION), uniform(key[point], SHIFT)
        set_row3(probes.origin, row, px + lift * nx, py + lift * ny, pz + lift * nz)
        set_row3(probes.direction, row, nx, ny, nz)
        probes.length[row], probes.share2[row] = r, 0.0
        row += 1
        for i in range(count):
            share2 = (i + shift) / count
            a, phi = math.sqrt(share2), turn + i * GOLDEN_ANGLE
            u, v = a * math.cos(phi), a * math.sin(phi)
            dx, dy, dz = normalized(
                u * sx + v * tx - HEIGHT * nx, u * sy + v * ty - HEIGHT * ny, u * sz + v * tz - HEIGHT * nz
            )
            set_row3(probes.origin, row, px + r * HEIGHT * nx, py + r * HEIGHT * ny, pz + r * HEIGHT * nz)
            set_row3(probes.direction, row, dx, dy, dz)
            probes.length[row], probes.share2[row] = r * math.sqrt(share2 + HEIGHT * HEIGHT), share2
            row += 1


@kernel
def covered_share(tables, normal, chosen, count, cos_limit, filter_kind, probes, hits, share):
    """Share of each chosen point's disc, weighted as its photons are, whose photons the estimate would count.

    A probe counts where the first thing it hits lies about where the disc is, is diffuse, and has a normal
    within the angle of the point's: photons on it would be found. Walls and boxes in the disc's way, mirrors, and
    nothing at all do not count. What the surface does behind glass and under overhangs cannot be told; such
    probes are left out, and so are points with anything less than a radius above them, as next to where a ball
    touches the floor: their share is 1. share (C,) f8 is overwritten.
    """
    for c in range(chosen.shape[0]):
        nx, ny, nz = row3(normal, chosen[c])
        up = c * (1 + count)
        covered, total = 0.0, 0.0
        if hits.primitive[up] < 0 or hits.distance[up] > probes.length[up]:
            for i in range(up + 1, up + 1 + count):
                weight = kernel_weight(filter_kind, probes.share2[i])
                primitive = hits.primitive[i]
                if primitive < 0 or hits.distance[i] > FARTHEST * probes.length[i]:
                    total += weight
                    continue
                material = tables.material[primitive]
                kind = tables.material_kind[material]
                front, _, _, _, _, _, _, sx, sy, sz = surface_at_hit(tables, probes, hits, i, primitive)
                cosine = sx * nx + sy * ny + sz * nz
                if kind == GLASS or cosine < OVERHANG:
                    continue
                total += weight
                if kind in (DIFFUSE, PHONG) and (front or tables.material_two_sided[material]) and cosine >= cos_limit:
                    covered += weight
        share[c] = covered / total if total > 0.0 else 1.0
