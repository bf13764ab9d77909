"""A balanced kd-tree over points, and the two questions photon mapping asks of it.

The tree is implicit: node 0 covers all points, node i splits its range in the middle into nodes 2 i + 1 and
2 i + 2, so only the splitting axis and plane are stored; a leaf holds at most LEAF points, which lie together
in memory once they have been put in the tree's order.
"""

import numpy as np

from joulebox_render.kernels.compilation import device, kernel

LEAF = 12
STACK = 64


@device
def quickselect(coordinate, order, low, high, middle):
    """Permute order[low:high] so that the entry at `middle` is the one a sort would put there.

    coordinate (N,) f4. Hoare's selection with the median of three; ties do not degrade it.
    """
    last = high - 1
    while low < last:
        center = (low + last) // 2
        a, b, c = coordinate[order[low]], coordinate[order[center]], coordinate[order[last]]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, last
        while i <= j:
            while coordinate[order[i]] < pivot:
                i += 1
            while coordinate[order[j]] > pivot:
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
def build_tree(columns, order, axis, plane):
    """Build the tree over points given as columns (3, N) f4, widest side of the bounding box first.

    order (N,) i4 holds 0..N-1 and is permuted into the tree's order; axis (nodes,) i1 and plane (nodes,) f4 are
    overwritten, axis -1 marking a leaf. Ties of coordinates are split by position, so any points may coincide.
    """
    stack_node = np.empty(STACK, np.int64)
    stack_low = np.empty(STACK, np.int64)
    stack_high = np.empty(STACK, np.int64)
    stack_node[0], stack_low[0], stack_high[0] = 0, 0, order.shape[0]
    size = 1
    while size:
        size -= 1
        node, low, high = stack_node[size], stack_low[size], stack_high[size]
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
        quickselect(columns[widest], order, low, high, middle)
        axis[node] = widest
        plane[node] = columns[widest, order[middle]]
        stack_node[size], stack_low[size], stack_high[size] = 2 * node + 1, low, middle
        stack_node[size + 1], stack_low[size + 1], stack_high[size + 1] = 2 * node + 2, middle, high
        size += 2


@device
def sift_down(distance2, index, size):
    """Restore the max-heap after its root changed."""
    parent = 0
    d, k = distance2[0], index[0]
    while True:
        child = 2 * parent + 1
        if child >= size:
            break
        if child + 1 < size and distance2[child + 1] > distance2[child]:
            child += 1
        if distance2[child] <= d:
            break
        distance2[parent], index[parent] = distance2[child], index[child]
        parent = child
    distance2[parent], index[parent] = d, k


@device
def sift_up(distance2, index, last):
    """Restore the max-heap after an entry was put at `last`."""
    d, k = distance2[last], index[last]
    while last > 0:
        parent = (last - 1) // 2
        if distance2[parent] >= d:
            break
        distance2[last], index[last] = distance2[parent], index[parent]
        last = parent
    distance2[last], index[last] = d, k


@device
def nearest_points(tree, x, y, z, nx, ny, nz, cos_limit, limit2, k, distance2, index, stack):
    """The k points nearest to (x, y, z) within sqrt(limit2) whose normals lie within the angle of n.

    distance2 (k,) f4 and index (k,) i4 become a max-heap of squared distances and rows of the tree's order;
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
                stack.node[size], stack.low[size], stack.high[size] = far_node, far_low, far_high
                stack.offset2[size] = offset * offset
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
                distance2[found], index[found] = d2, i
                sift_up(distance2, index, found)
                found += 1
            else:
                distance2[0], index[0] = d2, i
                sift_down(distance2, index, k)
            if found == k:
                reach2 = distance2[0]
        while True:
            if size == 0:
                return found
            size -= 1
            if stack.offset2[size] < reach2:
                break
        node, low, high = stack.node[size], stack.low[size], stack.high[size]
