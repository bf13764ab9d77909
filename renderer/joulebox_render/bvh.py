"""A bounding volume hierarchy over a scene's triangles, in place of Embree where there is none."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.bvh_build import BINS, MAX_DEPTH, build_bvh
from joulebox_render.records import F4, F8, I4, I8

# Boxes are widened by this share of the largest coordinate: a ray within a box's face is still inside.
PAD = 2.0**-21


class Bvh(NamedTuple):
    """What the walk reads: box (nodes, 16) f4 and link (nodes, 16) i4 on the same memory, as kernels/bvh.py describes;
    corner (T, 9) f4, the triangles' corners in the order of the leaves, and primitive (T,) i4, which they are.
    """

    box: F4
    link: I4
    corner: F4
    primitive: I4


class Stack(NamedTuple):
    """Nodes that one thread has yet to visit: node (MAX_DEPTH,) i4 and distance (MAX_DEPTH,) f4."""

    node: I4
    distance: F4

    @classmethod
    def empty(cls) -> Stack:
        """Room for any tree."""
        return cls(np.empty(MAX_DEPTH, np.int32), np.empty(MAX_DEPTH, np.float32))


class Work(NamedTuple):
    """What building writes: ranges yet to be built (low, high, slot = 2 parent + child, depth), the bounds of a range
    and of the middles of its triangles, and the bins of one axis: bounds, how many triangles fill each, cost of all
    that is right of each.
    """

    low: I8
    high: I8
    slot: I8
    depth: I8
    whole: F4
    centers: F4
    sweep: F4
    bins: F4
    filled: I8
    right: F8

    @classmethod
    def empty(cls) -> Work:
        """Room for any tree."""
        low, high, slot, depth = np.empty((4, MAX_DEPTH), np.int64)
        whole, centers, sweep = (np.empty((1, 6), np.float32) for _ in range(3))
        return cls(
            low, high, slot, depth, whole, centers, sweep,
            np.empty((BINS, 6), np.float32), np.empty(BINS, np.int64), np.empty(BINS),
        )  # fmt: skip


def grow_bvh(vertices: F4, triangles: I4) -> Bvh:
    """The hierarchy over triangles (T, 3) i4, T > 0, of vertices (V, 3) f4."""
    count = len(triangles)
    corner = vertices[triangles]
    bounds = np.concatenate([corner.min(axis=1), corner.max(axis=1)], axis=1)
    order = np.arange(count, dtype=np.int32)
    box = cache_lines(count + 1)
    pad = np.float32(PAD * float(np.abs(bounds).max()))
    nodes = build_bvh(bounds, order, pad, box, box.view(np.int32), Work.empty())
    box = box[:nodes]
    return Bvh(box, box.view(np.int32), corner[order].reshape(count, 9), order)


def cache_lines(rows: int) -> F4:
    """Rows of 16 numbers that each fill one cache line of 64 bytes."""
    memory = np.zeros(16 * rows + 16, np.float32)
    first = -(memory.ctypes.data // 4) % 16
    return memory[first : first + 16 * rows].reshape(rows, 16)
