"""Backup, and removal of what nothing uses."""

import os
import shutil
import sqlite3
import tempfile
import time
from pathlib import Path

from joulebox_server.store import blobs
from joulebox_server.store.database import Store, rows


def back_up(store: Store, folder: Path) -> int:
    """Copy the database (whole, at one moment) and the blobs it names; returns how many blobs were new.

    Blobs never change, so those that are in `folder` already stay. Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as draft:
        copy = Path(draft) / "joulebox.db"
        # A connection of its own: VACUUM cannot run inside the transaction of a read.
        connection = sqlite3.connect(store.path)
        try:
            connection.execute("VACUUM INTO ?", (str(copy),))
        finally:
            connection.close()
        copied = _copy_blobs(store, folder)
        os.replace(copy, folder / "joulebox.db")
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


def collect(store: Store, grace_s: float) -> int:
    """Remove blobs that nothing refers to and unfinished uploads, both older than `grace_s`; returns how many blobs."""
    before_s = time.time() - grace_s
    for path in store.incoming_dir.iterdir():
        if path.is_file() and path.stat().st_mtime < before_s:
            path.unlink(missing_ok=True)
    return store.write(blobs.collect, store.blob_dir, grace_s)
