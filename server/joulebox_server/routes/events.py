"""The stream of events."""

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query
from fastapi.sse import EventSourceResponse, ServerSentEvent
from sqlite_utils import Database

from joulebox_server.problems import told
from joulebox_server.services import ServicesOf, Viewer
from joulebox_server.store import events, sweeps

BATCH = 200
LOOK_AGAIN_S = 10.0

router = APIRouter(tags=["events"])


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


@router.get("/events", response_class=EventSourceResponse, responses=told(404, 409))
async def stream(services: ServicesOf, start: Start) -> AsyncIterator[ServerSentEvent]:
    """Events `job`, `sweep`, `device`, `difference` as they happen, or since Last-Event-ID; of one sweep or all."""
    sweep_id, seen = start
    yield ServerSentEvent(comment="joulebox")
    while not services.bell.closed:
        heard = services.bell.heard
        found = await services.read(events.after, seen, sweep_id, BATCH)
        for event in found:
            seen = int(event["id"])
            yield ServerSentEvent(raw_data=event["data"], event=event["type"], id=str(seen))
        if len(found) < BATCH:
            await services.bell.wait(heard, LOOK_AGAIN_S)
