"""Sweeps: making one with all its jobs, its state, lists of it."""

import json
from pathlib import Path
from typing import Any, Literal

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, NotFoundError
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.store import blobs, devices, events, life, scenes
from joulebox_server.store.database import Row, check_match, number, row, rows
from joulebox_server.store.ids import canonical, new_id, now_us, sha256_text, timestamp
from joulebox_server.store.life import JOB_STATES, Event
from joulebox_server.sweeps.expansion import Configuration, configurations, plan_jobs, reference_configuration

ENDED = ("cancelled", "done", "failed")
Action = Literal["pause", "resume", "cancel"]


def create(db: Database, definition: SweepDefinition) -> str:
    """Store a checked sweep and all its jobs; returns its id. Raises NotFoundError for a scene or device."""
    sweep_id, at_us = new_id(), now_us()
    db.execute(
        "INSERT INTO sweep (id, name, state, definition, created_at_us) VALUES (?, ?, 'running', ?, ?)",
        (sweep_id, definition.name, canonical(definition.model_dump(mode="json")), at_us),
    )
    scene_ids = [_add_scene(db, sweep_id, definition, position) for position in range(len(definition.scenes))]
    measured, reference = configurations(definition), reference_configuration(definition)
    configuration_ids = [
        add_configuration(db, sweep_id, configuration, "measure", position)
        for position, configuration in enumerate(measured)
    ]
    configuration_ids.append(add_configuration(db, sweep_id, reference, "reference", -1))
    for position, target_id in enumerate(_add_targets(db, sweep_id, definition)):
        jobs = plan_jobs(definition, measured, reference, f"{sweep_id}/{position}")
        for job in jobs:
            db.execute(
                """INSERT INTO job (id, sweep_id, target_id, sweep_scene_id, configuration_id, purpose, repeat,
                seed, block, position, metered, state) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, 'queued')""",
                (
                    new_id(),
                    sweep_id,
                    target_id,
                    scene_ids[job.scene],
                    configuration_ids[job.configuration],
                    job.purpose,
                    job.repeat,
                    job.seed,
                    job.block,
                    job.position,
                    job.metered,
                ),
            )
    _announce(db, sweep_id, "running")
    return sweep_id


def _add_scene(db: Database, sweep_id: str, definition: SweepDefinition, position: int) -> str:
    entry = definition.scenes[position]
    scene, entry_id = scenes.find(db, entry.name), new_id()
    db.execute(
        "INSERT INTO sweep_scene (id, sweep_id, label, scene_id, defines, position) VALUES (?, ?, ?, ?, ?, ?)",
        (entry_id, sweep_id, entry.label, scene["id"], canonical(entry.defines), position),
    )
    return entry_id


def add_configuration(db: Database, sweep_id: str, configuration: Configuration, purpose: str, position: int) -> str:
    """Make a configuration one of a sweep's, once; returns its id."""
    digest = sha256_text(configuration.key)
    db.execute(
        "INSERT INTO configuration (id, sha256, settings) VALUES (?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
        (new_id(), digest, configuration.key),
    )
    found = row(db, "SELECT id FROM configuration WHERE sha256 = ?", (digest,))
    assert found is not None
    db.execute(
        """INSERT INTO sweep_configuration (sweep_id, configuration_id, purpose, changed, position)
        VALUES (?, ?, ?, ?, ?) ON CONFLICT DO NOTHING""",
        (sweep_id, found["id"], purpose, canonical(configuration.changed), position),
    )
    return str(found["id"])


def _add_targets(db: Database, sweep_id: str, definition: SweepDefinition) -> list[str]:
    requires = definition.requires_text
    named: list[str] | list[None] = definition.devices or [None]
    device_ids = [None if name is None else str(devices.find(db, name)["id"]) for name in named]
    target_ids = []
    for position, device_id in enumerate(dict.fromkeys(device_ids)):
        target_ids.append(new_id())
        db.execute(
            "INSERT INTO target (id, sweep_id, device_id, requires, position) VALUES (?, ?, ?, ?, ?)",
            (target_ids[-1], sweep_id, device_id, requires, position),
        )
    return target_ids


def find(db: Database, sweep_id: str) -> Row:
    """A sweep by id, or by name when only one has it. Raises NotFoundError, ConflictError."""
    found = row(db, "SELECT * FROM sweep WHERE id = ?", (sweep_id,))
    if found is not None:
        return found
    named = rows(db, "SELECT * FROM sweep WHERE name = ? LIMIT 2", (sweep_id,))
    if not named:
        raise NotFoundError(f"no sweep has the id or name {sweep_id!r}; `joulebox sweep list` shows all")
    if len(named) > 1:
        raise ConflictError(f"several sweeps are named {sweep_id!r}; give the id, `joulebox sweep list` shows it")
    return named[0]


def summary(db: Database, sweep: Row) -> dict[str, Any]:
    """A sweep as lists show it."""
    sweep_id = sweep["id"]
    found = rows(db, "SELECT state, count(*) AS n FROM job WHERE sweep_id = ? GROUP BY state", (sweep_id,))
    counts = dict.fromkeys(JOB_STATES, 0) | {str(count["state"]): int(count["n"]) for count in found}
    return {
        "id": sweep_id,
        "name": sweep["name"],
        "state": sweep["state"],
        "created_at": timestamp(sweep["created_at_us"]),
        "jobs": {"total": sum(counts.values()), **counts},
        "differences_pending": pending_differences(db, sweep_id),
        "scenes": scene_labels(db, sweep_id),
        "devices": [str(device["name"]) for device in target_devices(db, sweep_id)],
    }


def listed(db: Database, limit: int, cursor: str | None) -> list[dict[str, Any]]:
    """Summaries, the newest first; those older than the sweep `cursor`."""
    found = rows(db, "SELECT * FROM sweep WHERE id < ? ORDER BY id DESC LIMIT ?", (cursor or "~", limit))
    return [summary(db, sweep) for sweep in found]


def scene_labels(db: Database, sweep_id: str) -> list[str]:
    """The scenes of a sweep, as its tradeoffs name them."""
    found = rows(db, "SELECT label FROM sweep_scene WHERE sweep_id = ? ORDER BY position", (sweep_id,))
    return [str(scene["label"]) for scene in found]


def target_devices(db: Database, sweep_id: str) -> list[Row]:
    """The devices of a sweep that are known so far: `id`, `name`, `target_id`."""
    return rows(
        db,
        """SELECT device.id, device.name, target.id AS target_id FROM target
        JOIN device ON device.id = target.device_id WHERE sweep_id = ? ORDER BY target.position""",
        (sweep_id,),
    )


def controls(db: Database, sweep_id: str) -> list[dict[str, Any]]:
    """The control runs of each scene and device, each beside the first: how far the device drifted."""
    found = rows(
        db,
        """SELECT label, device.name AS device, time_ratio, energy_ratio FROM control_run
        JOIN sweep_scene ON sweep_scene.id = sweep_scene_id JOIN target ON target.id = control_run.target_id
        JOIN device ON device.id = target.device_id
        WHERE control_run.sweep_id = ? ORDER BY target.position, sweep_scene.position, control_run.result_id""",
        (sweep_id,),
    )
    series: dict[tuple[str, str], dict[str, Any]] = {}
    for run in found:
        key = (str(run["label"]), str(run["device"]))
        empty = {"scene": key[0], "device": key[1], "time_ratios": [], "energy_ratios": []}
        own = series.setdefault(key, empty)
        own["time_ratios"].append(run["time_ratio"])
        own["energy_ratios"].append(run["energy_ratio"])
    return list(series.values())


def pending_differences(db: Database, sweep_id: str) -> int:
    """Comparisons of a sweep that are not finished."""
    return number(
        db,
        """SELECT count(*) FROM comparison JOIN image_difference AS d ON d.id = comparison.difference_id
        WHERE comparison.sweep_id = ? AND d.state = 'pending'""",
        (sweep_id,),
    )


def act(db: Database, key: str, action: Action, wanted: str | None = None) -> str:
    """Pause, resume or cancel; returns the id. Raises ConflictError when the sweep has ended.

    wanted  the If-Match header: PreconditionError unless it names the sweep's state
    """
    sweep = find(db, key)
    check_match(wanted, sweep["version"], f"the sweep {sweep['name']!r}")
    sweep_id, state = str(sweep["id"]), sweep["state"]
    if state in ENDED:
        raise ConflictError(f"the sweep {sweep['name']!r} is {state}; it can no longer be {_past(action)}")
    if action == "cancel":
        _move_jobs(db, sweep_id, Event.CANCEL)
    wanted = {"pause": "paused", "resume": "running", "cancel": "cancelled"}[action]
    if wanted != state:
        _set_state(db, sweep_id, wanted)
    settle(db, sweep_id)
    return sweep_id


def retry_failed(db: Database, key: str) -> tuple[str, int]:
    """Queue every failed job of a sweep again, with all its attempts; returns id and how many."""
    sweep = find(db, key)
    sweep_id = str(sweep["id"])
    count = number(db, "SELECT count(*) FROM job WHERE sweep_id = ? AND state = 'failed'", (sweep_id,))
    if count or sweep["state"] == "cancelled":
        reopen(db, sweep_id)
        db.execute(
            "UPDATE job SET attempts = 0, not_before_us = 0 WHERE sweep_id = ? AND state = 'failed'", (sweep_id,)
        )
        _move_jobs(db, sweep_id, Event.RETRY)
    return sweep_id, count


def reopen(db: Database, sweep_id: str) -> None:
    """Let an ended sweep run again: jobs are tried once more or were added. ConflictError when it was cancelled."""
    sweep = find(db, sweep_id)
    if sweep["state"] == "cancelled":
        raise ConflictError(f"the sweep {sweep['name']!r} is cancelled; submit it again instead")
    if sweep["state"] in ENDED:
        _set_state(db, sweep_id, "running")


def _move_jobs(db: Database, sweep_id: str, event: Event) -> None:
    """Let an event that is about no attempt happen to all jobs of a sweep at once."""
    for state in JOB_STATES:
        step = life.step(event, state, None)
        if step.job is not None:
            db.execute(
                "UPDATE job SET state = ?, reason = NULL WHERE sweep_id = ? AND state = ?", (step.job, sweep_id, state)
            )


def settle(db: Database, sweep_id: str) -> None:
    """End a running sweep once no job is open and no difference is waited for."""
    sweep = row(db, "SELECT state FROM sweep WHERE id = ?", (sweep_id,))
    if sweep is None or sweep["state"] not in ("running", "paused"):
        return
    # EXISTS, not a count: asked after every job, of queues that may be long.
    unfinished = number(
        db,
        "SELECT EXISTS (SELECT 1 FROM job WHERE sweep_id = ? AND state IN ('queued', 'leased'))",
        (sweep_id,),
    )
    if unfinished or pending_differences(db, sweep_id):
        return
    failed = number(db, "SELECT count(*) FROM job WHERE sweep_id = ? AND state = 'failed'", (sweep_id,))
    _set_state(db, sweep_id, "failed" if failed else "done")


def delete(db: Database, blob_dir: Path, key: str) -> int:
    """Remove a sweep with its results, and the blobs that only it used; returns how many blobs."""
    sweep = find(db, key)
    sweep_id = str(sweep["id"])
    if number(db, "SELECT count(*) FROM job WHERE sweep_id = ? AND state = 'leased'", (sweep_id,)):
        raise ConflictError(f"devices are measuring jobs of {sweep['name']!r}; cancel it and wait for them")
    found = rows(db, "SELECT image_sha256, samples_sha256 FROM result WHERE sweep_id = ?", (sweep_id,))
    images = {str(result["image_sha256"]) for result in found if result["image_sha256"]}
    db.execute("DELETE FROM sweep WHERE id = ?", (sweep_id,))
    candidates = images | {str(result["samples_sha256"]) for result in found if result["samples_sha256"]}
    for image in images:
        if not number(db, "SELECT EXISTS (SELECT 1 FROM result WHERE image_sha256 = ?)", (image,)):
            candidates |= _forget_differences(db, image)
    events.add(db, "sweep", sweep_id, {"state": "deleted"})
    return blobs.discard(db, blob_dir, candidates)


def _forget_differences(db: Database, image: str) -> set[str]:
    """Forget every difference of a picture that is no result any more; returns their delta images."""
    which = "reference_sha256 = ? OR test_sha256 = ?"
    deltas = rows(db, f"SELECT delta_sha256 FROM image_difference WHERE {which}", (image, image))
    db.execute(f"DELETE FROM image_difference WHERE {which}", (image, image))
    return {str(found["delta_sha256"]) for found in deltas if found["delta_sha256"]}


def definition_of(sweep: Row) -> SweepDefinition:
    """The definition that a sweep was made from."""
    return SweepDefinition.model_validate(json.loads(sweep["definition"]))


def _set_state(db: Database, sweep_id: str, state: str) -> None:
    db.execute("UPDATE sweep SET state = ?, version = version + 1 WHERE id = ?", (state, sweep_id))
    _announce(db, sweep_id, state)


def _announce(db: Database, sweep_id: str, state: str) -> None:
    events.add(db, "sweep", sweep_id, {"state": state})


def _past(action: str) -> str:
    return {"pause": "paused", "resume": "resumed", "cancel": "cancelled"}[action]
