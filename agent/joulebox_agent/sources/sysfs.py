"""Reading small kernel files below a root that is an argument, so that a fake sensor is a directory."""

import errno
from pathlib import Path

from joulebox_agent.errors import UsageError

# ENODEV and ENODATA are a driver's way to say "this value is not known"; a missing file says the same.
SYSTEM_ROOT = Path("/sys")
UNKNOWN_ERRNOS = {errno.ENOENT, errno.ENOTDIR, errno.ENODEV, errno.ENODATA, errno.ENXIO, errno.EOPNOTSUPP}
LARGEST = 2**64  # no kernel value needs more bits, and a float holds it


class Sysfs:
    """Text and integer access to a sysfs tree.

    root  the folder that plays /sys (it contains `class/power_supply`); a machine without the real one is
          not Linux and has nothing to read, a given one must exist
    """

    def __init__(self, root: Path = SYSTEM_ROOT) -> None:
        if root != SYSTEM_ROOT and not root.is_dir():
            raise UsageError(f"The sysfs root {root} is not a directory; give the folder that contains class/.")
        self.root = root

    def text(self, path: Path) -> str:
        """The file's content without trailing white space. Raises OSError as the kernel does."""
        try:
            return path.read_text(errors="replace").strip()
        except OSError as error:  # an error of read(), unlike one of open(), does not name its file
            raise OSError(error.errno, error.strerror, str(path)) from error

    def value(self, path: Path) -> str | None:
        """Like `text`, None when file or value do not exist. Raises OSError for real faults (EIO)."""
        try:
            return self.text(path)
        except OSError as error:
            if error.errno in UNKNOWN_ERRNOS:
                return None
            raise

    def integer(self, path: Path) -> int | None:
        """The file as an integer; None when unknown or no kernel number. EIO is tried once more, then raised."""
        try:
            content = self.value(path)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            content = self.value(path)
        if content is None:
            return None
        try:
            number = int(content)
        except ValueError:
            return None
        return number if abs(number) < LARGEST else None

    def children(self, folder: Path) -> list[Path]:
        """Sorted entries of a folder, empty when it does not exist."""
        try:
            return sorted(folder.iterdir())
        except OSError:
            return []
