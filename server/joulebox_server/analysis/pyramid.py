"""Laplacian pyramid of Burt & Adelson 1983, for stacks of images.

Every array is (C, H, W) float32. The 5-tap kernel is (1 4 6 4 1) / 16. Written with slices: the taps that
a reduction discards are never computed, which makes it several times faster than a general correlation.
"""

import numpy as np
from numpy.typing import NDArray

Stack = NDArray[np.float32]

_CENTRE, _NEAR, _FAR = np.float32(6 / 16), np.float32(4 / 16), np.float32(1 / 16)
_QUARTER, _HALF = np.float32(0.25), np.float32(0.5)


def reduce(stack: Stack) -> Stack:
    """Next coarser Gaussian level, (C, ceil(H/2), ceil(W/2)); mirror border (the edge is not repeated).

    Height and width must be at least 3.
    """
    return _reduce_columns(_reduce_rows(stack))


def expand(stack: Stack, height: int, width: int) -> Stack:
    """The level at the size of the next finer one, (C, height, width); the border repeats the edge."""
    return _expand_columns(_expand_rows(stack, height), width)


def smooth(stack: Stack) -> Stack:
    """(1 2 1) / 4 along both axes; the border repeats the edge."""
    padded = np.pad(stack, ((0, 0), (1, 1), (1, 1)), mode="edge")
    rows = padded[:, :-2] + padded[:, 2:]
    rows *= _QUARTER
    rows += _HALF * padded[:, 1:-1]
    out: Stack = rows[:, :, :-2] + rows[:, :, 2:]
    out *= _QUARTER
    out += _HALF * rows[:, :, 1:-1]
    return out


def _reduce_rows(stack: Stack) -> Stack:
    padded = np.pad(stack, ((0, 0), (2, 2), (0, 0)), mode="reflect")
    return _weigh(*(padded[:, k : k + stack.shape[1] : 2] for k in range(5)))


def _reduce_columns(stack: Stack) -> Stack:
    padded = np.pad(stack, ((0, 0), (0, 0), (2, 2)), mode="reflect")
    return _weigh(*(padded[:, :, k : k + stack.shape[2] : 2] for k in range(5)))


def _weigh(far: Stack, near: Stack, centre: Stack, near_after: Stack, far_after: Stack) -> Stack:
    out: Stack = far + far_after
    out *= _FAR
    out += _NEAR * (near + near_after)
    out += _CENTRE * centre
    return out


def _expand_rows(stack: Stack, height: int) -> Stack:
    padded = np.pad(stack, ((0, 0), (1, 1), (0, 0)), mode="edge")
    out = np.empty((stack.shape[0], height, stack.shape[2]), stack.dtype)
    even, odd = (height + 1) // 2, height // 2
    out[:, 0::2] = _between(padded[:, :even], padded[:, 1 : even + 1], padded[:, 2 : even + 2])
    out[:, 1::2] = _HALF * (padded[:, 1 : odd + 1] + padded[:, 2 : odd + 2])
    return out


def _expand_columns(stack: Stack, width: int) -> Stack:
    padded = np.pad(stack, ((0, 0), (0, 0), (1, 1)), mode="edge")
    out = np.empty((*stack.shape[:2], width), stack.dtype)
    even, odd = (width + 1) // 2, width // 2
    out[:, :, 0::2] = _between(padded[:, :, :even], padded[:, :, 1 : even + 1], padded[:, :, 2 : even + 2])
    out[:, :, 1::2] = _HALF * (padded[:, :, 1 : odd + 1] + padded[:, :, 2 : odd + 2])
    return out


def _between(before: Stack, here: Stack, after: Stack) -> Stack:
    out: Stack = before + after
    out *= np.float32(1 / 8)
    out += np.float32(6 / 8) * here
    return out
