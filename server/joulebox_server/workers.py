"""Processes for what would hold up everybody: a comparison takes seconds of CPU, and a chart Python's lock."""

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


def _give_way() -> None:
    """Lower a worker's priority, where the system can: an agent may be measuring on this very machine."""
    if hasattr(os, "nice"):
        os.nice(10)


class Workers:
    """`count` processes, started when they are first needed and anew after one ended unexpectedly.

    given  does the work instead (`concurrent.futures` interface); whoever made it ends it
    """

    def __init__(self, count: int, given: Executor | None = None) -> None:
        self._count, self._given = count, given
        self._own: ProcessPoolExecutor | None = None
        self._lock = threading.Lock()

    def submit(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        """As an executor's; the future has a BrokenExecutor when the process ended, and the next one is a new one."""
        pool = self._pool()
        try:
            future = pool.submit(function, *args, **kwargs)
        except BrokenExecutor:  # by the work of somebody else, a moment ago
            self._forget(pool)
            pool = self._pool()
            future = pool.submit(function, *args, **kwargs)
        future.add_done_callback(lambda done: self._look(done, pool))
        return future

    def close(self) -> None:
        """End the processes; what has not begun is cancelled."""
        with self._lock:
            own, self._own = self._own, None
        if own is not None:
            own.shutdown(wait=True, cancel_futures=True)

    def _pool(self) -> Executor:
        if self._given is not None:
            return self._given
        with self._lock:
            if self._own is None:
                context = multiprocessing.get_context("spawn")
                self._own = ProcessPoolExecutor(self._count, mp_context=context, initializer=_give_way)
            return self._own

    def _look(self, done: "Future[Any]", pool: Executor) -> None:
        if not done.cancelled() and isinstance(done.exception(), BrokenExecutor):
            self._forget(pool)

    def _forget(self, pool: Executor) -> None:
        with self._lock:
            if self._own is pool:
                self._own = None
