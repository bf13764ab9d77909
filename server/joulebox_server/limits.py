"""The longest request body."""

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

STREAMED = ("/v1/blobs/", "/v1/scenes")
"""Bodies that are written to the disk as they come; `max_blob_bytes` holds for them."""


class BodyLimit:
    """ASGI middleware: reading more than `max_bytes` of a body raises a 413.

    Not FastAPI's own `max_body_size`, which answers in plain text and not in our one shape.
    """

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self._app = app
        self._max_bytes = max_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, counting what is read."""
        if scope["type"] != "http" or scope["path"].startswith(STREAMED):
            await self._app(scope, receive, send)
            return
        read_bytes = 0

        async def counted() -> Message:
            nonlocal read_bytes
            message = await receive()
            read_bytes += len(message.get("body", b""))
            if read_bytes > self._max_bytes:
                raise HTTPException(413, f"the body may have at most {self._max_bytes} bytes")
            return message

        await self._app(scope, counted, send)
