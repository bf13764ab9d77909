"""How the process keeps the memory it has freed."""

from __future__ import annotations

import ctypes
import functools
import sys

# Parameters of glibc's mallopt, and what they are set to [bytes].
TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3
KEPT = 1 << 30
# The largest that glibc takes; arrays above it are given back at once, and are rare.
LARGEST_KEPT = 32 << 20
GROWTH = 4 << 20


@functools.cache
def keep_freed_memory() -> None:
    """Have freed memory used again instead of given back to the system; does nothing but with glibc.

    A picture allocates the arrays of each chunk anew. Where each comes fresh from the system, its pages are mapped
    and cleared one by one, which takes a tenth to a fifth of a picture's CPU time, and threads wait for each other.
    """
    if sys.platform != "linux":
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:
        return
    for parameter, size in ((MMAP_THRESHOLD, LARGEST_KEPT), (TRIM_THRESHOLD, KEPT), (TOP_PAD, GROWTH)):
        mallopt(parameter, size)
