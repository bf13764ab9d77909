"""A balanced kd-tree over points, and the two questions photon mapping asks of it.

The tree is implicit: node 0 covers all points, node i splits its range in the middle into nodes 2 i + 1 and
2 i + 2, so only the splitting axis and plane are stored; a leaf holds at most LEAF points, which lie together
in memory once they have been put in the tree's order.
"""

import numpy as np

from joulebox_render.kernels.compilation import device, kernel

LEAF = 16


@device
def quickselect(columns, side, order, low, high, middle):
    """Permute order[low:high] so that the entry at `middle` is the one a sort by columns[side] would put there.

    Hoare's selection with the median of three; ties do not degrade it.
    """
    last = high - 1
    while low < last:
        center = (low + last) // 2
        a, b, c = columns[side, order[low]], columns[side, order[center]], columns[side, order[last]]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, last
        while i <= j:
            while columns[side, order[i]] < pivot:
                i += 1
            while columns[side, order[j]] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            last = j
        elif middle >= i:
            low = i
        else:
            return


@device
def widest_side(columns, order, low, high):
    """Along which axis the points order[low:high] reach farthest."""
    widest, width = 0, np.float32(-1.0)
    for a in range(3):
        smallest = largest = columns[a, order[low]]
        for i in range(low + 1, high):
            value = columns[a, order[i]]
            smallest, largest = min(smallest, value), max(largest, value)
        if largest - smallest > width:
            widest, width = a, largest - smallest
    return widest


@kernel
def build_tree(columns, order, axis, plane, root, first, last, levels, scratch):
    """Build `levels` levels of the subtree of node `root`, or all there are, over the points order[first:last].

    columns (3, N) f4 holds the points; order (N,) i4, 0..N-1 at first, is permuted into the tree's order; axis
    (nodes,) i1 and plane (nodes,) f4 of the nodes are overwritten, axis -1 marking a leaf. The widest side of the
    bounding box is split first. Ties of coordinates are split by position, so any points may coincide.
    """
    scratch.node[0], scratch.low[0], scratch.high[0] = root, first, last
    size, end = 1, ((root + 1) << levels) - 1
    while size:
        size -= 1
        node, low, high = scratch.node[size], scratch.low[size], scratch.high[size]
        if high - low <= LEAF:
            axis[node] = -1
            continue
        widest = widest_side(columns, order, low, high)
        middle = (low + high) // 2
        quickselect(columns, widest, order, low, high, middle)
        axis[node] = widest
        plane[node] = columns[widest, order[middle]]
        if 2 * node + 1 < end:
            scratch.node[size], scratch.low[size], scratch.high[size] = 2 * node + 1, low, middle
            scratch.node[size + 1], scratch.low[size + 1], scratch.high[size + 1] = 2 * node + 2, middle, high
            size += 2


@device
def descend(tree, x, y, z, reach2, node, low, high, size, scratch):
    """Go down from a node to the leaf on the point's side: its range and how many subtrees now wait.

    Subtrees on the other side of a plane within reach are put into the scratch, to be visited later.
    """
    while tree.axis[node] >= 0:
        a = tree.axis[node]
        offset = (x if a == 0 else y if a == 1 else z) - tree.plane[node]
        middle = (low + high) // 2
        if offset < 0.0:
            far_node, far_low, far_high = 2 * node + 2, middle, high
            node, high = 2 * node + 1, middle
        else:
            far_node, far_low, far_high = 2 * node + 1, low, middle
            node, low = 2 * node + 2, middle
        if offset * offset < reach2:
            scratch.node[size], scratch.low[size], scratch.high[size] = far_node, far_low, far_high
            scratch.offset2[size] = offset * offset
            size += 1
    return low, high, size


@device
def squared_distance(tree, i, x, y, z):
    """From a point of the tree to (x, y, z)."""
    dx, dy, dz = tree.position[i, 0] - x, tree.position[i, 1] - y, tree.position[i, 2] - z
    return dx * dx + dy * dy + dz * dz


@device
def cosine_between(tree, i, nx, ny, nz):
    """Cosine between the normal at a point of the tree and n."""
    return tree.normal[i, 0] * nx + tree.normal[i, 1] * ny + tree.normal[i, 2] * nz


@device
def candidate(distance2, row):
    """A squared distance and a row in 64 bits that sort by distance, then by row.

    The bits of a float that is not negative sort as those of an integer do.
    """
    return (np.int64(np.float32(distance2).view(np.int32)) << 32) | row


@device
def candidate_distance2(entry):
    """The squared distance in a candidate."""
    return np.int32(entry >> 32).view(np.float32)


@device
def candidate_row(entry):
    """The row in a candidate."""
    return entry & 0xFFFFFFFF


@device
def keep_nearest(candidates, found, k):
    """Permute the first `found` candidates so that the k nearest come first, the farthest of them at k - 1.

    Quickselect with the median of three, which never is the largest of three or more, as all differ. It moves
    two entries a step (Lomuto) and does not branch on what it compares: mispredicted branches would cost more.
    """
    low, last = 0, found - 1
    while last - low > 1:
        a, b, c = candidates[low], candidates[(low + last) // 2], candidates[last]
        pivot = max(min(a, b), min(max(a, b), c))
        above = low
        for i in range(low, last + 1):
            here = candidates[i]
            candidates[i] = candidates[above]
            candidates[above] = here
            above += here <= pivot
        if k - 1 < above:
            last = above - 1
        else:
            low = above
    if low < last and candidates[low] > candidates[last]:
        candidates[low], candidates[last] = candidates[last], candidates[low]


@device
def nearest_points(tree, x, y, z, nx, ny, nz, cos_limit, limit2, k, scratch):
    """The k points nearest to (x, y, z) within sqrt(limit2) whose normals lie within the angle of n.

    scratch.candidates receives their squared distances and rows of the tree's order, where k are found the
    farthest at k - 1; returns how many were found. Of points equally far the lower rows are taken. Candidates
    gather in the scratch and are cut down to the k nearest when it is full and at the end: testing each against
    the farthest of k so far (a heap) took twice as long. No query leaves a trace in the next one's result.
    """
    found, size = 0, 0
    reach2, limit = np.float32(limit2), np.float32(cos_limit)
    room = scratch.candidates.shape[0] - LEAF
    low, high, size = descend(tree, x, y, z, reach2, 0, 0, tree.position.shape[0], size, scratch)
    while True:
        if found > room:
            keep_nearest(scratch.candidates, found, k)
            # The next number up: a point as far as the farthest may still replace it.
            found, reach2 = k, candidate_distance2(scratch.candidates[k - 1] + (1 << 32))
        for i in range(low, high):
            d2 = squared_distance(tree, i, x, y, z)
            scratch.candidates[found] = candidate(d2, i)
            found += (d2 < reach2) & (cosine_between(tree, i, nx, ny, nz) >= limit)
        while size > 0 and scratch.offset2[size - 1] >= reach2:
            size -= 1
        if size == 0:
            break
        size -= 1
        low, high, size = descend(
            tree, x, y, z, reach2, scratch.node[size], scratch.low[size], scratch.high[size], size, scratch
        )
    if found >= k:
        keep_nearest(scratch.candidates, found, k)
    return min(found, k)


@device
def nearest_point(tree, x, y, z, nx, ny, nz, cos_limit, limit2, scratch):
    """Row of the point nearest to (x, y, z) within sqrt(limit2) whose normal lies within the angle of n, or -1."""
    nearest, size = -1, 0
    reach2, limit = np.float32(limit2), np.float32(cos_limit)
    low, high, size = descend(tree, x, y, z, reach2, 0, 0, tree.position.shape[0], size, scratch)
    while True:
        for i in range(low, high):
            d2 = squared_distance(tree, i, x, y, z)
            if d2 < reach2 and cosine_between(tree, i, nx, ny, nz) >= limit:
                nearest, reach2 = i, d2
        while size > 0 and scratch.offset2[size - 1] >= reach2:
            size -= 1
        if size == 0:
            return nearest
        size -= 1
        low, high, size = descend(
            tree, x, y, z, reach2, scratch.node[size], scratch.low[size], scratch.high[size], size, scratch
        )
