"""Irradiance computed ahead at some photons' places (Christensen 1999), and what gather rays ask where they end.

Light straight from the lights is sampled at each record; what bounced is estimated from photons. A table over cells of
place and normal answers nearly all look-ups, and knows where its answer is not to be trusted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from joulebox_render.kernels.lookup import (
    ALWAYS,
    CELLS_A_SIDE,
    FEELERS,
    FROM_AFAR,
    LATTICE,
    NEVER,
    NO_CELL,
    OUTSIDE,
    aim_feelers,
    answer_rays,
    enter_cells,
    look_up_irradiance,
    mark_cells,
    nearest_records,
)
from joulebox_render.kernels.rng import path_key
from joulebox_render.pool import WorkerPool
from joulebox_render.records import F4, F8, I4, I8, U1, U8, Estimates, Hits, Points, Rays, Scratch, Tree, rows
from joulebox_render.stages.context import Context
from joulebox_render.stages.density import (
    FEW_WITNESSES_STEP,
    RAYS_PER_ESTIMATE,
    DensityEstimate,
    global_estimate,
    probe_keys,
    share_in_sight,
)
from joulebox_render.stages.direct import sample_lights
from joulebox_render.stages.photon_map import PhotonMap, grow_tree, in_order

RAYS_PER_LOOK_UP = 2
# Direct light is sampled where irradiance is precomputed: exact at shadows' edges and corners, and without noise, where
# photons straight from the lights would blur it. So few rays do, as each gather averages over many records.
RECORD_SHADOW_RAYS = 4
RECORD_STREAM = 3
# Cells by which a table reaches beyond the records on every side, and to which it is filled around each at most.
MARGIN = 16
# Of the photon map's resolution: no ray longer than this is a short one (kernels.gathering.short_ray).
SURELY_LONG = 1.5
# Records whose cells are remembered while others mark theirs; in the order of their tree most are marked again soon.
RECENT_RECORDS = 128
# How far above the surface feelers run, in cells: a wall's foot is felt, a curve of the surface is not.
FEELER_LIFT = 0.05


class IrradianceTable(NamedTuple):
    """Irradiance in cells of place and normal, a hash table.

    low (3,) f8, the cells' common corner [m]; cells_per_m, of a side; key (S,) u8, S a power of two, at most half of
    them cells (kernels.lookup.cell_key), the others NO_CELL; light (S, 4) f4, irradiance [W m^-2] and trust, together
    because they are read together. Trust is 1, or 0 where something stands within a cell's length or between it and
    its record (a thin wall, a corner, a contact), the record is doubtful, or there is none in reach. It must not hang
    on how many photons an estimate found: believing the lucky ones alone would make faint places too bright.
    """

    low: F8
    cells_per_m: float
    key: U8
    light: F4


class MarkedCells(NamedTuple):
    """Cells that records mark: key (M,) u8, position [m] and normal (M, 3) f4 of the place that stands for each."""

    key: U8
    position: F4
    normal: F4

    @classmethod
    def empty(cls, count: int) -> MarkedCells:
        """Room for `count` cells."""
        position, normal = np.empty((2, count, 3), np.float32)
        return cls(np.empty(count, np.uint64), position, normal)


class IrradianceRecords(NamedTuple):
    """Irradiance computed ahead at some photons' positions: tree, irradiance (R, 3) f4 in its order [W m^-2].

    doubtful (R,) u1 marks those with photons behind a wall. reach_m is how far a look-up may go: records of every nth
    photon lie sqrt(n) times as far apart as photons. table answers nearly all look-ups. others is the estimate that the
    records were made with, of the photons that are none; None where all are.
    """

    tree: Tree
    irradiance: F4
    doubtful: U1
    reach_m: float
    table: IrradianceTable
    others: DensityEstimate | None = None


@dataclass(frozen=True)
class Illumination:
    """What a gather ray asks where it ends.

    resolution_m is the distance below which the photon map cannot tell places apart [m].
    """

    estimate: DensityEstimate
    records: IrradianceRecords | None
    caustics: DensityEstimate | None

    @property
    def resolution_m(self) -> float:
        return self.estimate.reach_m

    @property
    def has_table(self) -> bool:
        return self.records is not None and len(self.records.table.key) > 1

    def answer(self, context: Context, rays: Rays, hits: Hits, radiance: F8) -> tuple[Points, I4]:
        """Add what rays (N) bring from where the table may be trusted, to radiance (owners, 3) f8.

        Returns the diffuse points where it may not, and the rows of rays that end at other surfaces.
        """
        assert self.records is not None
        near, rest = Points.empty(len(rays.owner)), np.empty(len(rays.owner), np.int32)
        near_count, rest_count = answer_rays(
            context.tables, self.records.table, self.resolution_m, rays, hits, radiance, near, rest
        )
        return Points(*rows(near, slice(0, near_count))), rest[:rest_count]

    def look_up(self, points: Points) -> tuple[F4, U1]:
        """Irradiance (N, 3) f4 that the records know, or a density estimate where none are kept; and where it cannot
        be relied on, unsure (N,) u1.
        """
        count = len(points.owner)
        if self.records is None:
            estimates = self.estimate(points.position, points.normal, probe_keys(points))
            few = np.ascontiguousarray(estimates.witness[:, ::FEW_WITNESSES_STEP])
            share = share_in_sight(self.estimate.context, self.estimate.photons, points.position, points.normal, few)
            return estimates.irradiance, (share < 1).view(np.uint8)
        irradiance, unsure = np.empty((count, 3), np.float32), np.empty(count, np.uint8)
        look_up_irradiance(
            self.records.table, self.records.tree, self.records.irradiance, self.records.doubtful,
            points.position, points.normal, self.records.reach_m, self.estimate.cos_limit, Scratch.empty(1),
            irradiance, unsure,
        )  # fmt: skip
        if self.records.others is not None:
            apart = np.flatnonzero((unsure == OUTSIDE) & (points.distance > SURELY_LONG * self.resolution_m))
            if len(apart):
                irradiance[apart], unsure[apart] = estimate_apart(self.records.others, Points(*rows(points, apart)))
        return irradiance, unsure


def estimate_apart(others: DensityEstimate, points: Points) -> tuple[F4, U1]:
    """Irradiance (N, 3) f4 at points that lie apart from all records, and whether something hides photons, (N,) u1.

    In dim rooms records are too few for cells to meet. There `others`, who do not know where the records are, are asked
    at each point: all photons would say too little, for where no record is those of the records are missing.
    """
    context, count = others.context, len(points.owner)
    assert context is not None
    estimates = others(points.position, points.normal, probe_keys(points))
    few = np.ascontiguousarray(estimates.witness[:, ::FEW_WITNESSES_STEP])
    share = share_in_sight(context, others.photons, points.position, points.normal, few)
    sampled = sample_lights(context, points._replace(albedo=np.full_like(points.albedo, math.pi)), 0, count, 1)
    return estimates.irradiance + sampled.astype(np.float32), (share < 1).view(np.uint8)


def precompute_irradiance(context: Context, photons: PhotonMap) -> IrradianceRecords:
    """Irradiance at every nth photon of the global map, n = photon_spacing (Christensen 1999)."""
    step = context.settings.photon_spacing
    # By the order of storing: which photons lie first in the tree hangs on roundings of their places.
    chosen = photons.rank % step == 0
    taken = np.flatnonzero(chosen)
    position, normal = in_order(context.pool, taken, photons.tree.position, photons.tree.normal)
    number = photons.rank[taken].astype(np.int64)
    estimate = other_photons(context, photons, chosen)
    doubtful = np.empty(len(position), np.uint8)

    def chunk(first: int, last: int) -> Estimates:
        here, facing = position[first:last], normal[first:last]
        estimates = estimate(here, facing, number[first:last].astype(np.uint64))
        doubtful[first:last] = share_in_sight(context, estimate.photons, here, facing, estimates.witness) < 1
        sampled = direct_irradiance(context, number[first:last], here, facing)
        return estimates._replace(irradiance=estimates.irradiance + sampled)

    parts = context.pool.map_chunks(chunk, len(position), RAYS_PER_ESTIMATE)
    estimates = Estimates(*map(np.concatenate, zip(*parts, strict=True))) if parts else Estimates.empty(0)
    tree, order = grow_tree(position, normal, context.pool)
    irradiance, in_doubt = in_order(context.pool, order, estimates.irradiance, doubtful)
    records = IrradianceRecords(
        tree, irradiance, in_doubt, estimate.reach_m * math.sqrt(step), empty_table(), estimate if step > 1 else None
    )
    if not len(position):
        return records
    radius, count = float(np.median(estimates.radius)), max(1.0, float(np.median(estimates.found)))
    spacing = radius * math.sqrt(math.pi * max(1, step - 1) / count)
    lift = float(context.tables.epsilon[0])
    # Estimates hardly change over half the radius of their discs.
    table = tabulate(context, records, estimate.cos_limit, 0.5 * radius, 1.5 * spacing, lift)
    return records._replace(table=table)


def other_photons(context: Context, photons: PhotonMap, chosen: npt.NDArray[np.bool_]) -> DensityEstimate:
    """The estimate in the global map without the photons `chosen` for records, whose share the others carry.

    A look-up takes the nearest record, so around the place that asks there is none nearer: the records' own photons
    are missing there, and one lies in the middle of the estimate. Of the others nothing is known. Where all photons
    are records the two errors cancel, as long as the disc holds what is empty.
    """
    estimate = global_estimate(context, photons)
    step = context.settings.photon_spacing
    if step == 1:
        return estimate
    others = np.flatnonzero(~chosen)
    position, normal = in_order(context.pool, others, photons.tree.position, photons.tree.normal)
    tree, order = grow_tree(position, normal, context.pool)
    flux, wi, history, rank = in_order(
        context.pool, others[order], photons.flux, photons.wi, photons.history, photons.rank
    )
    flux *= np.float32(step / (step - 1))
    rest = replace(photons, tree=tree, flux=flux, wi=wi, history=history, rank=rank, stored=len(flux))
    return replace(estimate, photons=rest, count=max(2, round(estimate.count * (step - 1) / step)))


def direct_irradiance(context: Context, number: I8, position: F4, normal: F4) -> F4:
    """Irradiance (N, 3) f4 straight from the lights at records, by RECORD_SHADOW_RAYS to each [W m^-2].

    number (N,) names each record's samples; like which photons are records, it must not hang on the tree's order.
    """
    count = len(position)
    points = Points.empty(count)
    points.position[:] = position + context.tables.epsilon[0] * normal
    points.normal[:] = points.geometric[:] = normal
    points.albedo[:] = math.pi
    points.key[:] = path_key(context.settings.seed, RECORD_STREAM, 0)
    points.sample[:] = number
    irradiance = sample_lights(context, points, 0, count, RECORD_SHADOW_RAYS)
    return irradiance.astype(np.float32)


def empty_table() -> IrradianceTable:
    """A table without cells, which leaves every look-up to the records."""
    return IrradianceTable(np.zeros(3), 1.0, np.full(1, NO_CELL), np.zeros((1, 4), np.float32))


def tabulate(
    context: Context, records: IrradianceRecords, cos_limit: float, edge_m: float, fill_m: float, lift_m: float
) -> IrradianceTable:
    """The look-up of the nearest record, done ahead for cells of side `edge_m` up to about `fill_m` around records.

    Filling to 1.5 times the records' spacing leaves few gaps. `lift_m` is how far above the surface points lie that
    will be looked up. A scene too large for the cells' numbers, half a million a side, gets a table without cells.
    """
    tree, irradiance = records.tree, records.irradiance
    # Along rows of three numpy is twenty times as slow.
    columns = np.ascontiguousarray(tree.position.T)
    low, high = columns.min(axis=1).astype(np.float64), columns.max(axis=1)
    if edge_m <= 0 or (high - low).max() > edge_m * (CELLS_A_SIDE - 2 * MARGIN):
        return empty_table()
    steps = min(MARGIN, math.ceil(fill_m / (LATTICE * edge_m)))
    # No multiple of an edge, so that walls that bound the scene do not lie between cells.
    corner = low - (MARGIN - 0.382) * edge_m
    table = empty_table()._replace(low=corner, cells_per_m=1 / edge_m)
    marked = mark_around(context.pool, tree, table, lift_m, steps)
    size = 1 << math.ceil(math.log2(2 + 1.5 * len(irradiance) * min(1.0, fill_m / edge_m) ** 2))
    cells = -1
    while cells < 0:
        size *= 2
        table = table._replace(key=np.full(size, NO_CELL), light=np.empty((size, 4), np.float32))
        slots, first_mention = np.empty((2, size // 2), np.int64)
        cells = enter_cells(table.key, marked.key, slots, first_mention)

    def chunk(first: int, last: int) -> None:
        mention, slot = first_mention[first:last], slots[first:last]
        place, facing = marked.position[mention], marked.normal[mention]
        row = np.empty(last - first, np.int32)
        nearest_records(tree, place, facing, records.reach_m, cos_limit, Scratch.empty(1), row)
        table.light[slot, :3] = np.where(row[:, None] >= 0, irradiance[row], 0.0)
        origin, direction = np.empty((2, FEELERS * len(row), 3), np.float32)
        limit = np.empty(FEELERS * len(row), np.float32)
        aim_feelers(
            tree, row, place, facing, max(lift_m, FEELER_LIFT * edge_m), edge_m, origin, direction, limit
        )  # fmt: skip
        blocked = context.intersector.occluded(origin, direction, limit).reshape(-1, FEELERS).astype(bool)
        known = (row >= 0) & (records.doubtful[row] == 0) & ~blocked[:, 0]
        beside = np.where(blocked[:, 1:].any(axis=1), FROM_AFAR, ALWAYS)
        table.light[slot, 3] = np.where(known, beside, NEVER)

    context.pool.map_chunks(chunk, cells, RAYS_PER_LOOK_UP + FEELERS)
    return table


def mark_around(pool: WorkerPool, tree: Tree, table: IrradianceTable, lift_m: float, steps: int) -> MarkedCells:
    """The cells at and around records, some more than once, in the records' order; see kernels.lookup.mark_cells."""
    lattice = (2 * steps + 1) ** 2

    def chunk(first: int, last: int) -> MarkedCells:
        cells = MarkedCells.empty((last - first) * lattice)
        recent = np.full(1 << (RECENT_RECORDS * lattice).bit_length(), NO_CELL)
        position, normal = tree.position[first:last], tree.normal[first:last]
        count = mark_cells(table, position, normal, lift_m, steps, recent, cells)
        # Copied, as a view would keep the room for all mentions.
        return MarkedCells(*map(np.copy, rows(cells, slice(0, count))))

    return pool.join(pool.map_chunks(chunk, len(tree.position), lattice))
