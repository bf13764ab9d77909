"""Runs added to a sweep to confirm what was predicted."""

from collections.abc import Sequence

from sqlite_utils import Database

from joulebox_server.analysis.documents import Choice
from joulebox_server.errors import ConflictError, NotFoundError
from joulebox_server.store import sweeps
from joulebox_server.store.database import number, row, rows
from joulebox_server.store.ids import new_id
from joulebox_server.sweeps.expansion import added_configuration, repeat_seed


def queue(db: Database, sweep_key: str, scene: str, device: str, choices: Sequence[Choice]) -> int:
    """Add runs to a sweep for one scene and device; returns how many jobs are new.

    A combination of the sweep's axes that was never run is measured as often as every configuration of the sweep,
    with the sweep's seeds or its own, as the sweep has it; one that was measured is measured as often again, with new
    seeds. Nothing is added to what waits already, nor, where every repeat is compared with a reference of its own seed,
    to what was measured.
    Raises ConflictError when the sweep is cancelled.
    """
    sweep = sweeps.find(db, sweep_key)
    sweep_id = str(sweep["id"])
    if sweep["state"] == "cancelled":
        raise ConflictError(f"the sweep {sweep['name']!r} is cancelled; submit it again instead")
    definition = sweeps.definition_of(sweep)
    place = {"target_id": _target(db, sweep_id, device), "sweep_scene_id": _scene(db, sweep_id, scene)}
    block = number(db, "SELECT max(block) FROM job WHERE sweep_id = ?", (sweep_id,)) + 1
    added = 0
    for position, choice in enumerate(choices):
        configuration = added_configuration(definition, choice.settings)
        configuration_id = choice.configuration_id
        if configuration_id is None:
            configuration_id = sweeps.add_configuration(db, sweep_id, configuration, "measure", -1)
        first = _next_repeat(db, sweep_id, configuration_id, place)
        if first is None or (first > 0 and definition.reference.seed_policy == "same"):
            continue
        for repeat in range(first, first + definition.repeats):
            order = {"block": block + repeat - first, "position": position, "state": "queued"}
            identity = {"configuration_id": configuration_id, "purpose": "measure", "repeat": repeat}
            seed = repeat_seed(definition, configuration, repeat)
            db.table("job").insert({"id": new_id(), "sweep_id": sweep_id, **place, **identity, "seed": seed, **order})
            added += 1
    if added:
        sweeps.reopen(db, sweep_id)
    return added


def _next_repeat(db: Database, sweep_id: str, configuration_id: str, place: dict[str, str]) -> int | None:
    """The number of the first repeat that was not run; None while others of the configuration wait."""
    known = rows(
        db,
        """SELECT repeat, state FROM job WHERE sweep_id = ? AND configuration_id = ? AND target_id = ?
        AND sweep_scene_id = ? AND purpose = 'measure'""",
        (sweep_id, configuration_id, place["target_id"], place["sweep_scene_id"]),
    )
    if any(job["state"] in ("queued", "leased") for job in known):
        return None
    return 1 + max((int(job["repeat"]) for job in known), default=-1)


def _target(db: Database, sweep_id: str, device: str) -> str:
    for known in sweeps.target_devices(db, sweep_id):
        if known["name"] == device:
            return str(known["target_id"])
    raise NotFoundError(f"no device named {device!r} works on this sweep")


def _scene(db: Database, sweep_id: str, label: str) -> str:
    found = row(db, "SELECT id FROM sweep_scene WHERE sweep_id = ? AND label = ?", (sweep_id, label))
    if found is None:
        raise NotFoundError(f"this sweep has no scene {label!r}")
    return str(found["id"])
