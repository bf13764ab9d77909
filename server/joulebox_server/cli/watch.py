"""Follows a sweep: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from joulebox_server.cli.connection import CommandError, Connection, UnreachableError, named

ENDED = ("done", "failed", "cancelled")
POLL_S = 1.0
PATIENCE = 20
"""So many unanswered questions in a row before the server is given up: it may be restarting."""


def watch_sweep(connection: Connection, sweep: str, timeout_s: float | None, *, quiet: bool) -> dict[str, Any]:
    """The sweep's summary once it ended. Raises CommandError when `timeout_s` pass before."""
    ends_s = None if timeout_s is None else time.monotonic() + timeout_s
    found: dict[str, Any] = connection.json("GET", f"/sweeps/{named(sweep)}")
    on_terminal = sys.stderr.isatty() and not quiet
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not on_terminal) as progress:
        task = progress.add_task(str(found["name"]), total=_total(found))
        last = ""
        while True:
            progress.update(task, completed=_finished(found), total=_total(found), description=_doing(found))
            line = f"{found['name']}: {_doing(found)}, {_finished(found)} of {_total(found)}"
            if not on_terminal and not quiet and line != last:
                typer.echo(line)
                last = line
            if found["state"] in ENDED:
                return found
            if ends_s is not None and time.monotonic() + POLL_S > ends_s:
                raise CommandError(
                    f"the sweep {found['name']!r} is still {found['state']} after {timeout_s:g} s "
                    f"({_finished(found)} of {_total(found)} steps); it goes on"
                )
            time.sleep(POLL_S)
            found = _asked_again(connection, str(found["id"]))


def _asked_again(connection: Connection, sweep_id: str) -> dict[str, Any]:
    for _ in range(PATIENCE - 1):
        try:
            return dict(connection.json("GET", f"/sweeps/{sweep_id}"))
        except UnreachableError:
            time.sleep(POLL_S)
    return dict(connection.json("GET", f"/sweeps/{sweep_id}"))


def _total(found: dict[str, Any]) -> int:
    return int(found["jobs"]["total"] + found["differences_pending"])


def _finished(found: dict[str, Any]) -> int:
    jobs = found["jobs"]
    return int(jobs["done"] + jobs["failed"] + jobs["cancelled"])


def _doing(found: dict[str, Any]) -> str:
    if found["state"] != "running":
        return str(found["state"])
    if found["jobs"]["leased"]:
        return "measuring"
    if found["jobs"]["queued"]:
        return "waiting for a device"
    return "comparing pictures"
