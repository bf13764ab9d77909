"""A balanced kd-tree over points, and the two questions photon mapping asks of it.

The tree is implicit: node 0 covers all points, node i splits its range in the middle into nodes 2 i + 1 and
2 i + 2, so only the splitting axis and plane are stored; a leaf holds at most LEAF points, which lie together
in memory once they have been put in the tree's order.
"""

import numpy as np

from joulebox_render.kernels.compilation import device, kernel

LEAF = 12


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


@kernel
def build_tree(columns, order, axis, plane, scratch):
    """Build the tree over points given as columns (3, N) f4, widest side of the bounding box first.

    order (N,) i4 holds 0..N-1 and is permuted into the tree's order; axis (nodes,) i1 and plane (nodes,) f4 are
    overwritten, axis -1 marking a leaf. Ties of coordinates are split by position, so any points may coincide.
    """
    scratch.node[0], scratch.low[0], scratch.high[0] = 0, 0, order.shape[0]
    size = 1
    while size:
        size -= 1
        node, low, high = scratch.node[size], scratch.low[size], scratch.high[size]
        if high - low <= LEAF:
            axis[node] = -1
            continue
        widest, width = 0, np.float32(-1.0)
        for a in range(3):
            smallest = largest = columns[a, order[low]]
            for i in range(low + 1, high):
                value = columns[a, order[i]]
                smallest, largest = min(smallest, value), max(largest, value)
            if largest - smallest > width:
                widest, width = a, largest - smallest
        middle = (low + high) // 2
        quickselect(columns, widest, order, low, high, middle)
        axis[node] = widest
        plane[node] = columns[widest, order[middle]]
        scratch.node[size], scratch.low[size], scratch.high[size] = 2 * node + 1, low, middle
        scratch.node[size + 1], scratch.low[size + 1], scratch.high[size + 1] = 2 * node + 2, middle, high
        size += 2


@device
def sift_down(heap, size):
    """Restore the max-heap after its root changed."""
    parent = 0
    d, k = heap.distance2[0], heap.row[0]
    while True:
        child = 2 * parent + 1
        if child >= size:
            break
        if child + 1 < size and heap.distance2[child + 1] > heap.distance2[child]:
            child += 1
        if heap.distance2[child] <= d:
            break
        heap.distance2[parent], heap.row[parent] = heap.distance2[child], heap.row[child]
        parent = child
    heap.distance2[parent], heap.row[parent] = d, k


@device
def sift_up(heap, last):
    """Restore the max-heap after an entry was put at `last`."""
    d, k = heap.distance2[last], heap.row[last]
    while last > 0:
        parent = (last - 1) // 2
        if heap.distance2[parent] >= d:
            break
        heap.distance2[last], heap.row[last] = heap.distance2[parent], heap.row[parent]
        last = parent
    heap.distance2[last], heap.row[last] = d, k


@device
def nearest_points(tree, x, y, z, nx, ny, nz, cos_limit, limit2, k, scratch):
    """The k points nearest to (x, y, z) within sqrt(limit2) whose normals lie within the angle of n.

    scratch.distance2 and .row (at least k) become a max-heap of squared distances and rows of the tree's order;
    returns how many were found. The result does not depend on how many queries came before it.
    """
    found = 0
    reach2 = np.float32(limit2)
    count = tree.position.shape[0]
    node, low, high, size = 0, 0, count, 0
    while True:
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
        for i in range(low, high):
            dx = tree.position[i, 0] - x
            dy = tree.position[i, 1] - y
            dz = tree.position[i, 2] - z
            d2 = np.float32(dx * dx + dy * dy + dz * dz)
            if d2 >= reach2:
                continue
            if tree.normal[i, 0] * nx + tree.normal[i, 1] * ny + tree.normal[i, 2] * nz < cos_limit:
                continue
            if found < k:
                scratch.distance2[found], scratch.row[found] = d2, i
                sift_up(scratch, found)
                found += 1
            else:
                scratch.distance2[0], scratch.row[0] = d2, i
                sift_down(scratch, k)
            if found == k:
                reach2 = scratch.distance2[0]
        while True:
            if size == 0:
                return found
            size -= 1
            if scratch.offset2[size] < reach2:
                break
        node, low, high = scratch.node[size], scratch.low[size], scratch.high[size]
