"""Reads a sweep file, and packs the scene folders that it names."""

import io
import json
import tomllib
import zipfile
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import httpx2

from joulebox_server.cli.connection import WrongUseError, checked
from joulebox_server.errors import InvalidError
from joulebox_server.plain_json import read_json

SCENE_FILE = "scene.xml"
LARGEST_FILE_BYTES = 16 << 20
ZIP_TIME = (1980, 1, 1, 0, 0, 0)
"""One time for every file, so that a folder always makes the same zip."""


def read_sweep(path: Path) -> dict[str, Any]:
    """The definition in a TOML or JSON file, as it stands there. Raises WrongUseError."""
    kind = "JSON" if path.suffix.lower() == ".json" else "TOML"
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE_BYTES + 1)
        text = content.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise WrongUseError(f"the sweep file {path} cannot be read: {error}") from None
    if len(content) > LARGEST_FILE_BYTES:
        raise WrongUseError(f"the sweep file {path} is larger than {LARGEST_FILE_BYTES >> 20} MiB")
    try:
        found = read_json(text) if kind == "JSON" else tomllib.loads(text)
    except RecursionError:
        raise WrongUseError(f"the sweep file {path} is nested too deeply") from None
    except (ValueError, InvalidError) as error:  # also of numbers with too many digits
        raise WrongUseError(f"the sweep file {path} is not valid {kind}: {error}") from None
    if not isinstance(found, dict):
        raise WrongUseError(f"the sweep file {path} must hold an object")
    try:
        json.dumps(found, allow_nan=False).encode()
    except (TypeError, ValueError, RecursionError):  # TOML's dates, NaN, half a character
        raise WrongUseError(
            f"the sweep file {path} may hold texts, finite numbers, true, false, lists and tables only"
        ) from None
    return found


def send_scenes(client: httpx2.Client, definition: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The definition with scene folders replaced by names, after sending each folder to the server.

    An entry is a folder when it (or its `path`) leads, from the sweep file's folder, to one with a scene.xml;
    else it names a scene that the server has.
    """
    scenes = definition.get("scenes")
    if not isinstance(scenes, list):
        return definition
    return definition | {"scenes": [_sent(client, entry, folder) for entry in scenes]}


def _sent(client: httpx2.Client, entry: Any, folder: Path) -> Any:
    fields = dict(entry) if isinstance(entry, dict) else {"name": entry}
    given = fields.pop("path", None)
    wanted = given if given is not None else fields.get("name")
    if not isinstance(wanted, str):
        return entry  # the server says what is wrong with it
    scene = folder / wanted
    if not (scene / SCENE_FILE).is_file():
        if given is not None or "/" in wanted or "\\" in wanted:
            raise WrongUseError(f"the scene folder {scene} does not exist or has no {SCENE_FILE}")
        return entry
    name = fields["name"] if given is not None and "name" in fields else scene.resolve().name
    content = pack_scene(scene)
    checked(client.post(f"/v1/scenes?{urlencode({'name': name})}", content=content))
    return fields | {"name": name}


def pack_scene(folder: Path) -> bytes:
    """A zip of a scene's folder, the same for the same files. Hidden files stay out.

    Raises WrongUseError for a file that cannot be read or a link that leads out of the folder.
    """
    out, root = io.BytesIO(), folder.resolve()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as bundle:
        for path in sorted(root.rglob("*")):
            relative = path.relative_to(root)
            if not path.is_file() or any(part.startswith(".") for part in relative.parts):
                continue
            if not path.resolve().is_relative_to(root):
                raise WrongUseError(f"{path} is a link that leads out of the scene's folder")
            info = zipfile.ZipInfo(relative.as_posix(), ZIP_TIME)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            try:
                bundle.writestr(info, path.read_bytes())
            except OSError as error:
                raise WrongUseError(f"{path} cannot be read: {error.strerror}") from None
    return out.getvalue()
