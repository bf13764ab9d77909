"""Counter-based random numbers: a sample is a pure function of (key, dimension).

A key names one path (a camera sample, a photon, a branch of either); its dimensions are numbered by the code
that uses them. Mixing is SplitMix64's finaliser (Steele, Lea & Flood 2014), a bijection of 64 bits whose output
passes BigCrush when fed with a counter.
"""

import numpy as np

from joulebox_render.kernels.compilation import device

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_ONE = np.uint64(1)
_TO_UNIT = 2.0**-53


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
def child_key(key, branch):
    """Key of branch number `branch` of a path."""
    return mix(key + (np.uint64(branch) + _ONE) * _MIX_1)


@device
def uniform(key, dimension):
    """The path's sample number `dimension`, in [0, 1)."""
    bits = mix(key + (np.uint64(dimension) + _ONE) * _GOLDEN)
    return np.float64(bits >> _S11) * _TO_UNIT


@device
def sample_2d(key, dimension, i, count, columns):
    """Sample `i` of `count` in the unit square, uses two dimensions a sample from `dimension` on.

    columns > 0: jittered grid of columns x (count / columns) cells.
    columns == -1: independent.
    columns < -1: Latin square on a lattice of step -columns, which shares no factor with the count, with a random
    shift; for counts without a squarish factorisation.
    """
    u = uniform(key, dimension + 2 * i)
    v = uniform(key, dimension + 2 * i + 1)
    if columns == -1:
        return u, v
    if columns < -1:
        shift = np.int64(uniform(key, dimension - 1) * count)
        return (i + u) / count, ((shift - i * columns) % count + v) / count
    rows = count // columns
    return (i % columns + u) / columns, (i // columns + v) / rows
