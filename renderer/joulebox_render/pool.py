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
SMALLEST_SHARE = 4


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
        """work(first, last) over [0, count) in even chunks of at most about `chunk_rays` rays; yields results in order.

        Raises StoppedError, in place of the next chunk's result, after `stop`.
        """
        step = self._even_step(count, max(1, self.chunk_rays // max(1, rays_per_item)))
        ranges = [(first, min(first + step, count)) for first in range(0, count, step)]

        def guarded(span: tuple[int, int]) -> T:
            if self._stop_asked.is_set():
                raise StoppedError("rendering was stopped")
            return work(*span)

        return self._executor.map(guarded, ranges)

    def _even_step(self, count: int, step: int) -> int:
        """A step of at most `step` that leaves no thread waiting while others work on a last chunk."""
        chunks = -(-count // step)
        if count > step // SMALLEST_SHARE:
            chunks = -(-chunks // self.threads) * self.threads
        return max(1, -(-count // max(1, chunks)))

    def stop(self) -> None:
        """Give up all work from the next chunk on; may be called by a signal handler."""
        self._stop_asked.set()

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=True, cancel_futures=True)
