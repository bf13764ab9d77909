"""Backup and its way back, and removal of what nothing uses."""

import hashlib
import os
import shutil
import sqlite3
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from joulebox_server.errors import ConflictError, InvalidError
from joulebox_server.store import blobs
from joulebox_server.store.database import DATABASE, Store, rows


def back_up(store: Store, folder: Path) -> int:
    """Copy the database (whole, at one moment) and the blobs it names; returns how many blobs were new.

    Blobs never change, so those that are in `folder` already stay. Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as draft:
        copy = Path(draft) / DATABASE
        # A connection of its own: VACUUM cannot run inside the transaction of a read.
        connection = sqlite3.connect(store.path)
        try:
            connection.execute("VACUUM INTO ?", (str(copy),))
        finally:
            connection.close()
        copied = _copy_blobs(store, folder)
        os.replace(copy, folder / DATABASE)
    return copied


def _copy_blobs(store: Store, folder: Path) -> int:
    copied = 0
    for found in store.read(rows, "SELECT sha256 FROM blob"):
        source = blobs.path(store.blob_dir, found["sha256"])
        target = blobs.path(folder / "blobs", found["sha256"])
        if target.is_file() or not source.is_file():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        draft = target.with_suffix(".part")
        shutil.copyfile(source, draft)
        draft.replace(target)
        copied += 1
    return copied


@dataclass(frozen=True)
class Restored:
    """How many blobs came back, and the SHA-256 of those that the database names and the backup lacks."""

    blobs: int
    missing: list[str]


def restore(folder: Path, data_dir: Path) -> Restored:
    """Copy a backup into `data_dir`, checked before anything is in place: the database whole, each blob's hash.

    Raises InvalidError when `folder` is no whole backup, ConflictError when `data_dir` holds data already,
    OSError.
    """
    source = folder / DATABASE
    if not source.is_file():
        raise InvalidError(f"{folder} holds no {DATABASE}; give the folder that `joulebox backup` filled")
    if (data_dir / DATABASE).exists():
        raise ConflictError(f"{data_dir} holds a server's data already; restore into an empty folder")
    data_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=data_dir) as draft:
        copy = Path(draft) / DATABASE
        shutil.copyfile(source, copy)
        named = _blobs_of(copy)
        copied = [sha256 for sha256 in named if _bring_back(folder, data_dir, sha256)]
        os.replace(copy, data_dir / DATABASE)  # last: without it the folder is no server's
    return Restored(len(copied), sorted(set(named) - set(copied)))


def _blobs_of(database: Path) -> list[str]:
    connection = sqlite3.connect(database)
    try:
        fault = connection.execute("PRAGMA integrity_check").fetchone()[0]
        if fault != "ok":
            raise InvalidError(f"the database of the backup is damaged: {fault}")
        return [sha256 for (sha256,) in connection.execute("SELECT sha256 FROM blob")]
    except sqlite3.DatabaseError as error:
        raise InvalidError(f"the database of the backup is damaged: {error}") from None
    finally:
        connection.close()


def _bring_back(folder: Path, data_dir: Path, sha256: str) -> bool:
    """Copy a blob if it is there whole; a damaged one is as good as none."""
    source, target = (blobs.path(place / "blobs", sha256) for place in (folder, data_dir))
    if not source.is_file():
        return False
    with source.open("rb") as file:
        if hashlib.file_digest(file, "sha256").hexdigest() != sha256:
            return False
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
    return True


def collect(store: Store, grace_s: float) -> int:
    """Remove blobs that nothing refers to and unfinished uploads, both older than `grace_s`; returns how many blobs."""
    before_s = time.time() - grace_s
    for path in store.incoming_dir.iterdir():
        if path.is_file() and path.stat().st_mtime < before_s:
            path.unlink(missing_ok=True)
    return store.write(blobs.collect, store.blob_dir, grace_s)
