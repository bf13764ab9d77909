"""The kd-tree against asking every point."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from joulebox_render.kernels.kdtree import (
    LEAF,
    candidate_distance2,
    candidate_row,
    nearest_point,
    nearest_points,
)
from joulebox_render.records import Scratch, Tree
from joulebox_render.stages.photon_map import grow_tree
from scipy.spatial import cKDTree

UP = (0.0, 0.0, 1.0)


def up(count: int) -> Any:
    return np.tile(np.array(UP, np.float32), (count, 1))


def ask(
    tree: Tree, at: Any, k: int, reach_m: float = math.inf, normal: Any = UP, cos_limit: float = -2.0
) -> tuple[Any, Any]:
    """Squared distances, sorted, and rows of the k nearest."""
    scratch = Scratch.empty(k)
    scratch.candidates[:] = -7
    at32, normal32 = np.array(at, np.float32), np.array(normal, np.float32)
    found = nearest_points(tree, *at32, *normal32, cos_limit, reach_m**2, k, scratch)
    entries = scratch.candidates[:found]
    if found == k:
        assert entries[k - 1] == entries.max(), "the farthest comes last"
    entries = np.sort(entries)
    rows = np.array([candidate_row(entry) for entry in entries], np.int64)
    distance2 = np.array([candidate_distance2(entry) for entry in entries], np.float32)
    row = nearest_point(tree, *at32, *normal32, cos_limit, reach_m**2, scratch)
    assert row == -1 if found == 0 else ((tree.position[row] - at32) ** 2).sum() == pytest.approx(distance2[0])
    return distance2, rows


def brute_force(position: Any, chosen: Any, at: Any, k: int, reach_m: float = math.inf) -> Any:
    """Sorted squared distances of the k nearest chosen points nearer than reach."""
    offset = position[chosen].astype(np.float64) - np.asarray(at, np.float32).astype(np.float64)
    distance2 = np.sort((offset**2).sum(axis=1))
    return distance2[distance2 < reach_m**2][:k]


def check_tree(tree: Tree, order: Any, position: Any, normal: Any) -> None:
    """The tree holds every point once, in leaves of at most LEAF, on the right side of every plane."""
    assert sorted(order) == list(range(len(position)))
    np.testing.assert_array_equal(tree.position, position[order])
    np.testing.assert_array_equal(tree.normal, normal[order])
    pending = [(0, 0, len(position))]
    while pending:
        node, low, high = pending.pop()
        if tree.axis[node] < 0:
            assert high - low <= LEAF
            continue
        column = tree.position[:, tree.axis[node]]
        middle = (low + high) // 2
        assert column[low:middle].max() <= tree.plane[node] <= column[middle:high].min()
        pending += [(2 * node + 1, low, middle), (2 * node + 2, middle, high)]


@pytest.mark.parametrize("count", [1, 2, LEAF, LEAF + 1, 2 * LEAF + 1, 1000, 20_000])
@pytest.mark.parametrize("k", [1, 7, 100])
def test_random_points_against_scipy(count: int, k: int) -> None:
    random = np.random.default_rng(count + k)
    position = random.random((count, 3), np.float32)
    tree, order = grow_tree(position, up(count))
    check_tree(tree, order, position, up(count))
    other = cKDTree(tree.position.astype(np.float64))
    for at in random.random((20, 3), np.float32):
        distance2, index = ask(tree, at, k)
        expected, rows = other.query(at, k=[*range(1, min(k, count) + 1)])
        np.testing.assert_allclose(np.sqrt(distance2), expected, rtol=1e-5)
        assert set(index) == set(rows)


def test_reach_and_normals_limit_what_is_found() -> None:
    random = np.random.default_rng(2)
    position = random.random((5000, 3), np.float32)
    normal = random.normal(size=(5000, 3))
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    tree, order = grow_tree(position, normal)
    cos_limit = math.cos(math.radians(30))
    for at, n in zip(random.random((100, 3), np.float32), normal, strict=False):
        alike = normal @ n >= cos_limit
        distance2, index = ask(tree, at, 50, 0.3, n, cos_limit)
        np.testing.assert_allclose(distance2, brute_force(position, alike, at, 50, 0.3), rtol=1e-5)
        assert alike[order[index]].all()
        assert len(set(index)) == len(index)
    # About 5000 * 4.2 * 0.3^3 / 2 * 0.067 = 19 lie within reach, so here the reach decides, not k.
    assert 0 < len(distance2) < 50


def test_the_angle_of_normals_is_exact() -> None:
    """29 degrees count, 31 do not."""
    angles = np.radians([0, 29, 31, 90, 180])
    normal = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], -1).astype(np.float32)
    tree, order = grow_tree(np.zeros((5, 3), np.float32), normal)
    _, index = ask(tree, (0, 0, 0), 5, cos_limit=math.cos(math.radians(30)))
    assert set(order[index]) == {0, 1}


@pytest.mark.parametrize("count", [0, 1, 5])
def test_more_asked_for_than_there_are(count: int) -> None:
    position = np.arange(3 * count, dtype=np.float32).reshape(count, 3)
    tree, _ = grow_tree(position, up(count))
    distance2, index = ask(tree, (0, 0, 0), 9)
    assert len(distance2) == count
    assert sorted(index) == list(range(count))


def test_coincident_points_are_all_found() -> None:
    position = np.repeat(np.array([[0, 0, 0], [1, 0, 0]], np.float32), 300, axis=0)
    tree, order = grow_tree(position, up(600))
    check_tree(tree, order, position, up(600))
    distance2, index = ask(tree, (0.1, 0, 0), 600)
    assert sorted(index) == list(range(600))
    np.testing.assert_allclose(distance2, np.repeat([0.01, 0.81], 300), rtol=1e-5)
    distance2, index = ask(tree, (0, 0, 0), 400, reach_m=0.5)
    assert len(index) == 300
    assert not distance2.any()


@pytest.mark.parametrize("k", [1, 2, 5, 100, 599])
def test_of_points_as_far_as_each_other_the_first_are_taken(k: int) -> None:
    """Also where many more than k are within reach, so that candidates are cut down on the way."""
    step = np.arange(3000) % 3
    position = np.stack([step, 0 * step, 0 * step], -1).astype(np.float32)
    tree, _ = grow_tree(position, up(3000))
    distance2, rows = ask(tree, (1.25, 0, 0), k, reach_m=1.5)
    np.testing.assert_array_equal(distance2, np.full(k, 0.0625, np.float32))
    np.testing.assert_array_equal(rows, np.flatnonzero(tree.position[:, 0] == 1)[:k])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_points_on_a_line(axis: int) -> None:
    position = np.zeros((1000, 3), np.float32)
    position[:, axis] = np.random.default_rng(3).permutation(1000)
    tree, order = grow_tree(position, up(1000))
    check_tree(tree, order, position, up(1000))
    at = np.zeros(3)
    at[axis] = 499.75
    _, index = ask(tree, at, 4)
    assert sorted(position[order[index], axis]) == [498, 499, 500, 501]


def test_sorted_and_constant_coordinates_do_not_slow_the_building() -> None:
    """Selection by median of three with ties: 200,000 such points in seconds where a quadratic one takes hours."""
    steps = np.arange(200_000, dtype=np.float32)
    for column in (steps, steps[::-1], steps % 2, np.zeros_like(steps), np.minimum(steps, steps[::-1])):
        position = np.stack([column, 0 * steps, 0 * steps], -1)
        tree, order = grow_tree(position, up(len(position)))
        check_tree(tree, order, position, up(len(position)))


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    position=hnp.arrays(np.float32, st.tuples(st.integers(0, 60), st.just(3)), elements=st.integers(-3, 3)),
    at=st.tuples(*[st.integers(-4, 4)] * 3),
    k=st.integers(1, 70),
    reach_m=st.sampled_from([0.5, 1.0, 1.5, 2.5, 100.0]),
)
def test_any_points_against_brute_force(position: Any, at: tuple[int, int, int], k: int, reach_m: float) -> None:
    """Small whole numbers, so that points coincide and distances tie and reach is met exactly: all are exact."""
    tree, order = grow_tree(position, up(len(position)))
    check_tree(tree, order, position, up(len(position)))
    distance2, index = ask(tree, at, k, reach_m)
    everything = np.ones(len(position), bool)
    np.testing.assert_array_equal(distance2, brute_force(position, everything, at, k, reach_m))
    assert len(set(index)) == len(index)
    np.testing.assert_array_equal(((position[order[index]] - np.array(at)) ** 2).sum(axis=1), distance2)
