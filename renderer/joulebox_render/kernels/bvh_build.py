"""Builds a bounding volume hierarchy over triangles by the surface area heuristic in bins (Wald 2007)."""

import numpy as np

from joulebox_render.kernels.compilation import device, kernel

BINS = 16
MAX_LEAF = 8
# What a visit of a node costs, as a multiple of a test of a triangle.
NODE_COST = 1.0
# Below this depth ranges are halved as they lie, so that whatever the triangles the depth stays under MAX_DEPTH.
SAH_DEPTH = 64
MAX_DEPTH = SAH_DEPTH + 32
BIG, HALF = np.float32(3e38), np.float32(0.5)


@device
def half_area(box, row):
    """Half the surface of a box (.., 6)."""
    x = np.float64(box[row, 3]) - np.float64(box[row, 0])
    y = np.float64(box[row, 4]) - np.float64(box[row, 1])
    z = np.float64(box[row, 5]) - np.float64(box[row, 2])
    return x * y + y * z + z * x


@device
def make_empty(box, row):
    """Turn a row into the box that holds nothing."""
    for a in range(3):
        box[row, a], box[row, 3 + a] = BIG, -BIG


@device
def include(box, row, other, other_row):
    """Grow a box by another one."""
    for a in range(3):
        box[row, a] = min(box[row, a], other[other_row, a])
        box[row, 3 + a] = max(box[row, 3 + a], other[other_row, 3 + a])


@device
def middle(bounds, triangle, a):
    """Middle of a triangle's bounds along axis a."""
    return HALF * bounds[triangle, a] + HALF * bounds[triangle, 3 + a]


@device
def bin_of(bounds, triangle, a, lowest, scale):
    """Bin of a triangle by the middle of its bounds."""
    return max(0, min(int((np.float64(middle(bounds, triangle, a)) - lowest) * scale), BINS - 1))


@device
def bin_scale(centers, a):
    """Bins per length, 0 where the middles of all triangles coincide."""
    extent = np.float64(centers[0, 3 + a]) - np.float64(centers[0, a])
    return BINS * (1.0 - 1e-6) / extent if extent > 1e-30 else 0.0


@device
def bound_range(bounds, order, low, high, work):
    """Set work.whole to the bounds of order[low:high] and work.centers to those of their middles."""
    make_empty(work.whole, 0)
    make_empty(work.centers, 0)
    for i in range(low, high):
        include(work.whole, 0, bounds, order[i])
        for a in range(3):
            center = middle(bounds, order[i], a)
            work.centers[0, a] = min(work.centers[0, a], center)
            work.centers[0, 3 + a] = max(work.centers[0, 3 + a], center)


@device
def best_split(bounds, order, low, high, work):
    """Cheapest way to part order[low:high]: (cost as a sum of areas times counts, axis, last bin of the left).

    The axis is -1 where all middles coincide. work.centers must hold the bounds of the middles.
    """
    best, best_axis, best_bin = 1e300, -1, 0
    for a in range(3):
        scale = bin_scale(work.centers, a)
        if scale == 0.0:
            continue
        lowest = np.float64(work.centers[0, a])
        for k in range(BINS):
            make_empty(work.bins, k)
            work.filled[k] = 0
        for i in range(low, high):
            k = bin_of(bounds, order[i], a, lowest, scale)
            work.filled[k] += 1
            include(work.bins, k, bounds, order[i])
        make_empty(work.sweep, 0)
        count = 0
        for k in range(BINS - 1, 0, -1):
            count += work.filled[k]
            include(work.sweep, 0, work.bins, k)
            work.right[k] = half_area(work.sweep, 0) * count if count else -1.0
        make_empty(work.sweep, 0)
        count = 0
        for k in range(BINS - 1):
            count += work.filled[k]
            include(work.sweep, 0, work.bins, k)
            if count == 0 or work.right[k + 1] < 0.0:
                continue
            cost = half_area(work.sweep, 0) * count + work.right[k + 1]
            if cost < best:
                best, best_axis, best_bin = cost, a, k
    return best, best_axis, best_bin


@device
def part(bounds, order, low, high, a, last_bin, work):
    """Permute order[low:high] so that bins up to `last_bin` come first; returns where the others start."""
    lowest, scale = np.float64(work.centers[0, a]), bin_scale(work.centers, a)
    i, j = low, high - 1
    while i <= j:
        if bin_of(bounds, order[i], a, lowest, scale) <= last_bin:
            i += 1
        else:
            order[i], order[j] = order[j], order[i]
            j -= 1
    return i


@kernel
def build_bvh(bounds, order, pad, box, link, work):
    """Build the tree; returns how many nodes there are.

    bounds (T, 6) f4; order (T,) i4 holds 0..T-1 and is permuted into the order of the leaves. pad is the length by
    which boxes are widened. box and link are the nodes as kernels/bvh.py describes them; node 0 only holds the
    link to the root. work is bvh.Work.
    """
    nodes = 1
    work.low[0], work.high[0], work.slot[0], work.depth[0] = 0, order.shape[0], 0, 0
    size = 1
    while size:
        size -= 1
        low, high, depth = work.low[size], work.high[size], work.depth[size]
        parent, child = work.slot[size] // 2, work.slot[size] % 2
        bound_range(bounds, order, low, high, work)
        for a in range(3):
            box[parent, 6 * child + a] = work.whole[0, a] - pad
            box[parent, 6 * child + 3 + a] = work.whole[0, 3 + a] + pad
        count = high - low
        cost, axis, last_bin = 0.0, -1, 0
        if count > 1 and depth < SAH_DEPTH:
            cost, axis, last_bin = best_split(bounds, order, low, high, work)
        area = half_area(work.whole, 0)
        if count <= MAX_LEAF and (axis < 0 or cost + NODE_COST * area >= count * area):
            link[parent, 12 + child] = ~(low * MAX_LEAF + count - 1)
            continue
        border = (low + high) // 2
        if axis >= 0:
            border = part(bounds, order, low, high, axis, last_bin, work)
        link[parent, 12 + child] = nodes
        work.low[size], work.high[size], work.slot[size] = border, high, 2 * nodes + 1
        work.low[size + 1], work.high[size + 1], work.slot[size + 1] = low, border, 2 * nodes
        work.depth[size] = work.depth[size + 1] = depth + 1
        nodes += 1
        size += 2
    return nodes
