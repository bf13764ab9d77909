"""Counter-based samples: a sample is a pure function of (key, sample, dimension).

A key names a family of paths (a pixel's camera rays, all photons, one branch of either) and `sample` a path's
number within it; dimensions are numbered by the code that uses them. Independent numbers hash all three, with
SplitMix64's finaliser (Steele, Lea & Flood 2014), a bijection of 64 bits whose output passes BigCrush when fed
with a counter. Sobol samples take `sample` as the index into a sequence that the key and the dimension
scramble, so that the paths of a family cover their common space evenly.
"""

import math

import numpy as np
from numba import types
from numba.extending import intrinsic

from joulebox_render.kernels.compilation import device

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_ONE = np.uint64(1)
_S32 = np.uint64(32)
_HALF, _LOWEST = np.uint32(16), np.uint32(1)
_TO_UNIT = 2.0**-53
_TO_UNIT_32 = np.float32(2.0**-32)
# The largest number below 1 in single precision.
BELOW_ONE = np.float32(1.0 - 2.0**-24)
# Its multiples, modulo 1, fall into the largest gaps that are left between them.
_GOLDEN_SECTION = 0.6180339887498949
# What `columns` says of samples that are in no grid.
INDEPENDENT, SOBOL = -1, 0


@device
def mix(bits):
    """Scramble 64 bits into 64 bits."""
    z = np.uint64(bits)
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@device
def path_key(seed, stream, index):
    """Key of path `index` of one stream (camera, photons, ...) of one seed."""
    return mix(mix(np.uint64(seed) * _GOLDEN + np.uint64(stream)) + np.uint64(index) * _GOLDEN)


@device
def member_key(key, sample):
    """Key of one path of a family, under which its independent numbers are hashed."""
    return mix(key + (np.uint64(sample) + _ONE) * _MIX_2)


@device
def child_key(key, branch):
    """Key of the family of branches number `branch` of a family of paths."""
    return mix(key + (np.uint64(branch) + _ONE) * _MIX_1)


@device
def uniform(key, dimension):
    """The path's sample number `dimension`, in [0, 1)."""
    bits = mix(key + (np.uint64(dimension) + _ONE) * _GOLDEN)
    return np.float64(bits >> _S11) * _TO_UNIT


@intrinsic
def _bitreverse(_typing, _bits):
    """LLVM's reversal of 32 bits; shifts and masks written out take twice as long."""

    def generate(_context, builder, _signature, arguments):
        return builder.bitreverse(arguments[0])

    return types.uint32(types.uint32), generate


@device
def reverse_bits(bits):
    """The 32 low bits in the opposite order."""
    return _bitreverse(np.uint32(bits))


@device
def low_to_high(bits, seed):
    """Hash of 32 bits in which each bit depends on lower bits alone; on reversed bits it is Owen's scrambling.

    Everything is cut to 32 bits at once, so that loops over samples do eight at a time. Source: Laine & Karras 2011;
    constants of Vegdahl 2021.
    """
    x = np.uint32(bits)
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x3D20ADEA)))
    x = np.uint32(x + seed)
    x = np.uint32(x * np.uint32((seed >> _HALF) | _LOWEST))
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x05526C56)))
    return np.uint32(x ^ np.uint32(x * np.uint32(0x53A22864)))


@device
def sobol_second(index):
    """Bits of the Sobol sequence's second dimension, lowest bit first: Pascal's triangle modulo 2 times the index."""
    x = np.uint32(index)
    x = np.uint32(x ^ ((x >> np.uint32(1)) & np.uint32(0x55555555)))
    x = np.uint32(x ^ ((x >> np.uint32(2)) & np.uint32(0x33333333)))
    x = np.uint32(x ^ ((x >> np.uint32(4)) & np.uint32(0x0F0F0F0F)))
    x = np.uint32(x ^ ((x >> np.uint32(8)) & np.uint32(0x00FF00FF)))
    return np.uint32(x ^ (x >> _HALF))


@device
def sobol_bits(key, index):
    """Point `index` of an Owen-scrambled Sobol sequence in the unit square, as two numbers of 32 bits.

    The key also shuffles the order. Any aligned run of 2^k indices is a (0, k, 2)-net. Sequences of different keys are
    independent of each other (Burley 2020, "Practical hash-based Owen scrambling").
    """
    seeds, more = mix(key + _MIX_1), mix(key + _MIX_2)
    shuffled = reverse_bits(low_to_high(reverse_bits(index), np.uint32(seeds)))
    u = reverse_bits(low_to_high(shuffled, np.uint32(seeds >> _S32)))
    v = reverse_bits(low_to_high(sobol_second(shuffled), np.uint32(more)))
    return u, v


@device
def sobol_2d(key, index):
    """`sobol_bits` as numbers in [0, 1)."""
    u, v = sobol_bits(key, index)
    return np.float64(u) * _TO_UNIT_32, np.float64(v) * _TO_UNIT_32


@device
def draw_1d(sobol, key, sample, dimension):
    """One number of a path in [0, 1): from a sequence over its family where `sobol`, else independent."""
    if sobol:
        return sobol_2d(child_key(key, dimension), sample)[0]
    return uniform(member_key(key, sample), dimension)


@device
def draw_2d(sobol, key, sample, dimension):
    """Two numbers of a path in [0, 1)^2, as `draw_1d`; uses two dimensions."""
    if sobol:
        return sobol_2d(child_key(key, dimension), sample)
    path = member_key(key, sample)
    return uniform(path, dimension), uniform(path, dimension + 1)


@device
def sample_2d(key, sample, dimension, i, count, columns):
    """Point `i` of the `count` in the unit square that path `sample` uses, two dimensions a point.

    columns > 0: jittered grid of columns x (count / columns) cells.
    columns == INDEPENDENT: independent.
    columns == SOBOL: one sequence goes on through all paths of the family.
    columns < -1: Latin square on a lattice of step -columns, which shares no factor with the count, with a random
    shift; for counts without a squarish factorisation.
    """
    if columns == SOBOL:
        return sobol_2d(child_key(key, dimension), sample * count + i)
    path = member_key(key, sample)
    u = uniform(path, dimension + 2 * i)
    v = uniform(path, dimension + 2 * i + 1)
    if columns == INDEPENDENT:
        return u, v
    if columns < -1:
        shift = np.int64(uniform(path, dimension - 1) * count)
        return (i + u) / count, ((shift - i * columns) % count + v) / count
    rows = count // columns
    return (i % columns + u) / columns, (i // columns + v) / rows


@device
def fill_2d(key, sample, dimension, paths, count, columns, u, v, first):
    """All `count` points of sample_2d at once, into u and v (N,) f4 from `first` on, below 1.

    Those of `paths` paths, number `sample` and the next ones, follow each other. A loop of its own per kind of sampler:
    without branches and divisions inside it takes a quarter of the time, a loop over all paths half of that.
    """
    if columns == SOBOL:
        base, start = child_key(key, dimension), sample * count
        for i in range(paths * count):
            a, b = sobol_bits(base, start + i)
            u[first + i] = min(np.float32(a) * _TO_UNIT_32, BELOW_ONE)
            v[first + i] = min(np.float32(b) * _TO_UNIT_32, BELOW_ONE)
        return
    for path in range(paths):
        fill_cells(member_key(key, sample + path), dimension, count, columns, u, v, first + path * count)


@device
def fill_cells(path, dimension, count, columns, u, v, first):
    """The part of `fill_2d` for one path and samplers other than Sobol's."""
    for i in range(count):
        u[first + i] = min(uniform(path, dimension + 2 * i), BELOW_ONE)
        v[first + i] = min(uniform(path, dimension + 2 * i + 1), BELOW_ONE)
    if columns < -1:
        shift, width = np.int64(uniform(path, dimension - 1) * count), 1.0 / count
        for i in range(count):
            u[first + i] = min((i + u[first + i]) * width, BELOW_ONE)
            v[first + i] = min(((shift - i * columns) % count + v[first + i]) * width, BELOW_ONE)
    elif columns > 0:
        rows = count // columns
        width, height = 1.0 / columns, 1.0 / rows
        for j in range(rows):
            for i in range(columns):
                at = first + j * columns + i
                u[at] = min((i + u[at]) * width, BELOW_ONE)
                v[at] = min((j + v[at]) * height, BELOW_ONE)


@device
def fill_lattice(key, sample, count, columns, u, v, first):
    """A grid of columns x (count / columns) cells with one point in each, cells of a row and rows following each other.

    Where the points lie in their cells goes on by the golden section from row to row in u, from column to column in v,
    from a place drawn at random: each is uniform in its cell, and together they leave no gaps. Means of 80 to 600 of
    them err by a third (smooth light) to three quarters (an edge) of what jitter in each cell leaves, for less work.
    """
    path = member_key(key, sample)
    start, across = uniform(path, 1), uniform(path, 2)
    width, height = 1.0 / columns, 1.0 / (count // columns)
    for j in range(count // columns):
        along = start + j * _GOLDEN_SECTION
        along -= math.floor(along)
        for i in range(columns):
            up = across + i * _GOLDEN_SECTION
            at = first + j * columns + i
            u[at] = min(np.float32((i + along) * width), BELOW_ONE)
            v[at] = min(np.float32((j + up - math.floor(up)) * height), BELOW_ONE)
