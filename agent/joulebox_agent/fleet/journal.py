"""What the agent says of itself: a sentence for a person or a record for a program, and what it does just now."""

import contextlib
import json
import os
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from joulebox_agent.measuring.progress import Lines

Level = Literal["info", "warning"]
Write = Callable[[dict[str, Any]], None]


def as_text(record: dict[str, Any]) -> None:
    """The sentence alone: whoever keeps it (the systemd journal) knows when it came."""
    print(record["message"], file=sys.stderr, flush=True)


def as_json_line(record: dict[str, Any]) -> None:
    """The whole record as one line."""
    print(json.dumps(record), flush=True)


class Journal:
    """Records {time, level, event, message, ...ids}; never a token, a header or a body.

    doing  the file that tells `status` what the agent does now; None: nobody asks
    """

    def __init__(self, write: Write, doing: Path | None = None) -> None:
        self._write, self._doing = write, doing
        self._lasting = ""

    def say(self, event: str, message: str, level: Level = "info", **ids: str) -> None:
        """Something happened."""
        self._write({"time": _now(), "level": level, "event": event, "message": message, **ids})

    def lasts(self, event: str, message: str, level: Level = "info", quiet: bool = False, **ids: str) -> None:
        """A state began: it is written down for `status` and said once, however often it is found to last.

        quiet  for `status` only: a state that is so ordinary that a log of days should not be full of it
        """
        if message == self._lasting:
            return
        self._lasting = message
        if not quiet:
            self.say(event, message, level, **ids)
        if self._doing is not None:
            # a courtesy that a full disk may refuse
            with contextlib.suppress(OSError):
                draft = self._doing.with_suffix(".draft")
                draft.write_text(json.dumps({"since": _now(), "event": event, "message": message}), encoding="utf-8")
                os.replace(draft, self._doing)


def doing_now(file: Path) -> dict[str, str] | None:
    """{since, event, message} as last written down; None when there is nothing that can be read."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else None


class Told(Lines):
    """The news of a measurement as records."""

    def __init__(self, journal: Journal) -> None:
        super().__init__()
        self._journal = journal

    def note(self, text: str) -> None:
        self._journal.say("measuring", text)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
