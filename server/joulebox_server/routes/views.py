"""What the dashboard shows beside the documents themselves: the state of devices, when a sweep ends, a pasted file."""

import json
import tomllib
from pathlib import PurePosixPath
from typing import Annotated, Any

from fastapi import Body
from sqlite_utils import Database

from joulebox_server.errors import InvalidError
from joulebox_server.plain_json import read_json
from joulebox_server.problems import told
from joulebox_server.routes.paging import Key, Limit, NameCursor, page
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.views import FleetPage, Progress, ReadSweep
from joulebox_server.services import Operator, ServicesOf, Viewer
from joulebox_server.store import fleet, progress, scenes

MOST_SCENES = 1000
Text = Annotated[str, Body(media_type="text/plain", max_length=1_000_000)]

router = versioned("views")


@router.get("/fleet", response_model=FleetPage)
def list_fleet(services: ServicesOf, _: Viewer, limit: Limit = 100, cursor: NameCursor = None) -> dict[str, Any]:
    """Battery, meter and last control run of every device, as its last results tell, by name."""
    return page(services.store.read(fleet.listed, limit + 1, cursor), limit, "device")


@router.get("/sweeps/{sweep}/progress", response_model=Progress, responses=told(404, 409))
def get_progress(services: ServicesOf, _: Viewer, sweep: Key) -> dict[str, Any]:
    """When a sweep began, when it moved last, and when its end is expected."""
    return services.store.read(progress.progress, sweep, services.clock())


@router.post("/sweeps:read", response_model=ReadSweep, responses=told(413))
def read_sweep(services: ServicesOf, _: Operator, text: Text = "") -> dict[str, Any]:
    """A pasted sweep file, TOML or JSON, as the definition that `POST /sweeps` takes; makes nothing.

    Scenes that the file names by folder become those of the folder's name, where the server has one: the folder
    itself is on another machine.
    """
    definition = _parsed(text)
    known = {str(scene["name"]) for scene in services.store.read(_scenes)}
    told_scenes: list[str] = []
    if isinstance(definition.get("scenes"), list):
        definition["scenes"] = [_by_name(entry, known, told_scenes) for entry in definition["scenes"]]
    return {"definition": definition, "notes": told_scenes}


def _scenes(db: Database) -> list[dict[str, Any]]:
    return scenes.listed(db, MOST_SCENES, None)


def _parsed(text: str) -> dict[str, Any]:
    as_json = text.lstrip().startswith("{")
    try:
        found = read_json(text) if as_json else tomllib.loads(text)
    except (json.JSONDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise InvalidError(f"this is not valid {'JSON' if as_json else 'TOML'}: {error}") from None
    if not found:
        raise InvalidError("this holds nothing; paste a sweep file with at least a name and scenes")
    return dict(found)


def _by_name(entry: Any, known: set[str], notes: list[str]) -> Any:
    """An entry with its folder replaced by the scene of the folder's name; others as they are."""
    fields = dict(entry) if isinstance(entry, dict) else {"name": entry}
    wanted = fields.get("path", fields.get("name"))
    if not isinstance(wanted, str) or (wanted in known and "path" not in fields):
        return entry
    name = PurePosixPath(wanted.replace("\\", "/")).name
    if name not in known:
        return entry
    fields.pop("path", None)
    notes.append(f"{wanted} is taken to be the scene {name} that this server has")
    return fields | {"name": name}
