"""Limits on what clients may send: how long a body, how slowly, and how many wrong guesses."""

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from joulebox_server.errors import TooManyError

STREAMED = ("/v1/blobs/", "/v1/scenes")
"""Bodies that are written to the disk as they come; `max_blob_bytes` holds for them."""


class BodyLimit:
    """ASGI middleware: reading more than `max_bytes` of a body raises a 413, waiting too long for it a 408.

    No body may be silent for `silence_s`, and one that is not streamed to the disk must be here after ten times
    that: it is read before anybody knows who sends it. Not FastAPI's own `max_body_size`, which answers in plain
    text and not in our one shape.
    """

    def __init__(self, app: ASGIApp, max_bytes: int, silence_s: float) -> None:
        self._app = app
        self._max_bytes, self._silence_s = max_bytes, silence_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, counting what is read."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        streamed = scope["path"].startswith(STREAMED)
        ends_s = math.inf if streamed else time.monotonic() + 10 * self._silence_s
        read_bytes, complete = 0, False

        async def counted() -> Message:
            nonlocal read_bytes, complete
            if complete:  # what comes now is the client's leaving, which may take as long as it likes
                return await receive()
            try:
                async with asyncio.timeout(min(self._silence_s, ends_s - time.monotonic())):
                    message = await receive()
            except TimeoutError:
                sentence = f"the body did not come: it was silent for {self._silence_s:g} s, or ten times that in all"
                raise HTTPException(408, sentence, {"Connection": "close"}) from None
            read_bytes += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            if read_bytes > self._max_bytes and not streamed:
                raise HTTPException(413, f"the body may have at most {self._max_bytes} bytes")
            return message

        await self._app(scope, counted, send)


class FailureLimit:
    """At most `most` failures in any `span_s` seconds from one address, and ten times that from all together.

    Only failures count: a shelf of devices behind one address may enrol as fast as it likes. Belongs to one
    event loop. `clock` counts seconds.
    """

    EVERYBODY = "*"

    def __init__(self, most: int = 10, span_s: float = 60.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._most, self._span_s, self._clock = most, span_s, clock
        self._failures: dict[str, deque[float]] = {}

    def check(self, address: str) -> None:
        """Raise TooManyError while the address has used up its failures."""
        now_s = self._clock()
        for who, most in ((address, self._most), (self.EVERYBODY, 10 * self._most)):
            seen = self._recent(who, now_s)
            if len(seen) >= most:
                wait_s = math.ceil(seen[-most] + self._span_s - now_s)
                raise TooManyError(f"too many wrong codes; try again in {wait_s} s", max(1, wait_s))

    def count(self, address: str) -> None:
        """Note a failure."""
        now_s = self._clock()
        for who in (address, self.EVERYBODY):
            self._failures.setdefault(who, deque(maxlen=10 * self._most)).append(now_s)
        for who in [who for who, seen in self._failures.items() if seen[-1] <= now_s - self._span_s]:
            del self._failures[who]

    def _recent(self, who: str, now_s: float) -> list[float]:
        return [at_s for at_s in self._failures.get(who, ()) if at_s > now_s - self._span_s]
