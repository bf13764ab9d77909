"""Checks a scene bundle: a zip of a scene's folder that may come from anybody."""

import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from joulebox_server.errors import InvalidError, TooLargeError

SCENE_FILE = "scene.xml"
CHUNK_BYTES = 1 << 20
SYSTEM_UNIX = 3
ENCRYPTED = 0x1


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
            _check_names(files)
            _check_contents(bundle, files, max_bytes)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, UnicodeDecodeError) as error:
        raise InvalidError(f"the scene bundle is not a whole zip file: {error}") from None


def _check_names(files: list[zipfile.ZipInfo]) -> None:
    names = [info.filename for info in files]
    for info in files:
        name = PurePosixPath(info.filename.replace("\\", "/"))
        if name.is_absolute() or ".." in name.parts or ":" in info.filename or "\x00" in info.filename:
            raise InvalidError(f"the scene bundle has a path outside its folder: {info.filename!r}")
        mode = info.external_attr >> 16
        if info.create_system == SYSTEM_UNIX and stat.S_IFMT(mode) not in (0, stat.S_IFREG):
            raise InvalidError(f"the scene bundle may hold plain files only, {info.filename!r} is none")
        if info.flag_bits & ENCRYPTED:
            raise InvalidError(f"the scene bundle is encrypted ({info.filename!r})")
    known = {name.lower() for name in names}
    folders = {str(folder) for name in known for folder in PurePosixPath(name).parents}
    if len(known) != len(names) or known & folders:
        raise InvalidError("the scene bundle has two files of one name, or a file and a folder")
    if SCENE_FILE not in names:
        raise InvalidError(f"the scene bundle has no {SCENE_FILE} at its top; zip the inside of the folder")


def _check_contents(bundle: zipfile.ZipFile, files: list[zipfile.ZipInfo], max_bytes: int) -> None:
    left = max_bytes
    for info in files:
        with bundle.open(info) as file:
            while chunk := file.read(CHUNK_BYTES):
                left -= len(chunk)
                if left < 0:
                    raise TooLargeError(f"the scene bundle unpacks to more than {max_bytes} bytes")
