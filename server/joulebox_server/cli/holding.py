"""One server a data folder: two would each wake the devices that wait with the other one, and share an address file."""

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from joulebox_server.cli.connection import ADDRESS_FILE, CommandError

LOCK_FILE = "server.lock"


@contextmanager
def held(data_dir: Path) -> Iterator[None]:
    """Holds a data folder for one server; however the process ends, the system lets go of it.

    Raises CommandError when another server holds it or the folder cannot be used.
    """
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        file = (data_dir / LOCK_FILE).open("a")
    except OSError as error:
        raise CommandError(f"the data folder {data_dir} cannot be used: {error}") from None
    with file:
        if not _try_lock(file.fileno()):
            raise CommandError(
                f"another server{_address(data_dir)} uses the data folder {data_dir}; stop it or give another --data"
            )
        yield


def _address(data_dir: Path) -> str:
    try:
        return f" at {json.loads((data_dir / ADDRESS_FILE).read_text())['url']}"
    except (OSError, ValueError, KeyError, TypeError):  # it starts just now
        return ""


if sys.platform == "win32":
    import msvcrt

    def _try_lock(descriptor: int) -> bool:
        os.lseek(descriptor, 0, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:
    import fcntl

    def _try_lock(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True
