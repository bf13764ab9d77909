"""The newest events, read once for all who watch: five hundred pages must not mean five hundred queries an event."""

import asyncio
import contextlib
import logging
from bisect import bisect_right
from collections.abc import Callable
from typing import Any, Concatenate, Protocol, TypeVar

from sqlite_utils import Database

from joulebox_server.store import events
from joulebox_server.store.database import Row
from joulebox_server.waiting import Bell

log = logging.getLogger("joulebox.server")

T = TypeVar("T")
BATCH = 200
KEPT = 2000
"""Events in memory; whoever is further behind reads from the database until it has caught up."""
PAUSE_S = 0.1
"""Events of so long are told together."""
LOOK_AGAIN_S = 10.0


class Read(Protocol):
    """A read of the database that does not hold up the event loop."""

    async def __call__(self, function: Callable[Concatenate[Database, ...], T], *args: Any) -> T: ...


class Feed:
    """Events after a given one, as they come. Belongs to one event loop; `run` is its only task."""

    def __init__(self, read: Read, bell: Bell) -> None:
        self._read, self._bell = read, bell
        self._events: list[Row] = []
        self._before: int | None = None
        """Every later event is in memory; None until `run` knows."""
        self._news = asyncio.Event()

    async def run(self) -> None:
        """Read new events until the bell is closed, then let everybody who waits go home."""
        while not self._bell.closed:
            heard = self._bell.heard
            try:
                if self._before is None:
                    self._before = await self._read(events.newest_id)
                found = await self._read(events.after, self._newest, None, BATCH)
            except Exception:
                log.exception("events cannot be read; trying again")
                await asyncio.sleep(1)
                continue
            if found:
                self._take(found)
            if len(found) < BATCH:
                await asyncio.sleep(PAUSE_S)
                await self._bell.wait(heard, LOOK_AGAIN_S)
        self._wake()

    async def after(self, seen: int, sweep_id: str | None, wait_s: float) -> tuple[int, list[Row]]:
        """Events later than `seen` (of one sweep, or all) and the event up to which was looked; waits for news.

        Nothing after `wait_s`, or when the server ends.
        """
        if self._before is None or seen < self._before:
            return await self._stored(seen, sweep_id, self._before)
        if seen >= self._newest and not self._bell.closed:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._news.wait()
        start = bisect_right(self._events, seen, key=lambda event: int(event["id"]))
        later = [event for event in self._events[start:] if sweep_id is None or event["sweep_id"] in (None, sweep_id)]
        return max(seen, self._newest), later

    async def _stored(self, seen: int, sweep_id: str | None, before: int | None) -> tuple[int, list[Row]]:
        """A batch from the database; with the last of them the reader has caught up with what is in memory."""
        found = await self._read(events.after, seen, sweep_id, BATCH)
        if not found and before is None:
            await asyncio.sleep(PAUSE_S)
        looked = int(found[-1]["id"]) if found else seen
        return (looked if len(found) == BATCH else max(looked, before or 0)), found

    def _wake(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    @property
    def _newest(self) -> int:
        return int(self._events[-1]["id"]) if self._events else int(self._before or 0)

    def _take(self, found: list[Row]) -> None:
        self._events += found
        surplus = len(self._events) - KEPT
        if surplus > 0:
            self._before = int(self._events[surplus - 1]["id"])
            del self._events[:surplus]
        self._wake()
