"""Photons as they leave the lights."""

import math

import numpy as np

from joulebox_render.kernels.compilation import device, kernel
from joulebox_render.kernels.lights import (
    ENVIRONMENT,
    POINT_LIGHT,
    SPHERE_LIGHT,
    SPOT_LIGHT,
    cone_cosines,
    light_point,
    spot_falloff,
)
from joulebox_render.kernels.rng import child_key, draw_1d, draw_2d
from joulebox_render.kernels.vector import cosine_direction, from_frame, row3, set_row3

# Directions of emission that photons can be aimed at: cells of equal probability.
AIM_ROWS, AIM_COLUMNS = 32, 64


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
