"""Runs added to a sweep to confirm what was predicted."""

from collections.abc import Sequence
from typing import Any

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, NotFoundError
from joulebox_server.store import sweeps
from joulebox_server.store.database import Row, number, row
from joulebox_server.store.ids import new_id
from joulebox_server.sweeps.expansion import added_configuration


def queue(db: Database, sweep_key: str, scene: str, device: str, settings: Sequence[dict[str, Any]]) -> int:
    """Add combinations of a sweep's axes to it, for one scene and device; returns how many jobs are new.

    Each is measured as often as every configuration of the sweep, with the same seeds. What the sweep holds
    already is not added again. Raises ConflictError when the sweep is cancelled.
    """
    sweep = sweeps.find(db, sweep_key)
    sweep_id = str(sweep["id"])
    if sweep["state"] == "cancelled":
        raise ConflictError(f"the sweep {sweep['name']!r} is cancelled; submit it again instead")
    definition = sweeps.definition_of(sweep)
    target, place = _target(db, sweep_id, device), _scene(db, sweep_id, scene)
    block = number(db, "SELECT max(block) FROM job WHERE sweep_id = ?", (sweep_id,)) + 1
    added = 0
    for position, given in enumerate(settings):
        configuration = added_configuration(definition, given)
        configuration_id = sweeps.add_configuration(db, sweep_id, configuration, "measure", -1)
        for repeat in range(definition.repeats):
            job = {
                "id": new_id(),
                "sweep_id": sweep_id,
                "target_id": target["id"],
                "sweep_scene_id": place["id"],
                "configuration_id": configuration_id,
                "purpose": "measure",
                "repeat": repeat,
                "seed": definition.base_seed + repeat,
                "block": block + repeat,
                "position": position,
                "state": "queued",
            }
            names = ", ".join(job)
            marks = ", ".join("?" * len(job))
            cursor = db.execute(f"INSERT OR IGNORE INTO job ({names}) VALUES ({marks})", tuple(job.values()))
            added += cursor.rowcount
    if added:
        sweeps.reopen(db, sweep_id)
    return added


def _target(db: Database, sweep_id: str, device: str) -> Row:
    for known in sweeps.target_devices(db, sweep_id):
        if known["name"] == device:
            return {"id": known["target_id"]}
    raise NotFoundError(f"no device named {device!r} works on this sweep")


def _scene(db: Database, sweep_id: str, label: str) -> Row:
    found = row(db, "SELECT id FROM sweep_scene WHERE sweep_id = ? AND label = ?", (sweep_id, label))
    if found is None:
        raise NotFoundError(f"this sweep has no scene {label!r}")
    return found
