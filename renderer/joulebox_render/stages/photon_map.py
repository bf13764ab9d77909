"""Photon maps: photons are emitted from the lights, scattered and stored, and put into kd-trees."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from joulebox_render.kernels.emission import emit_photons
from joulebox_render.kernels.kdtree import LEAF, build_tree
from joulebox_render.kernels.photons import scatter
from joulebox_render.kernels.rng import path_key
from joulebox_render.pool import WorkerPool
from joulebox_render.records import F4, I1, I4, U1, Aim, Photons, Rays, Scratch, Tree, rows
from joulebox_render.stages.aim import aim_at_specular, aim_everywhere
from joulebox_render.stages.context import Context

EMISSION_STREAM = 2
EVERYWHERE, AIMED = 0, 1
FIRST_HIT, CAUSTIC, BOUNCED = 0, 1, 2
ALL_HISTORIES: U1 = np.ones(3, np.uint8)
# After so many surfaces few photons of a chunk are left: those of all chunks go on together, or they would cost more by
# the call than by the photon.
LEAD = 8
# Levels of a tree that are grown one after another, so that threads share the work.
SHARED_LEVELS = 4
# A map that is not full after this many emissions for each photon it should hold stays as it is.
EMITTED_PER_STORED = 50


class Flight(NamedTuple):
    """Photons under way: rays, and history (N,) u1 as it is stored with them."""

    rays: Rays
    history: U1


@dataclass(frozen=True)
class PhotonMap:
    """Photons in a kd-tree.

    tree; flux (N, 3) f4 [W], divided by `emitted`, wi (N, 3) f4, history (N,) u1 and rank (N,) i4 in the order of
    storing, all in the tree's order.
    complete is False when emission ended before the map held what was asked for.
    """

    tree: Tree
    flux: F4
    wi: F4
    history: U1
    rank: I4
    stored: int
    emitted: int
    complete: bool


@dataclass(frozen=True)
class Emission:
    """Stored photons of each map, None where the plan needs no such map, and how many were emitted."""

    global_photons: Photons | None
    global_emitted: int
    caustic_photons: Photons | None
    caustic_emitted: int


class _Collector:
    """Takes photons of some histories, in the order of emission, until it holds `wanted`.

    Emissions beyond its own bound, made for another map's sake, do not count for it.
    """

    def __init__(self, wanted: int, histories: tuple[int, ...]) -> None:
        self.wanted = wanted
        self._bound = EMITTED_PER_STORED * wanted
        self.parts: list[Photons] = []
        self.stored = 0
        self.emitted = 0
        self.histories = np.isin(np.arange(3), histories).astype(np.uint8)

    @property
    def full(self) -> bool:
        return self.stored >= self.wanted

    def take(self, photons: Photons, emitted: int) -> None:
        """Add one chunk; `emitted` counts all photons emitted up to its end."""
        if self.full:
            return
        chosen = np.flatnonzero(self.histories[photons.history] & (photons.number < self._bound))
        chosen = chosen[: self.wanted - self.stored]
        self.parts.append(photons if len(chosen) == len(photons.number) else Photons(*rows(photons, chosen)))
        self.stored += len(chosen)
        # A full map's last photon tells how many emissions filled it.
        self.emitted = int(photons.number[chosen[-1]]) + 1 if self.full else min(emitted, self._bound)

    def photons(self, pool: WorkerPool) -> Photons:
        """All that it holds."""
        return pool.join(self.parts) if self.parts else Photons.empty(0)

    def needs(self, emitted: int) -> int:
        """Emissions still needed at the yield so far, 0 once full or out of tries."""
        if self.full:
            return 0
        share = self.stored / self.emitted if self.stored else 1.0
        needed = int((self.wanted - self.stored) / share * 1.02) + 1
        return max(0, min(needed, self._bound - emitted))


def emit_and_store(context: Context) -> Emission:
    """Photons for the global and the caustic map.

    Each map takes the photons of one shared emission until it is full, so that neither depends on the other. With
    caustic hints the caustic map has an emission of its own, aimed at what can cast caustics.
    """
    settings, plan = context.settings, context.plan
    everywhere = aim_everywhere(context.tables)
    shared: list[_Collector] = []
    of_global = of_caustic = None
    if plan.global_map:
        of_global = _Collector(settings.global_photons, global_histories(context))
        shared.append(of_global)
    if plan.caustic_map:
        of_caustic = _Collector(settings.caustic_photons, (CAUSTIC,))
        if settings.caustic_hints:
            _fill(context, aim_at_specular(context.tables), AIMED, [of_caustic])
        else:
            shared.append(of_caustic)
    _fill(context, everywhere, EVERYWHERE, shared)
    return Emission(
        of_global.photons(context.pool) if of_global else None, of_global.emitted if of_global else 0,
        of_caustic.photons(context.pool) if of_caustic else None, of_caustic.emitted if of_caustic else 0,
    )  # fmt: skip


def _fill(context: Context, aim: Aim, emission: int, collectors: list[_Collector]) -> None:
    """Emit until every collector is full or out of tries."""
    emitted = 0
    lit = len(aim.choice) > 0 and float(aim.choice[-1]) > 0.0
    family = np.uint64(path_key(context.settings.seed, EMISSION_STREAM, emission))
    while lit and collectors and (needed := max(collector.needs(emitted) for collector in collectors)) > 0:
        wanted = np.bitwise_or.reduce([each.histories for each in collectors if each.needs(emitted)])
        count = needed if emitted == 0 else min(needed, 4 * emitted)
        for photons, chunk_end in _trace_round(context, aim, family, emitted, count, wanted):
            for collector in collectors:
                collector.take(photons, chunk_end)
        emitted += count


def global_histories(context: Context) -> tuple[int, ...]:
    """Which photons the global map holds.

    Final gathering looks the map up where gather rays end, and needs all light there; where irradiance is
    precomputed, light straight from the lights is sampled once at every record. Direct visualisation shows the map
    at first sight: light straight from the lights is sampled instead, and caustics have their own map.
    """
    if context.settings.indirect == "final_gather":
        return (CAUSTIC, BOUNCED) if context.plan.precomputed_irradiance else (FIRST_HIT, CAUSTIC, BOUNCED)
    return (BOUNCED,) if context.plan.caustic_map else (CAUSTIC, BOUNCED)


def build_photon_map(photons: Photons, emitted: int, wanted: int, pool: WorkerPool | None = None) -> PhotonMap:
    """Put photons into a kd-tree and scale their flux by the number emitted."""
    tree, order = grow_tree(photons.position, photons.normal, pool)
    flux, wi, history = in_order(pool, order, photons.flux, photons.wi, photons.history)
    flux /= np.float32(max(1, emitted))
    return PhotonMap(tree, flux, wi, history, order, len(photons.number), emitted, len(photons.number) >= wanted)


def grow_tree(position: F4, normal: F4, pool: WorkerPool | None = None) -> tuple[Tree, np.ndarray]:
    """A kd-tree over points and the order (N,) that its arrays list them in; subtrees grow on the pool's threads."""
    count = len(position)
    order = np.arange(count, dtype=np.int32)
    depth = 0
    while (count + (1 << depth) - 1) >> depth > LEAF:
        depth += 1
    nodes = (2 << depth) - 1
    axis = np.full(nodes, -1, np.int8)
    plane = np.zeros(nodes, np.float32)
    columns = np.ascontiguousarray(position.T)
    # Level by level while there are few subtrees, then each to its leaves.
    spans, shared = [(0, count)] if count else [], min(depth, SHARED_LEVELS)
    for level in range(shared + 1):
        _grow_level(pool, columns, order, axis, plane, spans, depth if level == shared else 1)
        spans = [half for low, high in spans for half in ((low, (low + high) // 2), ((low + high) // 2, high))]
    ordered_position, ordered_normal = in_order(pool, order, position, normal)
    return Tree(ordered_position, ordered_normal, axis, plane), order


def in_order(pool: WorkerPool | None, order: npt.NDArray[np.integer], *columns: np.ndarray) -> list[np.ndarray]:
    """Rows `order` (M,) of columns (N, ...)."""
    ordered = [np.empty((len(order), *column.shape[1:]), column.dtype) for column in columns]

    def take(first: int, last: int) -> None:
        for column, result in zip(columns, ordered, strict=True):
            # Raising on a wrong row, numpy's other way, would copy once more.
            np.take(column, order[first:last], axis=0, out=result[first:last], mode="clip")

    if pool is None:
        take(0, len(order))
    else:
        pool.map_chunks(take, len(order), 1)
    return ordered


def _grow_level(
    pool: WorkerPool | None, columns: F4, order: I4, axis: I1, plane: F4, spans: list[tuple[int, int]], levels: int
) -> None:
    """Grow `levels` levels of the subtrees over `spans` of the order, which are all nodes of one level."""

    def grow(first: int, last: int) -> None:
        for i in range(first, last):
            build_tree(columns, order, axis, plane, len(spans) - 1 + i, *spans[i], levels, Scratch.empty(1))

    if pool is None:
        grow(0, len(spans))
    else:
        pool.map_chunks(grow, len(spans), pool.chunk_rays)


def _trace_round(
    context: Context, aim: Aim, family: np.uint64, first_number: int, count: int, wanted: U1
) -> list[tuple[Photons, int]]:
    """Emit `count` photons from number `first_number` on: (photons, emitted up to the chunk's end) a chunk."""
    pool, bounces = context.pool, context.settings.max_photon_bounces + 1

    def lead(first: int, last: int) -> tuple[int, list[Photons], Flight]:
        flight = emit(context, aim, family, first_number + first, last - first)
        return first_number + last, *follow(context, flight, wanted, min(LEAD, bounces))

    ends, parts, flights = zip(*pool.map_chunks(lead, count, 1), strict=True)
    rays, history = pool.join([left.rays for left in flights]), np.concatenate([left.history for left in flights])

    def go_on(first: int, last: int) -> list[Photons]:
        flight = Flight(Rays(*rows(rays, slice(first, last))), history[first:last])
        return follow(context, flight, wanted, bounces - LEAD)[0]

    late = in_order_of_emission(itertools.chain(*pool.map_chunks(go_on, len(history), 1)), first_number, count)
    begins = (first_number, *ends[:-1])

    def put_in_order(first: int, last: int) -> list[tuple[Photons, int]]:
        ordered = []
        for i in range(first, last):
            own = slice(*np.searchsorted(late.number, (begins[i], ends[i])))
            all_parts = (*parts[i], Photons(*rows(late, own)))
            ordered.append((in_order_of_emission(all_parts, begins[i], ends[i] - begins[i]), ends[i]))
        return ordered

    return list(itertools.chain(*pool.map_chunks(put_in_order, len(ends), pool.chunk_rays)))


def trace_photons(
    context: Context, aim: Aim, family: np.uint64, first_number: int, count: int, wanted: U1 = ALL_HISTORIES
) -> Photons:
    """Follow photons number first_number ... until they are absorbed or gone; stored ones in order of emission.

    wanted (3,) u1 tells which histories are stored; what can no longer have one of them is not followed.
    """
    flight = emit(context, aim, family, first_number, count)
    parts, _ = follow(context, flight, wanted, context.settings.max_photon_bounces + 1)
    return in_order_of_emission(parts, first_number, count)


def emit(context: Context, aim: Aim, family: np.uint64, first_number: int, count: int) -> Flight:
    """Photons number first_number ... as they leave the lights."""
    rays = Rays.empty(count)
    emit_photons(context.tables, aim, context.sobol, family, first_number, rays)
    return Flight(rays, np.zeros(count, np.uint8))


def follow(context: Context, flight: Flight, wanted: U1, surfaces: int) -> tuple[list[Photons], Flight]:
    """Follow photons over as many surfaces: what is stored at each, and those that go on from the last."""
    rays, history = flight
    parts: list[Photons] = []
    for _ in range(surfaces):
        going = len(rays.owner)
        if going == 0:
            break
        hits = context.intersector.closest(rays.origin, rays.direction)
        stored, following, following_history = Photons.empty(going), Rays.empty(going), np.empty(going, np.uint8)
        stored_count, ray_count = scatter(
            context.tables, context.settings.store_at_every_bounce, context.sobol, wanted, rays, history, hits,
            stored, following, following_history,
        )  # fmt: skip
        parts.append(Photons(*rows(stored, slice(0, stored_count))))
        rays = Rays(*rows(following, slice(0, ray_count)))
        history = following_history[:ray_count]
    return parts, Flight(rays, history)


def in_order_of_emission(parts: Iterable[Photons], first_number: int, count: int) -> Photons:
    """Photons of `count` emissions from number `first_number` on, each one's in the order of parts."""
    photons = Photons(*map(np.concatenate, zip(Photons.empty(0), *parts, strict=True)))
    # In as few bits as will do: numpy sorts 16 and fewer in linear time.
    number = (photons.number - first_number).astype(np.min_scalar_type(count))
    order = np.argsort(number, kind="stable")
    return Photons(*rows(photons, order))
