"""The one thread pool, and how work is cut into chunks for it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import TypeVar

from joulebox_render.errors import StoppedError

T = TypeVar("T")

# Rays in flight per chunk: their arrays (about 60 bytes a ray) stay within a core's second-level cache.
CHUNK_RAYS = 16_384
# Work of less than this part of a chunk is not worth sharing among threads.
SMALLEST_SHARE = 3


def usable_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class WorkerPool:
    """Runs a chunk after another on threads; each chunk goes through Embree and serial kernels on one thread.

    Results come back in the order of the chunks, so neither the number of threads nor which thread was faster
    shows in a picture. `chunk_rays` is a parameter so that tests can show that the chunk size does not either.
    """

    def __init__(self, threads: int = 0, chunk_rays: int = CHUNK_RAYS) -> None:
        self.threads = threads or usable_cores()
        self.chunk_rays = chunk_rays
        self._stop_asked = threading.Event()
        self._executor = ThreadPoolExecutor(self.threads, thread_name_prefix="render")

    def map_chunks(self, work: Callable[[int, int], T], count: int, rays_per_item: int) -> Iterator[T]:
        """work(first, last) over [0, count) in chunks of at most about `chunk_rays` rays; yields results in order.

        One thread is the caller's own, which works as results are asked for: a second would do a part of its work at
        the same time, and be waited for after every chunk. Raises StoppedError, in place of the next chunk's result,
        after `stop`.
        """
        ranges = self._cut(count, max(1, self.chunk_rays // max(1, rays_per_item)))

        def guarded(span: tuple[int, int]) -> T:
            if self._stop_asked.is_set():
                raise StoppedError("rendering was stopped")
            return work(*span)

        return map(guarded, ranges) if self.threads == 1 else self._executor.map(guarded, ranges)

    def _cut(self, count: int, most: int) -> list[tuple[int, int]]:
        """Chunks of at most `most`, smaller and smaller towards the end: no thread waits long for another's last.

        Source: Polychronopoulos & Kuck 1987, guided self-scheduling. One thread gets even chunks.
        """
        ranges: list[tuple[int, int]] = []
        least = max(1, -(-most // SMALLEST_SHARE))
        even = max(1, -(-count // max(1, -(-count // most))))
        while (first := ranges[-1][1] if ranges else 0) < count:
            fair = -(-(count - first) // self.threads)
            size = even if self.threads == 1 else min(most, max(least, fair))
            ranges.append((first, min(first + size, count)))
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
