"""What happened, in order: the source of the event stream and of its Last-Event-ID."""

from typing import Any, Literal

from sqlite_utils import Database

from joulebox_server.store.database import Row, number, rows
from joulebox_server.store.ids import canonical, now_us

KEPT = 20_000
"""Older events are dropped; a client that was away longer reads the lists again."""

EventType = Literal["job", "sweep", "device", "difference"]


def add(db: Database, event_type: EventType, sweep_id: str | None, data: dict[str, Any]) -> None:
    """Record an event in the transaction of what it tells."""
    document = canonical({"sweep_id": sweep_id, **data})
    db.execute(
        "INSERT INTO event (type, sweep_id, data, at_us) VALUES (?, ?, ?, ?)",
        (event_type, sweep_id, document, now_us()),
    )


def after(db: Database, event_id: int, sweep_id: str | None, limit: int = 200) -> list[Row]:
    """Events later than `event_id`, oldest first; those of one sweep, or all."""
    if sweep_id is None:
        return rows(db, "SELECT * FROM event WHERE id > ? ORDER BY id LIMIT ?", (event_id, limit))
    return rows(
        db,
        "SELECT * FROM event WHERE id > ? AND (sweep_id = ? OR sweep_id IS NULL) ORDER BY id LIMIT ?",
        (event_id, sweep_id, limit),
    )


def newest_id(db: Database) -> int:
    """Id of the latest event, 0 before the first."""
    return number(db, "SELECT max(id) FROM event")


def trim(db: Database) -> None:
    """Drop all but the latest events."""
    db.execute("DELETE FROM event WHERE id <= ?", (newest_id(db) - KEPT,))
