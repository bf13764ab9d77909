"""Computes the differences that the store waits for, in processes of their own, off the request path."""

import asyncio
import contextlib
import json
import logging
from concurrent.futures import BrokenExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from joulebox_server.errors import InvalidError, ServerError
from joulebox_server.store import Store, agreement, blobs, differences
from joulebox_server.store.database import Row
from joulebox_server.waiting import Bell
from joulebox_server.workers import Workers

log = logging.getLogger("joulebox.server")

LOOK_AGAIN_S = 5.0
"""At most this long until a difference asked for by another process is noticed."""


@dataclass(frozen=True)
class Comparison:
    """A finished comparison: the document of `joulebox diff` and the delta image, or why there is none."""

    outcome: dict[str, Any] | None
    delta_png: bytes | None
    reason: str | None = None


def compare_files(reference: Path, test: Path, exposure: float) -> Comparison:
    """Compare two picture files. Never raises for what is in them: the reason is a sentence.

    Runs in a worker process, so it imports the metric only here and returns plain values.
    """
    from joulebox_server.analysis.difference import Display, compare, delta_image
    from joulebox_server.analysis.images import encode_png, read_picture
    from joulebox_server.analysis.opinions import second_opinions

    try:
        pictures = [_read(read_picture, path, which) for path, which in ((reference, "reference"), (test, "test"))]
        display = Display(exposure=exposure)
        found = compare(pictures[0], pictures[1], display)
        opinions = second_opinions(pictures[0], pictures[1], exposure)
    except ServerError as error:
        return Comparison(None, None, str(error))
    outcome = {
        "value": found.value,
        "value_per_pixel": found.value_per_pixel,
        "max_jnd": found.max_jnd,
        "p99_jnd": found.p99_jnd,
        "share_above_3_jnd": found.share_above_3_jnd,
        "limit": found.limit,
        "acceptable": found.acceptable,
        **asdict(opinions),
        "width": pictures[0].shape[1],
        "height": pictures[0].shape[0],
        "display": display.document(*found.jnd.shape),
    }
    return Comparison(outcome, encode_png(delta_image(found.jnd)))


def _read(read_picture: Any, path: Path, which: str) -> Any:
    try:
        return read_picture(path)
    except ServerError as error:
        # A blob's path means nothing to the reader of this sentence.
        raise InvalidError(str(error).replace(str(path), f"the {which} image")) from None


class Comparer:
    """Takes pending differences from the store and puts their values back.

    workers  compute, and `at_once` comparisons are under way there
    """

    def __init__(self, store: Store, bell: Bell, workers: Workers, at_once: int, max_blob_bytes: int) -> None:
        self._store = store
        self._bell = bell
        self._workers = workers
        self._at_once = at_once
        self._max_blob_bytes = max_blob_bytes
        self._running: dict[str, asyncio.Task[None]] = {}

    async def run(self) -> None:
        """Compute whatever is pending until cancelled."""
        try:
            while not self._bell.closed:
                heard = self._bell.heard
                try:
                    found = await asyncio.to_thread(self._store.read, differences.pending, self._at_once)
                    for difference in found:
                        self.start(difference)
                except Exception:
                    log.exception("looking for differences to compute failed; trying again")
                await self._bell.wait(heard, LOOK_AGAIN_S)
        finally:
            for task in self._running.values():
                task.cancel()

    def start(self, difference: Row) -> "asyncio.Task[None]":
        """Begin to compute a difference, once: the task ends when its row is done or failed."""
        key = str(difference["id"])
        if key not in self._running:
            task = asyncio.create_task(self._compute(difference))
            self._running[key] = task
            task.add_done_callback(lambda _: self._forget(key))
        return self._running[key]

    def _forget(self, key: str) -> None:
        self._running.pop(key, None)
        self._bell.ring()  # there is room for the next one

    async def _compute(self, difference: Row) -> None:
        key = str(difference["id"])
        comparison = await self._compared(difference)
        while True:
            try:
                await asyncio.to_thread(self._keep, key, comparison)
                return
            except (ServerError, OSError) as error:  # a full disk: what was computed waits for room
                log.warning("the difference %s cannot be stored yet: %s", key, error)
                await asyncio.sleep(LOOK_AGAIN_S)

    async def _compared(self, difference: Row) -> Comparison:
        key = str(difference["id"])
        exposure = float(json.loads(difference["display"])["exposure"])
        while True:
            try:
                reference, test = await asyncio.to_thread(self._paths, difference)
                return await asyncio.wrap_future(self._workers.submit(compare_files, reference, test, exposure))
            except BrokenExecutor:
                if await asyncio.to_thread(self._store.write, differences.count_try, key) >= differences.MAX_TRIES:
                    return Comparison(None, None, "the process that compared the pictures ended unexpectedly")
            except Exception as error:
                log.exception("comparing %s failed", key)
                return Comparison(None, None, f"the comparison failed: {error or type(error).__name__}")

    def _paths(self, difference: Row) -> tuple[Path, Path]:
        found = [
            self._store.read(blobs.find, self._store.blob_dir, difference[which])
            for which in ("reference_sha256", "test_sha256")
        ]
        return found[0], found[1]

    def _keep(self, key: str, comparison: Comparison) -> None:
        if comparison.outcome is None or comparison.delta_png is None:
            self._store.write(differences.fail, key, comparison.reason or "the comparison gave no value")
            return
        with blobs.Incoming(self._store.incoming_dir, self._max_blob_bytes) as incoming:
            incoming.write(comparison.delta_png)
            sha256 = incoming.finish()
            self._store.write(blobs.adopt, self._store.blob_dir, incoming, sha256)
        self._store.write(agreement.complete, key, comparison.outcome, sha256)


async def stop(task: "asyncio.Task[None]") -> None:
    """Cancel a background task and wait for its end."""
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
