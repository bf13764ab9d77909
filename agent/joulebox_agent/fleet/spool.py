"""Finished measurements on disk until the server has them.

One JSON file an attempt, and its blobs by hash: write, fsync, rename, so that a kill at any point leaves
either the whole entry or none. One bad file is set aside under bad/ and never blocks the others.
"""

import contextlib
import errno
import hashlib
import os
import shutil
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from joulebox_agent.errors import AgentError, SpoolFullError
from joulebox_agent.files import write_whole
from joulebox_agent.fleet.server import Id, Sha256

NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
ROOM_WANTED_BYTES = 64 * 2**20


class Entry(BaseModel):
    """One finished attempt: the measure document and the hashes of the blobs it names."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    attempt_id: Id
    document: dict[str, Any]
    blobs: tuple[Sha256, ...]


class BadEntryError(AgentError):
    """A spooled result that can never be sent as it is."""


class Spool:
    """A folder of entries. Blobs are kept once, however many entries name them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._blobs = folder / "blobs"
        self.bad = folder / "bad"
        for place in (self._blobs, self.bad):
            try:
                place.mkdir(mode=0o700, parents=True, exist_ok=True)
            except OSError as error:
                raise _full(place, error) from error

    def put(self, entry: Entry, blobs: dict[str, bytes]) -> None:
        """Stores an entry for good. Raises SpoolFullError when the disk is; nothing half is left behind."""
        try:
            for sha256, content in blobs.items():
                if not _holds(self._blobs / sha256, content):
                    write_whole(self._blobs / sha256, content)
            write_whole(self.folder / f"{entry.attempt_id}.json", entry.model_dump_json().encode())
        except OSError as error:
            raise _full(self.folder, error) from error

    def waiting(self) -> list[Path]:
        """Files of the entries, oldest first."""
        found = [path for path in self.folder.glob("*.json") if path.is_file()]
        return sorted(found, key=lambda path: (path.stat().st_mtime_ns, path.name))

    def read(self, path: Path) -> tuple[Entry, dict[str, bytes]]:
        """An entry with its blobs. Raises BadEntryError when a part is damaged or missing."""
        try:
            entry = Entry.model_validate_json(path.read_bytes())
        except ValidationError as error:
            raise BadEntryError(f"{path.name} is not a spooled result: {error.errors()[0]['msg']}") from error
        except OSError as error:
            raise BadEntryError(f"{path.name} cannot be read: {error.strerror}") from error
        return entry, {sha256: self._blob(sha256, path) for sha256 in entry.blobs}

    def _blob(self, sha256: str, path: Path) -> bytes:
        try:
            content = (self._blobs / sha256).read_bytes()
        except OSError as error:
            raise BadEntryError(
                f"{path.name} names a blob that cannot be read: {sha256[:12]}: {error.strerror}"
            ) from error
        if hashlib.sha256(content).hexdigest() != sha256:
            raise BadEntryError(f"{path.name} names a blob that is damaged: {sha256[:12]}")
        return content

    def done(self, path: Path) -> None:
        """Forgets an entry that the server has, and the blobs nobody else names."""
        path.unlink(missing_ok=True)
        self.sweep()

    def set_aside(self, path: Path, why: str) -> None:
        """Moves an entry to bad/ with a note that says why; its blobs stay for whoever looks into it."""
        os.replace(path, self.bad / path.name)
        # the note is a courtesy that a full disk may refuse: the reason is logged as well
        with contextlib.suppress(OSError):
            (self.bad / f"{path.stem}.why.txt").write_text(why + "\n", encoding="utf-8")

    def sweep(self) -> None:
        """Removes what a crash or a delivery left over: drafts, and blobs that no entry names."""
        for draft in [*self.folder.glob("*.draft"), *self._blobs.glob("*.draft")]:
            draft.unlink(missing_ok=True)
        entries = [*self.waiting(), *self.bad.glob("*.json")]
        text = b"".join(path.read_bytes() for path in entries if path.is_file())
        for blob in self._blobs.iterdir():
            if blob.name.encode() not in text:
                blob.unlink(missing_ok=True)

    def room(self) -> bool:
        """Whether a new result will likely fit."""
        return shutil.disk_usage(self.folder).free >= ROOM_WANTED_BYTES


def _holds(path: Path, content: bytes) -> bool:
    """Whether a file is there with these very bytes: one that was damaged must not spoil the next result too."""
    try:
        return path.read_bytes() == content
    except OSError:
        return False


def _full(place: Path, error: OSError) -> AgentError:
    if error.errno in NO_ROOM:
        return SpoolFullError(f"The disk of the spool {place} is full; free some space, the result is kept meanwhile.")
    return SpoolFullError(f"The spool {place} cannot be written to: {error.strerror}; the result is kept meanwhile.")
