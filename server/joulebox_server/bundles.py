"""Checks a scene bundle: a zip of a scene's folder that may come from anybody."""

import stat
import unicodedata
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from joulebox_server.errors import InvalidError, TooLargeError

SCENE_FILE = "scene.xml"
CHUNK_BYTES = 1 << 20
SYSTEM_UNIX = 3
ENCRYPTED = 0x1
PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""What every zip program makes and every device can unpack."""
UNKEPT = frozenset('<>:"|?*\\') | frozenset(map(chr, range(32)))
"""Characters that one system or another cannot keep in a file's name."""
LONGEST_NAME_BYTES = 255
UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, UnicodeDecodeError),
    *(OSError, IndexError),  # of an offset before the file's begin, of a name without a letter
)
"""What `zipfile` raises for bytes that are no zip."""


def check_bundle(path: Path, max_files: int, max_bytes: int) -> None:
    """Refuse what would escape its folder, fill a disk or is no scene.

    Every file is unpacked in passing, so that a size that the zip only claims cannot deceive.
    Raises InvalidError or TooLargeError with one sentence.
    """
    try:
        with zipfile.ZipFile(path) as bundle:
            files = [info for info in bundle.infolist() if not info.is_dir()]
            if len(files) > max_files:
                raise TooLargeError(f"the scene bundle has {len(files)} files, it may have at most {max_files}")
            _check_paths(bundle.infolist())
            _check_kinds(files)
            _check_names([info.filename for info in files])
            _check_contents(bundle, files, max_bytes)
    except UNREADABLE as error:
        raise InvalidError(f"the scene bundle is not a whole zip file: {str(error) or 'it ends too early'}") from None


def _check_paths(members: list[zipfile.ZipInfo]) -> None:
    for info in members:
        name = PurePosixPath(info.filename.replace("\\", "/"))
        if name.is_absolute() or ".." in name.parts or ":" in info.filename:
            raise InvalidError(f"the scene bundle has a path outside its folder: {info.filename!r}")


def _check_kinds(files: list[zipfile.ZipInfo]) -> None:
    for info in files:
        mode = info.external_attr >> 16
        if info.create_system == SYSTEM_UNIX and stat.S_IFMT(mode) not in (0, stat.S_IFREG):
            raise InvalidError(f"the scene bundle may hold plain files only, {info.filename!r} is none")
        if info.flag_bits & ENCRYPTED:
            raise InvalidError(f"the scene bundle is encrypted ({info.filename!r})")
        if info.compress_type not in PACKINGS:
            raise InvalidError(f"the scene bundle packs {info.filename!r} in a rare way; store or deflate it")


def _check_names(names: list[str]) -> None:
    """Each name means one file of its own on every system that a device may have."""
    for name in names:
        if str(PurePosixPath(name)) != name or not all(map(_can_be_kept, PurePosixPath(name).parts)):
            raise InvalidError(f"the scene bundle has a name that not every system can keep: {name[:100]!r}")
    known = {unicodedata.normalize("NFC", name).casefold() for name in names}
    folders = {str(folder) for name in known for folder in PurePosixPath(name).parents}
    if len(known) != len(names) or known & folders:
        raise InvalidError("the scene bundle has two files of one name, or a file and a folder")
    if SCENE_FILE not in names:
        raise InvalidError(f"the scene bundle has no {SCENE_FILE} at its top; zip the inside of the folder")


def _can_be_kept(part: str) -> bool:
    return len(part.encode()) <= LONGEST_NAME_BYTES and not UNKEPT & set(part) and part[-1] not in " ."


def _check_contents(bundle: zipfile.ZipFile, files: list[zipfile.ZipInfo], max_bytes: int) -> None:
    left = max_bytes
    for info in files:
        with bundle.open(info) as file:
            while chunk := file.read(CHUNK_BYTES):
                left -= len(chunk)
                if left < 0:
                    raise TooLargeError(f"the scene bundle unpacks to more than {max_bytes} bytes")
