"""Blobs: files named by the SHA-256 of their bytes, each with a row. They never change."""

import contextlib
import errno
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from sqlite_utils import Database

from joulebox_server.errors import DigestError, NotFoundError, StorageFullError, TooLargeError
from joulebox_server.store.database import number, row, rows
from joulebox_server.store.ids import MICRO, now_us

REFERENCED = """SELECT bundle_sha256 AS sha256 FROM scene
    UNION ALL SELECT image_sha256 FROM result UNION ALL SELECT samples_sha256 FROM result
    UNION ALL SELECT delta_sha256 FROM image_difference"""


class Incoming:
    """A blob on its way in: `with Incoming(...) as incoming: incoming.write(chunk)`, then `adopt`.

    What was not adopted is removed at the end of the block. A full disk raises StorageFullError, more than
    `max_bytes` TooLargeError.
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes
        self._hash = hashlib.sha256()
        self.size_bytes = 0

    def __enter__(self) -> Self:
        with disk():
            handle, name = tempfile.mkstemp(dir=self._folder)
        self.path = Path(name)
        self._file: IO[bytes] = os.fdopen(handle, "wb")
        return self

    def write(self, chunk: bytes) -> None:
        """Add bytes to the file."""
        self.size_bytes += len(chunk)
        if self.size_bytes > self._max_bytes:
            raise TooLargeError(f"a blob may have at most {self._max_bytes} bytes")
        self._hash.update(chunk)
        with disk():
            self._file.write(chunk)

    def finish(self) -> str:
        """Bring the file to the disk and close it; returns its SHA-256. Again: only that."""
        if not self._file.closed:
            with disk():
                self._file.flush()
                os.fsync(self._file.fileno())
                self._file.close()
        return self._hash.hexdigest()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        # Closing flushes: on a full disk it fails once more, with nothing left to save.
        with contextlib.suppress(OSError):
            self._file.close()
        self.path.unlink(missing_ok=True)


def path(folder: Path, sha256: str) -> Path:
    """Where a blob's file is, or would be."""
    return folder / sha256[:2] / sha256


def adopt(db: Database, folder: Path, incoming: Incoming, sha256: str) -> bool:
    """Give a finished file its name; False when the blob was there already.

    Runs on the writer thread, so that it cannot cross with `discard`. Raises DigestError.
    """
    found = incoming.finish()
    if found != sha256:
        raise DigestError(f"these bytes have the SHA-256 {found}, not {sha256}; send them again")
    if exists(db, folder, sha256):
        return False
    target = path(folder, sha256)
    with disk():
        target.parent.mkdir(exist_ok=True)
        os.replace(incoming.path, target)
    db.execute(
        "INSERT INTO blob (sha256, size_bytes, created_at_us) VALUES (?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
        (sha256, incoming.size_bytes, now_us()),
    )
    return True


def exists(db: Database, folder: Path, sha256: str) -> bool:
    """Whether a blob is here, row and file: one without the other (a crash between) counts as absent."""
    return row(db, "SELECT 1 FROM blob WHERE sha256 = ?", (sha256,)) is not None and path(folder, sha256).is_file()


def find(db: Database, folder: Path, sha256: str) -> Path:
    """The file of a blob. Raises NotFoundError."""
    if not exists(db, folder, sha256):
        raise NotFoundError(f"no blob {sha256} is stored here")
    return path(folder, sha256)


def discard(db: Database, folder: Path, candidates: Iterable[str | None]) -> int:
    """Remove those of `candidates` that nothing refers to any more; returns how many."""
    wanted = {sha256 for sha256 in candidates if sha256}
    kept = {found["sha256"] for found in rows(db, REFERENCED)} if wanted else set()
    for sha256 in wanted - kept:
        db.execute("DELETE FROM blob WHERE sha256 = ?", (sha256,))
        path(folder, sha256).unlink(missing_ok=True)
    return len(wanted - kept)


def collect(db: Database, folder: Path, grace_s: float) -> int:
    """Remove blobs older than `grace_s` that nothing refers to; returns how many."""
    before = now_us() - round(grace_s * MICRO)
    old = rows(db, "SELECT sha256 FROM blob WHERE created_at_us < ?", (before,))
    return discard(db, folder, [found["sha256"] for found in old])


def total_bytes(db: Database) -> int:
    """Bytes of all blobs."""
    return number(db, "SELECT sum(size_bytes) FROM blob")


@contextlib.contextmanager
def disk() -> Iterator[None]:
    """Turn a full disk into StorageFullError."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise StorageFullError("the server's disk is full; free some space and send it again") from error
        raise
