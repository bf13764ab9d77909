"""The irradiance cache: final gathers at few points, reused by interpolation at all others.

An overture looks at the picture at 1/16, 1/8, 1/4 and 1/2 of its resolution; wherever the records so far do not
reach, it gathers. All points of one resolution are judged by the records of the coarser ones, so neither the order of
pixels nor the number of threads shows in the picture.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from joulebox_render.kernels.irradiance import (
    clamp_neighbours,
    doubt_gathers,
    interpolate_irradiance,
    list_cells,
    summarize_gather,
)
from joulebox_render.records import F4, F8, I4, I8, U1, Camera, Points, rows
from joulebox_render.stages.context import Context
from joulebox_render.stages.eye import camera_frame, look
from joulebox_render.stages.gather import MOST_TOGETHER, NOT_BENT, aim_gather, final_gather, incident_radiance
from joulebox_render.stages.paths import join
from joulebox_render.stages.precomputed import Illumination

# Pixels between the overture's eye rays, coarse to fine.
STEPS = (16, 8, 4, 2)
# A record reaches at most this many pixels, and at least as many as `least_pixels` says within these bounds.
MOST_PIXELS = 20.0
FINEST, COARSEST = 0.7, 2.0
# Records are placed at this share of the tolerance that they are used with, so that several blend at every point.
PLACING = 0.6
# A point must have this much of its records' radius free above it. Records that saw what is above reach no farther
# than it is away, so that theirs is.
HEADROOM = 0.25
# Entries of the grid for each record, in the mean.
MOST_ENTRIES = 64
# A gather is made again where its standard error is more than this share of what it found: where fewer than about
# seven rays bring all the light. Less would replace many that found a bright place and keep those that missed it: at
# 0.25 veach-door is 2 % darker, at 0.4 by 0.3 %. What its neighbours found says nothing of its own luck, so that their
# doubt may be asked for less without any bias.
UNSURE, NEIGHBOUR_UNSURE = 0.4, 0.25
AGAIN_BRANCH = np.uint64(1)
# Rays of a gather where no record reaches.
LEAST_RAYS = 16
# A point costs about as much as this many rays.
RAYS_PER_LOOKUP = 3


class CacheRecords(NamedTuple):
    """Final gathers: position, normal, irradiance (R, 3) f4, radius (R,) f4 [m] that errors are relative to, and
    the gradients of irradiance, rotation and translation (R, 9) f4, three numbers a channel.
    """

    position: F4
    normal: F4
    irradiance: F4
    radius: F4
    rotation: F4
    translation: F4

    @classmethod
    def empty(cls, count: int) -> CacheRecords:
        """Room for `count` records."""
        return cls(*(np.zeros((count, *shape), np.float32) for shape in ((3,), (3,), (3,), (), (9,), (9,))))


class Strata(NamedTuple):
    """A gather's grid of polar x azimuth strata of a cosine distribution, for its gradients.

    ring (polar, 3) f8: the tangent of the stratum's polar angle; sine x cosine^2 of its inner edge's, times a
    stratum's width in azimuth; the difference of its edges' sines. spoke (azimuth, 4) f8: cosine and sine of the
    stratum's azimuth, cosine and sine of its first edge's.
    """

    ring: F8
    spoke: F8

    @classmethod
    @functools.cache
    def of(cls, polar: int, azimuth: int) -> Strata:
        """The grid's numbers."""
        middle, edge = (np.arange(polar) + 0.5) / polar, np.arange(polar + 1) / polar
        inner = np.sqrt(edge[:-1]) * (1 - edge[:-1]) * (2 * math.pi / azimuth)
        ring = np.column_stack([np.sqrt(middle / (1 - middle)), inner, np.diff(np.sqrt(edge))])
        phi, first = (2 * math.pi * (np.arange(azimuth) + shift) / azimuth for shift in (0.5, 0.0))
        return cls(ring, np.column_stack([np.cos(phi), np.sin(phi), np.cos(first), np.sin(first)]))


class CacheGrid(NamedTuple):
    """Which records may reach a place: bucket b of a hash of cells lists member[first[b]:first[b + 1]].

    cell (1,) f8 side of a cell [m]; first (buckets + 1,) i8, buckets a power of two; member (M,) i4.
    """

    cell: F8
    first: I8
    member: I4


class IrradianceCache(NamedTuple):
    """Records and the grid that finds them."""

    records: CacheRecords
    grid: CacheGrid


def fill_cache(context: Context, camera: Camera, light: Illumination) -> IrradianceCache:
    """The overture: records for all that the camera sees."""
    settings = context.settings
    assert settings.width and settings.height
    records = CacheRecords.empty(0)
    cache = index_records(records, settings.irradiance_cache_tolerance)
    for level, step in enumerate(STEPS):
        width, height = -(-settings.width // step), -(-settings.height // step)
        sight = look(context, camera, 0, width * height, size=(width, height), overture=level + 1)
        points = join([sight.direct, sight.through_specular])
        _, found = interpolate(context, cache, points, PLACING)
        missing = Points(*rows(points, found == 0))
        added = gather_records(context, camera, light, missing)
        records = CacheRecords(*(np.concatenate(pair) for pair in zip(records, added, strict=True)))
        cache = index_records(records, settings.irradiance_cache_tolerance)
    return cache


def least_pixels(tolerance: float) -> float:
    """How many pixels a record reaches at least.

    Two (Krivanek 2006 has 1.5 to 3) keep them from crowding in corners; a tolerance that asks for more gets more.
    """
    return max(FINEST, COARSEST * min(1.0, tolerance))


def gather_records(context: Context, camera: Camera, light: Illumination, points: Points) -> CacheRecords:
    """Final gathers at points made records.

    Where a few rays bring most of the light, as in dim places with a small view of a lit one, their mean is unsure and
    would be seen as far as the record reaches: another gather of four times as many takes its place.
    """
    polar = max(1, round(math.sqrt(context.settings.final_gather_rays / math.pi)))
    azimuth = max(3, context.settings.final_gather_rays // polar)
    records, doubt = gather_grids(context, camera, light, points, polar, azimuth)
    unsure = np.flatnonzero(gather_again(doubt))
    again = Points(*rows(points, unsure))
    better, _ = gather_grids(
        context, camera, light, again._replace(key=again.key + AGAIN_BRANCH), 2 * polar, 2 * azimuth
    )
    for column, row in zip(records, better, strict=True):
        column[unsure] = row
    return records


def gather_again(doubt: F8) -> npt.NDArray[np.bool_]:
    """Which gathers (N,) are made again: by their own doubt, and that of those before and after them in the picture."""
    beside = np.pad(doubt, 1)
    return (doubt > UNSURE) | (np.maximum(beside[:-2], beside[2:]) > NEIGHBOUR_UNSURE)


def gather_grids(
    context: Context, camera: Camera, light: Illumination, points: Points, polar: int, azimuth: int
) -> tuple[CacheRecords, F8]:
    """Records of gathers of polar x azimuth rays, and the doubt (N,) f8 in each (kernels.irradiance.doubt_gathers)."""
    settings = context.settings
    assert settings.width and settings.height
    count, strata = polar * azimuth, Strata.of(polar, azimuth)
    frame = camera_frame(camera, settings.width, settings.height)
    pixel = 2.0 * float(np.linalg.norm(frame[1])) / settings.width
    footprint = pixel * np.linalg.norm(points.position - frame[0], axis=1) / settings.irradiance_cache_tolerance
    least = least_pixels(settings.irradiance_cache_tolerance)
    near, far = (np.asarray(pixels * footprint, np.float32) for pixels in (least, MOST_PIXELS))
    doubt = np.empty(len(points.owner))

    def chunk(first: int, last: int) -> CacheRecords:
        rays = aim_gather(points, first, last, count, polar, NOT_BENT, lattice=context.sobol)
        incident, distance = incident_radiance(context, light, rays)
        doubt_gathers(incident, doubt[first:last])
        part = CacheRecords.empty(last - first)
        summarize_gather(
            points, first, strata, settings.irradiance_cache_tolerance, incident, distance,
            near[first:last], far[first:last], part, 0,
        )  # fmt: skip
        return part

    parts = context.pool.map_chunks(chunk, len(points.owner), count, MOST_TOGETHER)
    return CacheRecords(*map(np.concatenate, zip(CacheRecords.empty(0), *parts, strict=True))), doubt


def index_records(records: CacheRecords, tolerance: float) -> IrradianceCache:
    """Clamp neighbours' radii to each other (which writes to `records`) and list which reach where."""
    grid = _list_records(records, tolerance)
    before, pending = records.radius.copy(), np.ones(len(records.radius), np.uint8)
    for _ in range(2):
        clamp_neighbours(records, grid, tolerance, pending)
    if (records.radius < before).any():
        grid = _list_records(records, tolerance)
    return IrradianceCache(records, grid)


def _list_records(records: CacheRecords, tolerance: float) -> CacheGrid:
    count = len(records.radius)
    cell = np.array([_cell_side(tolerance * records.radius.astype(np.float64)) if count else 1.0])
    buckets = 1 << max(6, (8 * count).bit_length())
    first, member = np.zeros(buckets + 1, np.int64), np.zeros(0, np.int32)
    list_cells(records, tolerance, cell[0], first, member, 0)
    first = np.cumsum(first)
    member = np.zeros(first[-1], np.int32)
    list_cells(records, tolerance, cell[0], first, member, 1)
    # Listing has moved each bucket's start to its end, which is where the next one starts.
    return CacheGrid(cell, np.concatenate([[0], first[:-1]]), member)


def _cell_side(reach: F8) -> float:
    """Side of a cell [m] for records that reach so far (R,) [m]: two median reaches, or more where few reach so much
    farther (a horizon) that they would fill space with entries.
    """
    side = 2.0 * float(np.partition(reach, len(reach) // 2)[len(reach) // 2])
    while float(((2.0 * reach / side + 1.0) ** 3).sum()) > MOST_ENTRIES * len(reach):
        side *= 2.0
    return side


def interpolate(context: Context, cache: IrradianceCache, points: Points, share: float = 1.0) -> tuple[F4, U1]:
    """Irradiance (N, 3) f4 at points, and found (N,) u1: 0 where no record is good enough.

    `share` of the tolerance is what counts as good enough. Records of open places do not speak for a point close under
    something they hardly saw, as in a gap: one ray along the normal tells.
    """
    settings = context.settings
    irradiance, found = np.empty((len(points.owner), 3), np.float32), np.empty(len(points.owner), np.uint8)

    def chunk(first: int, last: int) -> None:
        radius = np.empty(last - first, np.float32)
        interpolate_irradiance(
            cache.records, cache.grid, share * settings.irradiance_cache_tolerance, settings.irradiance_gradients,
            Points(*rows(points, slice(first, last))), irradiance[first:last], radius,
        )  # fmt: skip
        under = context.intersector.occluded(points.position[first:last], points.normal[first:last], HEADROOM * radius)
        found[first:last] = (radius > 0) & (under == 0)

    context.pool.map_chunks(chunk, len(points.owner), RAYS_PER_LOOKUP)
    return irradiance, found


def cached_gather(context: Context, cache: IrradianceCache, light: Illumination, points: Points) -> F8:
    """Radiance (points, 3) f8 that points reflect of indirect light; gathered where no record reaches."""
    irradiance, found = interpolate(context, cache, points)
    radiance = np.empty((len(points.owner), 3))

    def reflect(first: int, last: int) -> None:
        radiance[first:last] = points.albedo[first:last] * irradiance[first:last] / math.pi

    context.pool.map_chunks(reflect, len(radiance), 1)
    missing = np.flatnonzero(found == 0)
    # The samples of a pixel share the noise of its own gathers as records share theirs with many pixels.
    count = max(LEAST_RAYS, context.settings.final_gather_rays // context.settings.samples_per_pixel)
    radiance[missing] = final_gather(context, light, Points(*rows(points, missing)), count).astype(np.float32)
    return radiance
