"""Waiting for the next event without asking the database again and again."""

import asyncio
import contextlib


class Bell:
    """Rings after every commit that added an event; any number of coroutines wait for it.

    Belongs to one event loop; `ring_from_thread` may be called from any thread.
    """

    def __init__(self) -> None:
        self.heard = 0
        """How often it rang; read before looking, so that no ring between is missed."""
        self.closed = False
        self._condition = asyncio.Condition()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._rings: set[asyncio.Task[None]] = set()

    def open(self) -> None:
        """Tie the bell to the running loop."""
        self._loop = asyncio.get_running_loop()

    def ring(self) -> None:
        """Wake everybody who waits."""
        self.heard += 1
        task = asyncio.ensure_future(self._notify())
        self._rings.add(task)
        task.add_done_callback(self._rings.discard)

    def ring_from_thread(self) -> None:
        """As `ring`, from another thread; nothing before `open` and after the loop's end."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has closed: nobody waits any more
                self._loop.call_soon_threadsafe(self.ring)

    def close(self) -> None:
        """Let everybody who waits go home; `wait` returns at once from now on."""
        self.closed = True
        self.ring_from_thread()

    async def wait(self, heard: int, timeout_s: float) -> bool:
        """Until the bell rang more than `heard` times; False when it did not within `timeout_s`."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s), self._condition:
                await self._condition.wait_for(lambda: self.heard > heard or self.closed)
        return self.heard > heard

    async def _notify(self) -> None:
        async with self._condition:
            self._condition.notify_all()
