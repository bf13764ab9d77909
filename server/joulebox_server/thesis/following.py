"""Sweeps followed to their end, all of them with one question every few seconds."""

import time
from collections.abc import Callable
from typing import Any

from joulebox_server.cli.connection import CommandError, Connection, UnreachableError, checked

ENDED = ("done", "failed", "cancelled")
POLL_S = 2.0
PATIENCE = 20
"""So many unanswered questions in a row before the server is given up: it may be restarting."""


class Follower:
    """Waits for sweeps and tells how far they are.

    show    called with (finished, total, what is going on) whenever it changes
    check   raises when what the sweeps depend on has ended
    """

    def __init__(self, show: Callable[[int, int, str], None], check: Callable[[], None] = lambda: None) -> None:
        self._show, self._check = show, check

    def until_ended(
        self, connection: Connection, sweeps: dict[str, str], on_end: Callable[[str], None]
    ) -> dict[str, dict[str, Any]]:
        """The summaries of sweeps by name, once all have ended; `on_end` is told the name of each as it does."""
        told: set[str] = set()
        while True:
            summaries = self._asked(connection, set(sweeps.values()))
            found = {name: summaries[sweep_id] for name, sweep_id in sweeps.items()}
            for name in sweeps:
                if found[name]["state"] in ENDED and name not in told:
                    on_end(name)
                    told.add(name)
            doing = next((name for name, s in found.items() if s["jobs"]["leased"]), "")
            waiting = next((name for name, s in found.items() if s["state"] not in ENDED), "")
            self._show(
                sum(s["jobs"]["done"] + s["jobs"]["failed"] + s["jobs"]["cancelled"] for s in found.values()),
                sum(s["jobs"]["total"] for s in found.values()),
                doing or (f"{waiting}: comparing or waiting for a device" if waiting else "done"),
            )
            if all(s["state"] in ENDED for s in found.values()):
                return found
            time.sleep(POLL_S)

    def _asked(self, connection: Connection, wanted: set[str]) -> dict[str, dict[str, Any]]:
        """Summaries by id. Raises CommandError for a sweep that is gone, UnreachableError for a server that is."""
        for _ in range(PATIENCE - 1):
            self._check()
            try:
                return _summaries(connection, wanted)
            except UnreachableError:
                time.sleep(POLL_S)
        return _summaries(connection, wanted)


def _summaries(connection: Connection, wanted: set[str]) -> dict[str, dict[str, Any]]:
    """From the list, newest first: one question in place of one a sweep, every time."""
    found: dict[str, dict[str, Any]] = {}
    cursor: dict[str, str] = {}
    with connection.opened() as client:
        while True:
            page = checked(client.get("/v1/sweeps", params={"limit": 200, **cursor})).json()
            found |= {sweep["id"]: sweep for sweep in page["items"] if sweep["id"] in wanted}
            if len(found) == len(wanted):
                return found
            if page["next"] is None:
                raise CommandError("a sweep of this study was deleted from the server; start again in a new folder")
            cursor = {"cursor": page["next"]}
