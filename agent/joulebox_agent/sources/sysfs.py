"""Reading small kernel files below a root that is an argument, so that a fake sensor is a directory."""

import errno
import os
import re
from pathlib import Path

from joulebox_agent.errors import UsageError

SYSTEM_ROOT = Path("/sys")
# ENODEV, ENODATA and their like are a driver's way to say "this value is not known"; so is a file that is not there
# or a link that leads nowhere.
UNKNOWN_ERRNOS = {errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENODEV, errno.ENODATA, errno.ENXIO,
                  errno.EINVAL, errno.EOPNOTSUPP}  # fmt: skip
# What the file itself says cannot be used: it is closed to us, a folder, or holds no number. It will not be
# different the next time, so it voids no sample; whoever needs the value looks for another one.
UNUSABLE_ERRNOS = {errno.EACCES, errno.EPERM, errno.EISDIR, errno.EBADMSG}
PERMISSION_ERRNOS = {errno.EACCES, errno.EPERM}
LONGEST = 4096  # bytes; the kernel gives a page at most
LARGEST = 2**64  # no kernel value needs more bits, and a float holds it
SHOWN = 24  # characters of nonsense that a message repeats
NUMBER = re.compile(r"[+-]?[0-9]+", re.ASCII)
OPEN_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


class Sysfs:
    """Text and integer access to a sysfs tree.

    root  the folder that plays /sys (it contains `class/power_supply`); a machine without the real one is
          not Linux and has nothing to read, a given one must exist
    """

    def __init__(self, root: Path = SYSTEM_ROOT) -> None:
        if root != SYSTEM_ROOT and not root.is_dir():
            raise UsageError(f"The sysfs root {root} is not a directory; give the folder that contains class/.")
        self.root = root

    def lacks_classes(self) -> bool:
        """Whether the root is there but is no sysfs: perhaps the folder above the one that was meant."""
        return self.root.is_dir() and not (self.root / "class").is_dir()

    def text(self, path: Path) -> str:
        """The file's content without white space around it. Raises OSError as the kernel does.

        A page at most is read, and nothing is waited for: a pipe or a terminal in place of the file must
        not hang a measurement.
        """
        try:
            descriptor = os.open(path, OPEN_FLAGS)
            try:
                content = os.read(descriptor, LONGEST + 1)
            finally:
                os.close(descriptor)
        except OSError as error:  # an error of read(), unlike one of open(), does not name its file
            raise OSError(error.errno, error.strerror, str(path)) from error
        if len(content) > LONGEST:
            raise OSError(errno.EBADMSG, f"holds more than {LONGEST} bytes", str(path))
        return content.decode(errors="replace").strip()

    def value(self, path: Path) -> str | None:
        """Like `text`, None when file or value do not exist. A fault (EIO, a bus that times out) is tried
        once more, then raised."""
        try:
            return self.text(path)
        except OSError as error:
            if error.errno in UNKNOWN_ERRNOS:
                return None
            if error.errno in UNUSABLE_ERRNOS:
                raise
        try:
            return self.text(path)
        except OSError as error:
            if error.errno in UNKNOWN_ERRNOS:
                return None
            raise

    def integer(self, path: Path) -> int | None:
        """The file as an integer; None when the value is unknown.

        Raises OSError like `value`, and with EBADMSG for content that is no number of the kernel.
        """
        content = self.value(path)
        if content is None:
            return None
        if NUMBER.fullmatch(content) and len(content) <= len(str(LARGEST)) + 1 and abs(int(content)) < LARGEST:
            return int(content)
        shown = ascii(content[:SHOWN]) + ("..." if len(content) > SHOWN else "")
        raise OSError(errno.EBADMSG, f"holds {shown}, which is no number" if content else "is empty", str(path))

    def children(self, folder: Path) -> list[Path]:
        """Sorted entries of a folder, empty when it does not exist. Raises OSError when it may not be read."""
        try:
            return sorted(folder.iterdir())
        except OSError as error:
            if error.errno in UNKNOWN_ERRNOS:
                return []
            raise


def sentence(error: OSError) -> str:
    """`/sys/.../power_now: Input/output error`."""
    return f"{error.filename}: {error.strerror}"


def remedy_for_error(error: OSError) -> str:
    """What helps against an error of a kernel file, in one line."""
    if error.errno in PERMISSION_ERRNOS:
        mode = "a+rx" if error.filename and os.path.isdir(error.filename) else "a+r"
        return f"sudo chmod {mode} {error.filename}"
    return "check the battery's driver (sudo dmesg)" if error.errno else ""
