"""Direct and shadow photons: where a light is surely seen or surely hidden, so that no shadow ray need ask.

Rays leave the area lights as photons do. Where one first hits lies a direct photon; it then runs on through the scene
and leaves a shadow photon on every further surface that faces it (Jensen & Christensen 1995, "Efficient rendering
with shadow photons"). From where it lies each photon then looks at the border of every light, because that is what a
penumbra loses first: where it sees all of it, the light is seen; where it sees none, hidden; else the photon lies in a
penumbra. Of the light it came from, a direct photon never says hidden and a shadow photon never seen. Space is cut
into cells, and a cell is decided where enough photons lie in it and the 26 around it and all agree.

Point and spot lights cost one ray, which there is nothing to save on; the sky is in part hidden almost everywhere.
Neither has photons here, and both are asked with rays. What is smaller than the distance between photons can be
missed with its shadow: the error is measured, not bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.emission import emit_photons
from joulebox_render.kernels.rng import path_key
from joulebox_render.kernels.shadow_photons import (
    ABSTAINS,
    BORDER_RAYS,
    CELL_BITS,
    CELLS,
    EMPTY,
    HIDDEN,
    LIT,
    UNKNOWN,
    border_rays,
    drop_photons,
    fill_slots,
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
CELL_PHOTONS, LEAST_PHOTONS = 5.0, 8
# The density of photons is measured by the distance to this neighbour, at about so many of them.
DENSITY_NEIGHBOURS, DENSITY_PROBES = 12, 500
# What makes a key of a cell's three numbers.
STEP = np.array([1 << 2 * CELL_BITS, 1 << CELL_BITS, 1], np.int64)


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
        return cls(position, normal, np.empty(count, np.int32), np.empty(count, np.uint8), np.empty(count, np.int64))


class ShadowCells(NamedTuple):
    """Cells in which lights are surely seen or hidden, found by hashing.

    corner (3,) f8 [m], per_m (1,) f8 [1/m]: a point lies in cell floor((point - corner) per_m); key (S,) u8 of the
    cell in each slot and its number, cell (S,) i4; verdict (L, C + 1) u1: LIT, HIDDEN or UNKNOWN of each light in each
    cell, and UNKNOWN where there is none, -1.
    """

    corner: F8
    per_m: F8
    key: U8
    cell: I4
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
    """Emit direct and shadow photons, let them look at the lights, and decide cells."""
    photons, emitted, traced = emit_through(context)
    count, lights = len(photons.number), context.tables.light_kind
    vote: U1 = np.full((len(lights), count), ABSTAINS, np.uint8)
    for light in np.flatnonzero(np.isin(lights, TESTED_LIGHTS)):

        def chunk(first: int, last: int, light: int = int(light)) -> int:
            return _look_back(context, light, photons, first, last, vote[light, first:last])

        traced += sum(context.pool.map_chunks(chunk, count, BORDER_RAYS))
    direct = int((photons.is_shadow == 0).sum())
    complete = direct >= context.settings.direct_photons
    return ShadowMap(decide_cells(photons.position, vote), direct, count - direct, emitted, complete, traced)


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


def _run_round(context: Context, aim: Aim, first_number: int, count: int) -> list[tuple[LightPhotons, int]]:
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


def _look_back(context: Context, light: int, photons: LightPhotons, first: int, last: int, vote: U1) -> int:
    """What photons [first, last) see of a light's border, into vote (last - first,); returns the rays traced."""
    room = (last - first) * BORDER_RAYS
    origin, direction = np.empty((2, room, 3), np.float32)
    limit, owner = np.empty(room, np.float32), np.empty(room, np.int64)
    count = border_rays(
        context.tables, context.settings.seed, light, photons, first, last, origin, direction, limit, owner
    )
    blocked = context.intersector.occluded(origin[:count], direction[:count], limit[:count])
    asked = np.bincount(owner[:count], minlength=last - first)
    hidden = np.bincount(owner[:count], weights=blocked, minlength=last - first)
    own, is_shadow = photons.light[first:last] == light, photons.is_shadow[first:last] == 1
    vote[:] = UNKNOWN
    vote[(hidden == asked) & ~(own & ~is_shadow)] = HIDDEN
    vote[(hidden == 0) & ~(own & is_shadow)] = LIT
    vote[(asked == 0) & ~own] = ABSTAINS
    return int(count)


def decide_cells(position: F4, vote: U1) -> ShadowCells:
    """Cells around which photons at position (N, 3) agree in vote (L, N) on one light or more."""
    side = cell_side(position)
    # Neither the boundary of a cell nor the first cell lies where a wall is likely to.
    corner = position.min(axis=0).astype(np.float64) - 1.382 * side if side > 0.0 else np.zeros(3)
    cell = np.floor((position - corner) / (side or 1.0)).astype(np.int64)[: len(position) if side > 0.0 else 0]
    key, row = np.unique(cell @ STEP, return_inverse=True)
    neighbours = _neighbours(key)
    verdict = np.zeros((len(vote), len(key)), np.uint8)
    for light, votes in enumerate(vote):
        verdict[light] = _agreed(neighbours, row, len(key), votes[: len(cell)])
    known = (verdict != UNKNOWN).any(axis=0)
    slots = 1 << int(2 * known.sum()).bit_length()
    cells = ShadowCells(
        corner, np.array([1.0 / (side or 1.0)]), np.full(slots, EMPTY), np.zeros(slots, np.int32),
        np.ascontiguousarray(np.pad(verdict[:, known], ((0, 0), (0, 1)))),
    )  # fmt: skip
    fill_slots(key[known].astype(np.uint64), cells)
    return cells


def cell_side(position: F4) -> float:
    """Side of a cell that holds CELL_PHOTONS at the photons' median density on surfaces [m]; 0 for too few photons."""
    if len(position) < LEAST_PHOTONS:
        return 0.0
    probes = position[:: max(1, len(position) // DENSITY_PROBES)]
    # Imported where there are shadow photons: it would take a sixth of the time in which a renderer starts.
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(position).query(probes, k=[min(DENSITY_NEIGHBOURS, len(position) - 1) + 1])
    area = np.pi * float(np.median(distance)) ** 2 / DENSITY_NEIGHBOURS
    return max(float(np.sqrt(CELL_PHOTONS * area)), float(np.ptp(position, axis=0).max()) / (CELLS - 4))


def _neighbours(key: I8) -> list[tuple[I8, I8]]:
    """For each of 27 offsets, itself among them, the rows of cells with a neighbour there, and its rows."""
    pairs = []
    for offset in np.ndindex(3, 3, 3) if len(key) else ():
        wanted = key + (np.array(offset) - 1) @ STEP
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        here = np.flatnonzero(key[place] == wanted)
        pairs.append((here, place[here]))
    return pairs


def _agreed(neighbours: list[tuple[I8, I8]], row: I8, cells: int, votes: U1) -> U1:
    """LIT or HIDDEN where enough votes (N,) by photons in cells `row` (N,) and around agree, else UNKNOWN."""
    counts = np.stack([np.bincount(row, votes == kind, cells) for kind in (UNKNOWN, LIT, HIDDEN)], axis=1)
    around = np.zeros_like(counts)
    for here, there in neighbours:
        around[here] += counts[there]
    total = around.sum(axis=1)
    verdict = np.full(cells, UNKNOWN, np.uint8)
    for kind in (LIT, HIDDEN):
        verdict[(around[:, kind] == total) & (total >= LEAST_PHOTONS)] = kind
    return verdict


def _join(parts: list[LightPhotons]) -> LightPhotons:
    if not parts:
        return LightPhotons.empty(0)
    return LightPhotons(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
