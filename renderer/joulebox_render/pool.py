"""The one thread pool, and how work is cut into chunks for it."""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from types import TracebackType
from typing import Any, TypeVar

import numpy as np

from joulebox_render.errors import StoppedError

T = TypeVar("T")
R = TypeVar("R", bound=tuple[Any, ...])

# Rays in flight per chunk: the arrays of fewer (about 60 bytes a ray) stay within a core's second-level cache, but then
# there is more Python between kernels, for which threads wait for each other.
CHUNK_RAYS = 32_768
# How long a thread that holds Python's lock may keep it from one that comes back from a kernel [s]. Python's own 5 ms
# are longer than most kernels run.
LOCK_HELD_S = 2e-4
# Work of less than this part of a chunk is not worth sharing among threads.
SMALLEST_SHARE = 4


def usable_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class WorkerPool:
    """Runs a chunk after another on threads; each chunk goes through Embree and serial kernels on one thread.

    The caller's thread is one of them: it would otherwise wake up for every chunk done, and take a core from the
    thread that works there. Results come back in the order of the chunks, so neither the number of threads nor which
    thread was faster shows in a picture. `chunk_rays` is a parameter so that tests can show that the chunk size does
    not either.
    """

    def __init__(self, threads: int = 0, chunk_rays: int = CHUNK_RAYS) -> None:
        self.threads = threads or usable_cores()
        self.chunk_rays = chunk_rays
        self._stop_asked = threading.Event()
        if self.threads > 1:
            sys.setswitchinterval(min(LOCK_HELD_S, sys.getswitchinterval()))
        self._executor = ThreadPoolExecutor(max(1, self.threads - 1), thread_name_prefix="render")

    def map_chunks(self, work: Callable[[int, int], T], count: int, rays_per_item: int, together: int = 1) -> list[T]:
        """Results, in order, of work(first, last) over [0, count) in chunks of at most about `chunk_rays` rays.

        Up to `together` chunks are made as one, as far as all threads still get some. Raises what a chunk raised, or,
        after `stop`, StoppedError in place of the next chunk.
        """
        most = together * max(1, self.chunk_rays // max(1, rays_per_item))
        # Where all threads get some only of smaller chunks, these are not as small as to be worth nothing.
        smallest = max(-(-most // (SMALLEST_SHARE * together * together)), -(-count // (2 * self.threads)))
        ranges = self._cut(count, min(-(-most // SMALLEST_SHARE), smallest), most)
        results: dict[int, T] = {}
        waiting = deque(enumerate(ranges))
        taking = threading.Lock()

        def take() -> tuple[int, tuple[int, int]] | None:
            with taking:
                return waiting.popleft() if waiting else None

        def work_through() -> None:
            try:
                for i, span in iter(take, None):
                    if self._stop_asked.is_set():
                        raise StoppedError("rendering was stopped")
                    results[i] = work(*span)
            except BaseException:
                waiting.clear()
                raise

        helpers = [self._executor.submit(work_through) for _ in range(min(self.threads, len(ranges)) - 1)]
        try:
            work_through()
        finally:
            wait(helpers)
        for helper in helpers:
            helper.result()
        return [results[i] for i in range(len(ranges))]

    def join(self, parts: Sequence[R]) -> R:
        """One record (a NamedTuple of arrays) of one or more, their rows in order."""
        if len(parts) == 1:
            return parts[0]
        ends = np.cumsum([len(part[0]) for part in parts])
        whole = type(parts[0])(*(np.empty((ends[-1], *column.shape[1:]), column.dtype) for column in parts[0]))

        def copy(first: int, last: int) -> None:
            for part, end in zip(parts[first:last], ends[first:last], strict=True):
                for column, target in zip(part, whole, strict=True):
                    target[end - len(column) : end] = column

        self.map_chunks(copy, len(parts), -(-int(ends[-1]) // len(parts)))
        return whole

    def _cut(self, count: int, least: int, most: int) -> list[tuple[int, int]]:
        """Chunks of at most `most`, smaller and smaller towards the end: no thread waits long for another's last.

        Source: Polychronopoulos & Kuck 1987, guided self-scheduling. One thread gets even chunks.
        """
        ranges: list[tuple[int, int]] = []
        even = max(1, -(-count // max(1, -(-count // most))))
        while (first := ranges[-1][1] if ranges else 0) < count:
            fair = -(-(count - first) // self.threads)
            size = even if self.threads == 1 else min(most, max(least, fair))
            # A small rest goes along with the last.
            ranges.append((first, first + size if first + size + least // 2 < count else count))
        return ranges

    def stop(self) -> None:
        """Give up all work from the next chunk on; may be called by a signal handler."""
        self._stop_asked.set()

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=True, cancel_futures=True)
