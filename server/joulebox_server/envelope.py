"""What every request and answer has in common: an id, a count, a line in the log, headers that browsers heed."""

import json
import logging
import secrets
import time
from collections.abc import Mapping
from itertools import count
from typing import Any, Final

from prometheus_client import CollectorRegistry, Counter, Histogram
from starlette.types import ASGIApp, Message, Receive, Scope, Send

log = logging.getLogger("joulebox.requests")

SAFE_HEADERS: Final[Mapping[str, str]] = {
    # An answer that says nothing else is data: no page may run, frame or sniff it, no cache may keep it.
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
HSTS: Final = "max-age=31536000"


class Envelope:
    """ASGI middleware around everything else.

    secure  the server speaks TLS itself, and browsers are to insist on it
    """

    def __init__(self, app: ASGIApp, registry: CollectorRegistry, secure: bool) -> None:
        self._app = app
        wanted = {**SAFE_HEADERS, **({"Strict-Transport-Security": HSTS} if secure else {})}
        self._headers = [(name.lower().encode(), value.encode()) for name, value in wanted.items()]
        # Counted up from a start of its own in each run: a UUID would cost a system call.
        self._run, self._numbers = secrets.token_hex(6), count(1)
        self._requests = Counter("joulebox_requests", "Requests answered.", ["method", "status"], registry=registry)
        self._seconds = Histogram("joulebox_request_seconds", "Time to the first byte of an answer.", registry=registry)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, and look at the start of the response."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started_s = time.perf_counter()
        state = scope.setdefault("state", {})
        state["request_id"] = f"{self._run}-{next(self._numbers):06}"

        async def wrapped(message: Message) -> None:
            if message["type"] == "http.response.start":
                self._seal(scope, message, time.perf_counter() - started_s)
            await send(message)

        await self._app(scope, receive, wrapped)

    def _seal(self, scope: Scope, message: Message, time_s: float) -> None:
        headers: list[tuple[bytes, bytes]] = message.setdefault("headers", [])
        said = {name for name, _ in headers}  # ASGI's names are in lower case
        wanted = ((b"x-request-id", scope["state"]["request_id"].encode()), *self._headers)
        headers += [header for header in wanted if header[0] not in said]
        status = int(message["status"])
        self._requests.labels(_known(scope["method"]), str(status)).inc()
        self._seconds.observe(time_s)
        if log.isEnabledFor(logging.INFO):
            log.info(json.dumps(_line(scope, status, time_s), ensure_ascii=True))


def _known(method: str) -> str:
    """The method as a label: whoever sends invented ones must not fill the memory with labels."""
    return method if method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE") else "other"


def _line(scope: Scope, status: int, time_s: float) -> dict[str, Any]:
    """What the log says of a request. Never a header, a query or a body: tokens and codes travel there."""
    state = scope["state"]
    client = scope.get("client")
    return {
        "at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "request_id": state["request_id"],
        "client": client[0] if client else None,
        "method": scope["method"],
        "path": scope["path"][:200],
        "status": status,
        "time_s": round(time_s, 6),
        "role": state.get("role"),
        "device_id": state.get("device_id"),
    }
