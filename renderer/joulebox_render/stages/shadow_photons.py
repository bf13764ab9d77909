"""Direct and shadow photons: where a light is surely seen or surely hidden, so that no shadow ray need ask.

Rays leave the area lights as photons do. Where one first hits lies a direct photon; it then runs on through the scene
and leaves a shadow photon on every further surface that faces the light (Jensen & Christensen 1995, "Efficient
rendering with shadow photons"). Each photon then looks at its light's border, because that is what a penumbra loses
first: a photon that sees all of it is lit, a shadow photon that sees none is hidden, any other lies in a penumbra.
Space is cut into cells, and a cell is decided where enough photons lie in it and the 26 around it and all agree.

Point and spot lights cost one ray, which there is nothing to save on; the sky is in part hidden almost everywhere.
Neither has photons here, and both are asked with rays. What is smaller than the distance between photons can be
missed with its shadow: the error is measured, not bounded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from joulebox_render.kernels.lighting import emit_photons
from joulebox_render.kernels.rng import path_key
from joulebox_render.kernels.shadow_photons import (
    BORDER_RAYS,
    CELL_BITS,
    CELLS,
    EMPTY,
    HIDDEN,
    LIT,
    UNKNOWN,
    border_rays,
    drop_photons,
    fill_cells,
)
from joulebox_render.records import (
    DISK_LIGHT,
    F4,
    F8,
    I4,
    I8,
    MESH_LIGHT,
    RECTANGLE_LIGHT,
    SPHERE_LIGHT,
    U1,
    U8,
    Aim,
    Rays,
    rows,
)
from joulebox_render.stages.aim import aim_everywhere
from joulebox_render.stages.context import Context
from joulebox_render.stages.photon_map import EMISSION_STREAM, EMITTED_PER_STORED

TESTED_LIGHTS = (RECTANGLE_LIGHT, DISK_LIGHT, SPHERE_LIGHT, MESH_LIGHT)
# The emission beside those of the global and the caustic map.
THROUGH = 2
# Surfaces that a ray runs through at most.
MOST_SURFACES = 64
# Photons in a cell of a surface that is lit like most, and those that a cell and its neighbours need to be decided.
CELL_PHOTONS, LEAST_PHOTONS = 5.0, 16
# The density of photons is measured by the distance to this neighbour, at about so many of them.
DENSITY_NEIGHBOURS, DENSITY_PROBES = 12, 500


class LightPhotons(NamedTuple):
    """Photons that tell about visibility, in order of emission.

    position (N, 3) f4 [m], lifted off the surface by the scene's epsilon; normal (N, 3) f4, geometric, on the side
    of the light; light (N,) i4; is_shadow (N,) u1; number (N,) i8 of the emission.
    """

    position: F4
    normal: F4
    light: I4
    is_shadow: U1
    number: I8

    @classmethod
    def empty(cls, count: int) -> LightPhotons:
        """Room for `count` photons."""
        position, normal = np.empty((2, count, 3), np.float32)
        return cls(
            position, normal, np.empty(count, np.int32), np.empty(count, np.uint8), np.empty(count, np.int64)
        )


class ShadowCells(NamedTuple):
    """Cells in which a light is surely seen or hidden: a hash table a light.

    corner (L, 3) f8 [m] and per_m (L,) f8 [1/m]: a point lies in cell floor((point - corner) per_m); light l owns the
    slots first[l] to first[l + 1] (L + 1,) i8 of key (S,) u8 and verdict (S,) u1 (LIT or HIDDEN).
    """

    corner: F8
    per_m: F8
    first: I8
    key: U8
    verdict: U1


@dataclass(frozen=True)
class ShadowMap:
    """The decided cells and what they were made of; complete is False when emission ended before enough was stored."""

    cells: ShadowCells
    direct_stored: int
    shadow_stored: int
    emitted: int
    complete: bool
    rays: int


def build_shadow_map(context: Context) -> ShadowMap:
    """Emit direct and shadow photons, let them look at their lights, and decide cells."""
    photons, emitted, traced = emit_through(context)
    parts = list(context.pool.map_chunks(lambda a, b: _look_back(context, photons, a, b), len(photons.number), 8))
    verdict = np.concatenate([part for part, _ in parts]) if parts else np.zeros(0, np.uint8)
    direct = int((photons.is_shadow == 0).sum())
    return ShadowMap(
        decide_cells(photons, verdict, len(context.tables.light_kind)), direct, len(photons.number) - direct,
        emitted, direct >= context.settings.direct_photons, traced + sum(rays for _, rays in parts),
    )  # fmt: skip


def emit_through(context: Context) -> tuple[LightPhotons, int, int]:
    """Direct photons, as many as the settings ask for, and the shadow photons behind them; emitted; rays traced."""
    wanted = context.settings.direct_photons
    bound = EMITTED_PER_STORED * wanted
    aim = aim_from_areas(context)
    parts: list[LightPhotons] = []
    emitted = stored = traced = 0
    while len(aim.choice) and aim.choice[-1] > 0 and stored < wanted and emitted < bound:
        share = stored / emitted if stored else 1.0
        count = min(int((wanted - stored) / share * 1.02) + 1, bound - emitted, 4 * emitted or bound)
        for photons, rays in _run_round(context, aim, emitted, count):
            parts.append(photons)
            stored += int((photons.is_shadow == 0).sum())
            traced += rays
        emitted += count
    photons = _join(parts)
    if stored >= wanted:
        emitted = int(photons.number[photons.is_shadow == 0][wanted - 1]) + 1
        photons = LightPhotons(*rows(photons, photons.number < emitted))
    return photons, emitted, traced


def aim_from_areas(context: Context) -> Aim:
    """All directions of the lights that are tested, by power."""
    aim = aim_everywhere(context.tables)
    chance = np.diff(aim.choice, prepend=0.0) * np.isin(context.tables.light_kind, TESTED_LIGHTS)
    choice = np.cumsum(chance)
    return aim._replace(choice=choice / choice[-1] if len(choice) and choice[-1] > 0 else choice)


def _run_round(context: Context, aim: Aim, first_number: int, count: int) -> Iterator[tuple[LightPhotons, int]]:
    """Run `count` rays from number `first_number` on through the scene: (photons, rays traced) a chunk."""

    def chunk(first: int, last: int) -> tuple[LightPhotons, int]:
        return _run_through(context, aim, first_number + first, last - first)

    return context.pool.map_chunks(chunk, count, 2)


def _run_through(context: Context, aim: Aim, first_number: int, count: int) -> tuple[LightPhotons, int]:
    """Photons on all surfaces that rays number first_number ... meet, in order of emission, and the rays traced."""
    rays = Rays.empty(count)
    family = np.uint64(path_key(context.settings.seed, EMISSION_STREAM, THROUGH))
    emit_photons(context.tables, aim, context.sobol, family, first_number, rays)
    parts: list[LightPhotons] = []
    traced = 0
    for depth in range(MOST_SURFACES):
        count = len(rays.owner)
        if count == 0:
            break
        hits = context.intersector.closest(rays.origin, rays.direction)
        traced += count
        stored, following = LightPhotons.empty(count), Rays.empty(count)
        stored_count, ray_count = drop_photons(context.tables, depth, rays, hits, stored, following)
        parts.append(LightPhotons(*rows(stored, slice(0, stored_count))))
        rays = Rays(*rows(following, slice(0, ray_count)))
    photons = _join(parts)
    return LightPhotons(*rows(photons, np.argsort(photons.number, kind="stable"))), traced


def _look_back(context: Context, photons: LightPhotons, first: int, last: int) -> tuple[U1, int]:
    """What photons [first, last) see of their lights' borders, LIT, HIDDEN or UNKNOWN, and the rays traced."""
    room = (last - first) * BORDER_RAYS
    origin, direction = np.empty((2, room, 3), np.float32)
    limit, owner = np.empty(room, np.float32), np.empty(room, np.int64)
    count = border_rays(
        context.tables, context.settings.seed, photons, first, last, origin, direction, limit, owner
    )
    blocked = context.intersector.occluded(origin[:count], direction[:count], limit[:count])
    asked = np.bincount(owner[:count], minlength=last - first)
    hidden = np.bincount(owner[:count], weights=blocked, minlength=last - first)
    is_shadow = photons.is_shadow[first:last] == 1
    verdict = np.full(last - first, UNKNOWN, np.uint8)
    verdict[~is_shadow & (hidden == 0)] = LIT
    verdict[is_shadow & (hidden == asked)] = HIDDEN
    return verdict, count


def decide_cells(photons: LightPhotons, verdict: U1, lights: int) -> ShadowCells:
    """Cells around which photons agree, for each of `lights` lights; verdict (N,) is what each photon sees."""
    corner, per_m = np.zeros((lights, 3)), np.zeros(lights)
    decided: list[tuple[U8, U1]] = []
    for light in range(lights):
        own = photons.light == light
        position, seen = photons.position[own].astype(np.float64), verdict[own]
        side = cell_side(position)
        decided.append((np.zeros(0, np.uint64), np.zeros(0, np.uint8)))
        if side > 0.0:
            # Neither the boundary of a cell nor the first cell lies where a wall is likely to.
            corner[light], per_m[light] = position.min(axis=0) - 1.382 * side, 1.0 / side
            decided[-1] = _agreed(np.floor((position - corner[light]) * per_m[light]).astype(np.int64), seen)
    slots = [1 << int(2 * len(key)).bit_length() if len(key) else 0 for key, _ in decided]
    first = np.concatenate([[0], np.cumsum(slots)]).astype(np.int64)
    cells = ShadowCells(corner, per_m, first, np.full(first[-1], EMPTY), np.zeros(first[-1], np.uint8))
    for light, (key, answer) in enumerate(decided):
        fill_cells(key, answer, first[light], first[light + 1], cells)
    return cells


def cell_side(position: F8) -> float:
    """Side of a cell that holds CELL_PHOTONS at the photons' median density on surfaces [m]; 0 for too few photons."""
    if len(position) < LEAST_PHOTONS:
        return 0.0
    probes = position[:: max(1, len(position) // DENSITY_PROBES)]
    distance, _ = cKDTree(position).query(probes, k=[DENSITY_NEIGHBOURS + 1])
    area = np.pi * float(np.median(distance)) ** 2 / DENSITY_NEIGHBOURS
    return max(float(np.sqrt(CELL_PHOTONS * area)), float(np.ptp(position, axis=0).max()) / (CELLS - 4))


def _agreed(cell: I8, verdict: U1) -> tuple[U8, U1]:
    """Keys and verdicts of the cells in which, and in whose neighbours, photons agree; cell (N, 3) of each photon."""
    step = np.array([1 << 2 * CELL_BITS, 1 << CELL_BITS, 1], np.int64)
    key, row = np.unique(cell @ step, return_inverse=True)
    counts = np.stack([np.bincount(row, verdict == kind, len(key)) for kind in (UNKNOWN, LIT, HIDDEN)], axis=1)
    around = np.zeros_like(counts)
    for offset in np.ndindex(3, 3, 3):
        neighbour = key + (np.array(offset) - 1) @ step
        place = np.minimum(np.searchsorted(key, neighbour), len(key) - 1)
        around += counts[place] * (key[place] == neighbour)[:, None]
    total = around.sum(axis=1)
    agreed = np.zeros(len(key), np.uint8)
    for kind in (LIT, HIDDEN):
        agreed[(around[:, kind] == total) & (total >= LEAST_PHOTONS)] = kind
    known = agreed != UNKNOWN
    return key[known].astype(np.uint64), agreed[known]


def _join(parts: list[LightPhotons]) -> LightPhotons:
    if not parts:
        return LightPhotons.empty(0)
    return LightPhotons(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
