"""Tabulated look-ups of irradiance against the nearest records that they stand for."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from joulebox_render.kernels.lookup import (
    ALWAYS,
    FROM_AFAR,
    NEVER,
    NO_CELL,
    answer_rays,
    cell_key,
    look_up_irradiance,
    nearest_records,
)
from joulebox_render.pool import WorkerPool
from joulebox_render.records import Hits, Points, Rays, Scratch
from joulebox_render.stages.photon_map import grow_tree
from joulebox_render.stages.precomputed import IrradianceRecords, IrradianceTable, empty_table, tabulate

COS_LIMIT = math.cos(math.radians(30))
EDGE = 0.01
UP = (0.0, 0.0, 1.0)


def nothing_there(origin: Any, direction: Any, limit: Any) -> Any:
    """Occlusion in an empty scene."""
    return np.zeros(len(origin), np.uint8)


def context_of(pool: WorkerPool, occluded: Callable[[Any, Any, Any], Any] = nothing_there) -> Any:
    """What a table is built with: workers, and what stands in the way."""
    return SimpleNamespace(pool=pool, intersector=SimpleNamespace(occluded=occluded))


def records_at(
    position: Any, normal: Any, irradiance: Any, scale: float = 1.0,
    occluded: Callable[[Any, Any, Any], Any] = nothing_there,
) -> IrradianceRecords:  # fmt: skip
    """Records with their table, all lengths times `scale`; points looked up lie 1e-6 above them."""
    position = np.asarray(position, np.float32) * np.float32(scale)
    tree, order = grow_tree(position, np.broadcast_to(np.asarray(normal, np.float32), position.shape).copy())
    values = np.ascontiguousarray(np.asarray(irradiance, np.float32)[order])
    records = IrradianceRecords(tree, values, np.zeros(len(values), np.uint8), 4 * EDGE * scale, empty_table())
    with WorkerPool(2, 100) as pool:
        table = tabulate(context_of(pool, occluded), records, COS_LIMIT, EDGE * scale, 1.3 * EDGE * scale, 1e-6 * scale)
    return records._replace(table=table)


def looked_up(records: IrradianceRecords, at: Any, normal: Any) -> tuple[Any, Any, int]:
    """Irradiance (N, 3) by the table and by the nearest record, and how many points met a cell."""
    at = np.ascontiguousarray(at, np.float32)
    normals = np.broadcast_to(np.asarray(normal, np.float32), at.shape).copy()
    fast = np.empty((len(at), 3), np.float32)
    rest = (at, normals, records.reach_m, COS_LIMIT, Scratch.empty(1))
    unsure, row = np.empty(len(at), np.uint8), np.empty(len(at), np.int32)
    met = look_up_irradiance(records.table, records.tree, records.irradiance, records.doubtful, *rest, fast, unsure)
    nearest_records(records.tree, *rest, row)
    exact = np.where(row[:, None] >= 0, records.irradiance[row], np.float32(0))
    return fast, exact, met


def frame(normal: Any) -> Any:
    """Rows: two unit tangents and the unit normal."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    tangent = np.cross(normal, [0.36, 0.48, 0.8])
    tangent /= np.linalg.norm(tangent)
    return np.stack([tangent, np.cross(normal, tangent), normal])


def spread(random: Any, count: int, width: float = 1.0) -> Any:
    """Random points of the square |x|, |y| < width / 2 at z = 0."""
    return (random.random((count, 3)) - 0.5) * (width, width, 0)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, -1, 0), (1, 1, 0), (1, 1, 1), (0.3, -0.5, 0.81)])
def test_a_plane_is_looked_up_without_bias(normal: Any) -> None:
    """Irradiance that rises linearly over a plane, records 0.0087 apart, cells of 0.01.

    A cell stands for a place at most 0.87 edges from its points, and the record nearest to either lies, but once in
    exp(-pi (4.5 / 2)^2), within 2.25 spacings: no look-up is off by more than slope x 0.03. The mean keeps its value:
    over 20,000 cells and records the offsets, 0.003 rms in each, average to 2e-5 of the slope, held to 4.5 sigma.
    """
    random = np.random.default_rng(1)
    axes = frame(normal)
    slope = np.array([1.0, -1.0, 0.5])

    def value(local: Any) -> Any:
        return 2 + local[:, :1] * slope

    places = spread(random, 13_000)
    records = records_at(places @ axes, axes[2], value(places))
    points = spread(random, 100_000, 0.9) + np.array([0, 0, 1e-6])
    fast, exact, met = looked_up(records, points @ axes, axes[2])
    assert met > 0.97 * len(points)
    assert np.abs(fast - value(points)).max() < 0.03
    assert np.abs(fast - exact).max() > 0, "cells stand for other places than the points"
    assert np.abs((fast - value(points)).mean(axis=0)).max() < 1.2e-4
    assert (fast - value(points)).std() < 1.6 * (exact - value(points)).std()


def test_walls_do_not_leak() -> None:
    """The two sides of a sheet, a floor under it, and a second sheet half a cell behind, each of its own value."""
    random = np.random.default_rng(2)
    sheet = spread(random, 5000)
    places = [sheet, sheet, sheet[:, [2, 0, 1]] + (0, 0, 0.5), sheet - (0, 0, EDGE / 2)]
    normals = np.repeat([(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 0, 1)], 5000, axis=0)
    values = np.repeat([1.0, 2.0, 3.0, 1.0], 5000)[:, None] * np.ones(3)
    records = records_at(np.concatenate(places), normals, values)
    points = spread(random, 20_000, 0.95)
    for value, normal, at in [
        (1, (0, 0, 1), points), (2, (0, 0, -1), points), (3, (1, 0, 0), points[:, [2, 0, 1]] + (0, 0, 0.5))
    ]:  # fmt: skip
        fast, _, met = looked_up(records, at + 1e-6 * np.array(normal), normal)
        np.testing.assert_array_equal(fast, value)
        assert met > 0.95 * len(at)


def test_directions_that_share_a_cell_are_less_than_45_degrees_apart() -> None:
    """Most are within 30: and those that scenes are full of share one with all directions up to 5 degrees off."""
    random = np.random.default_rng(3)
    table = IrradianceTable(np.zeros(3), 1.0, np.full(1, NO_CELL), np.zeros((1, 4), np.float32))
    directions = random.standard_normal((1500, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    code = np.array([cell_key(table, 0.5, 0.5, 0.5, *direction) for direction in directions])
    cosine = directions @ directions.T
    shared = code[:, None] == code
    assert cosine[shared].min() > math.cos(math.radians(45))
    assert len(np.unique(code)) > 60
    for common in np.vstack([np.eye(3), -np.eye(3)]):
        tilted = common + math.tan(math.radians(5)) * np.cross(common, directions)
        tilted /= np.linalg.norm(tilted, axis=1)[:, None]
        own = cell_key(table, 0.5, 0.5, 0.5, *common)
        assert all(cell_key(table, 0.5, 0.5, 0.5, *direction) == own for direction in tilted[:100])


def test_where_there_is_no_cell_the_nearest_record_answers() -> None:
    """Around and far beyond the records, and for other normals: exactly as without a table."""
    random = np.random.default_rng(4)
    places = spread(random, 300, 0.5)
    records = records_at(places, UP, random.random((300, 3)))
    points = np.concatenate([spread(random, 20_000, 0.6), [(1e30, 0, 0), (0, -1e30, 0), (3, 3, 3), (-3e5, 0, 1e9)]])
    fast, exact, met = looked_up(records, points, (0.2, 0, math.sqrt(0.96)))
    assert 0 < met < 0.9 * len(points)
    assert (fast == exact).all(axis=1).mean() > 1 - met / len(points)
    np.testing.assert_array_equal(fast[-4:], 0)
    bare = records._replace(table=empty_table())
    fast, exact, met = looked_up(bare, points, UP)
    assert met == 0
    np.testing.assert_array_equal(fast, exact)
    assert exact.any()


@pytest.mark.parametrize("scale", [2.0**-10, 2.0**10])
def test_a_scaled_scene_gives_the_same_irradiance(scale: float) -> None:
    """Bit for bit for powers of two, which scale floating-point lengths exactly."""
    random = np.random.default_rng(5)
    places, values = spread(random, 3000), random.random((3000, 3))
    points = (spread(random, 5000) + np.array([0, 0, 1e-6])).astype(np.float32)
    one, _, met = looked_up(records_at(places, UP, values), points, UP)
    other, _, also_met = looked_up(records_at(places, UP, values, scale), points * np.float32(scale), UP)
    assert met == also_met > 4500
    np.testing.assert_array_equal(one, other)


def test_records_too_far_apart_for_cells_are_looked_up_one_by_one() -> None:
    """Two sheets 10,000 km apart with cells of a centimetre: more cells a side than a key can number."""
    random = np.random.default_rng(6)
    places = spread(random, 2000)
    places[1000:, 0] += 1e7
    records = records_at(places, UP, random.random((2000, 3)))
    fast, exact, met = looked_up(records, places, UP)
    assert met == 0
    np.testing.assert_array_equal(fast, exact)
    assert exact.all()


def test_the_table_does_not_depend_on_threads_or_chunks() -> None:
    random = np.random.default_rng(7)
    records = records_at(spread(random, 4000), UP, random.random((4000, 3)))
    tables = []
    for threads, chunk in ((1, 10_000), (3, 7)):
        with WorkerPool(threads, chunk) as pool:
            tables.append(tabulate(context_of(pool), records, COS_LIMIT, EDGE, 1.3 * EDGE, 1e-6))
    np.testing.assert_array_equal(tables[0].key, tables[1].key)
    filled = tables[0].key != NO_CELL
    assert filled.sum() <= len(filled) / 2
    np.testing.assert_array_equal(tables[0].light[filled], tables[1].light[filled])


def test_cells_at_a_wall_and_beyond_it_are_unsure() -> None:
    """Records on z = 0 left of a wall at x = 0 that no ray passes: cells that touch it, and those behind, are unsure.

    A cell's feelers are one edge long and start at its middle, so cells whose middle is nearer than an edge feel the
    wall; those two edges away do not, and have their record on their own side.
    """
    random = np.random.default_rng(9)
    places = spread(random, 4000, 0.6)
    places = places[places[:, 0] < 0]

    def through_the_wall(origin: Any, direction: Any, limit: Any) -> Any:
        end = origin[:, 0] + limit * direction[:, 0]
        return ((origin[:, 0] < 0) != (end < 0)).astype(np.uint8)

    records = records_at(places, UP, np.ones((len(places), 3)), occluded=through_the_wall)
    at = np.zeros((600, 3), np.float32)
    at[:, 0], at[:, 1] = np.repeat(np.linspace(-0.1, 0.02, 40), 15), np.tile(np.linspace(-0.2, 0.2, 15), 40)
    irradiance, unsure = np.empty((len(at), 3), np.float32), np.empty(len(at), np.uint8)
    look_up_irradiance(
        records.table, records.tree, records.irradiance, records.doubtful, at,
        np.tile(np.array(UP, np.float32), (len(at), 1)), records.reach_m, COS_LIMIT, Scratch.empty(1),
        irradiance, unsure,
    )  # fmt: skip
    assert unsure[at[:, 0] > -EDGE / 2].all()
    assert not unsure[at[:, 0] < -2 * EDGE].any()


def test_a_doubtful_record_makes_its_cells_unsure() -> None:
    random = np.random.default_rng(10)
    records = records_at(spread(random, 500, 0.2), UP, np.ones((500, 3)))
    records.doubtful[:] = 1
    with WorkerPool(1) as pool:
        table = tabulate(context_of(pool), records, COS_LIMIT, EDGE, 1.3 * EDGE, 1e-6)
    assert not table.light[table.key != NO_CELL, 3].any()
    assert records.table.light[records.table.key != NO_CELL, 3].any()


@pytest.mark.parametrize(("trust", "told_from"), [(ALWAYS, 1.5), (FROM_AFAR, 3.0), (NEVER, math.inf)])
def test_a_cell_answers_rays_that_come_from_far_enough(
    make_scene: Callable[..., Path], open_session: Callable[..., Any], trust: float, told_from: float
) -> None:
    """From 1.5 resolutions on, from twice as far where something stands beside the cell, or never; from a third of that
    on some are told by chance. Every ray is either told, at 0.5 / pi x weight x 2 W/m^2, or becomes a point to light.
    """
    random = np.random.default_rng(12)
    records = records_at(spread(random, 4000), UP, np.full((4000, 3), 2.0))
    records.table.light[:, 3] = trust
    count, resolution = 2000, 0.02
    rays = Rays.empty(count)
    share = random.uniform(0, 4, count)
    rays.origin[:], rays.direction[:] = spread(random, count, 0.8), (0, 0, -1)
    rays.origin[:, 2], rays.weight[:] = share * resolution, 0.25
    rays.owner[:] = rays.sample[:] = np.arange(count)
    rays.key[:] = 99
    floor = '<shape type="rectangle"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>'
    context = open_session(make_scene(floor + '<emitter type="point"/>')).context
    hits = Hits(*context.intersector.closest(rays.origin, rays.direction))
    radiance, near, rest = np.zeros((count, 3)), Points.empty(count), np.empty(count, np.int32)
    near_count, rest_count = answer_rays(context.tables, records.table, resolution, rays, hits, radiance, near, rest)
    told = radiance[:, 0] > 0
    assert rest_count == 0
    assert sorted([*near.owner[:near_count], *np.flatnonzero(told)]) == list(range(count))
    np.testing.assert_allclose(radiance[told], 0.25 * 0.5 * 2.0 / math.pi, rtol=1e-6)
    np.testing.assert_array_equal(near.weight[:near_count], 0.25)
    np.testing.assert_allclose(near.albedo[:near_count], 0.5)
    cells = np.isin([cell_key(records.table, *at, *UP) for at in rays.origin * (1, 1, 0) + (0, 0, 1e-5)],
                    records.table.key)  # fmt: skip
    assert told[cells & (share > told_from)].all()
    assert not told[share < told_from / 3].any()
    between = told[cells & (share > 0.4 * told_from) & (share < 0.9 * told_from)]
    assert math.isinf(told_from) or 0 < between.mean() < 1
