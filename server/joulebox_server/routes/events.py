"""The stream of events."""

from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import Depends, Header, Query
from fastapi.responses import StreamingResponse
from sqlite_utils import Database

from joulebox_server.problems import told
from joulebox_server.routes.versioned import versioned
from joulebox_server.services import Services, ServicesOf, Viewer
from joulebox_server.store import events, sweeps
from joulebox_server.store.database import Row

ALIVE_S = 15.0
"""After so long without an event a comment shows that the stream is alive."""
STREAM: dict[str, Any] = {
    "content": {"text/event-stream": {"schema": {"type": "string"}}},
    "description": "Events until the server ends: `id`, `event` and `data`, a JSON document.",
}

router = versioned("events")


async def _start(
    services: ServicesOf,
    _: Viewer,
    sweep: Annotated[str | None, Query(max_length=200)] = None,
    last_event_id: Annotated[int | None, Header(ge=0)] = None,
) -> tuple[str | None, int]:
    """The sweep to watch, and the event to go on after. A dependency: its errors come before the stream."""

    def found(db: Database) -> tuple[str | None, int]:
        sweep_id = None if sweep is None else str(sweeps.find(db, sweep)["id"])
        newest = events.newest_id(db)
        return sweep_id, newest if last_event_id is None else min(last_event_id, newest)

    return await services.read(found)


Start = Annotated[tuple[str | None, int], Depends(_start)]


class EventStream(StreamingResponse):
    """Server-sent events. Not FastAPI's own, which logs a fault of the server for every reader that leaves."""

    media_type = "text/event-stream"


@router.get("/events", response_class=EventStream, responses={200: STREAM, **told(404, 409)})
async def stream(services: ServicesOf, start: Start) -> EventStream:
    """Events `job`, `sweep`, `device`, `difference` as they happen, or since Last-Event-ID; of one sweep or all."""
    return EventStream(_frames(services, *start), headers={"Cache-Control": "no-cache", "X-Accel-Buffering": "no"})


async def _frames(services: Services, sweep_id: str | None, seen: int) -> AsyncIterator[bytes]:
    yield b": joulebox\n\n"
    while not services.bell.closed:
        seen, found = await services.feed.after(seen, sweep_id, ALIVE_S)
        yield b"".join(map(_frame, found)) or b": alive\n\n"


def _frame(event: Row) -> bytes:
    return f"event: {event['type']}\ndata: {event['data']}\nid: {event['id']}\n\n".encode()
