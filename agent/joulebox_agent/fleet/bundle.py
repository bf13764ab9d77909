"""Scene bundles: zips from the server, checked, unpacked below a cache keyed by their hash."""

import hashlib
import re
import shutil
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from joulebox_agent.errors import BundleError
from joulebox_agent.fleet.server import Server

LARGEST_SCENE_BYTES = 2 * 2**30
MOST_FILES = 10_000
SAFE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
OTHER_NAME = "scene"
"""The folder of a scene whose name is no safe one for a folder: with spaces, in other scripts."""


class SceneCache:
    """Unpacked scenes: folder/<sha256>/<scene name>/scene.xml."""

    def __init__(self, folder: Path, server: Server) -> None:
        self._folder = folder
        self._server = server

    def fetch(self, name: str, sha256: str) -> Path:
        """The folder of the scene, fetched unless it is there.

        Raises BundleError when the bundle is unsafe or not what its hash says, server errors, and OSError.
        """
        folder = name if SAFE_NAME.fullmatch(name) else OTHER_NAME
        target = self._folder / sha256 / folder
        if target.is_dir():
            return target
        draft = self._folder / f"{sha256}.draft"
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir(parents=True)
        try:
            archive = draft / "bundle.zip"
            self._server.download(sha256, archive)
            with archive.open("rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != sha256:
                    raise BundleError(f"The bundle of scene {name} does not have its hash {sha256[:12]}.")
            unpack(archive, draft / folder)
            target.parent.mkdir(exist_ok=True)
            (draft / folder).rename(target)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
        return target


def unpack(archive: Path, folder: Path) -> None:
    """Unpacks a scene's zip into a new folder. Raises BundleError for anything that reaches outside of it,
    links, too many or too large files, or a zip without scene.xml on top."""
    try:
        with zipfile.ZipFile(archive) as bundle:
            members = [member for member in bundle.infolist() if not member.is_dir()]
            _check_members(members)
            folder.mkdir()
            left = LARGEST_SCENE_BYTES
            for member in members:
                left -= _extract(bundle, member, folder, left)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise BundleError(f"The scene bundle is not a readable zip: {error}.") from error
    if not (folder / "scene.xml").is_file():
        raise BundleError("The scene bundle has no scene.xml at its top.")


def _check_members(members: list[zipfile.ZipInfo]) -> None:
    if len(members) > MOST_FILES:
        raise BundleError(f"The scene bundle holds {len(members)} files; {MOST_FILES} are allowed.")
    if sum(member.file_size for member in members) > LARGEST_SCENE_BYTES:
        raise BundleError("The scene bundle unpacks to more than 2 GiB.")
    for member in members:
        path = PurePosixPath(member.filename)
        unsafe = path.is_absolute() or ".." in path.parts or "\\" in member.filename or ":" in member.filename
        if unsafe or stat.S_ISLNK(member.external_attr >> 16):
            raise BundleError(f"The scene bundle holds {member.filename!r}, which is outside of it or a link.")


def _extract(bundle: zipfile.ZipFile, member: zipfile.ZipInfo, folder: Path, left: int) -> int:
    """Writes one file and returns its true size: a zip's own headers may lie about it."""
    target = folder / member.filename
    target.parent.mkdir(parents=True, exist_ok=True)
    size = 0
    with bundle.open(member) as source, target.open("wb") as file:
        while chunk := source.read(2**20):
            size += len(chunk)
            if size > left:
                raise BundleError("The scene bundle unpacks to more than 2 GiB.")
            file.write(chunk)
    return size
