"""Jobs of a sweep: lists, single retries, what becomes of one after an attempt."""

import json
from typing import Any

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, NotFoundError
from joulebox_server.store import events, sweeps
from joulebox_server.store.database import Row, row, rows

FIELDS = """SELECT job.*, sweep_scene.label, sweep_scene.defines, scene.name AS scene_name,
    scene.bundle_sha256, configuration.settings, device.name AS device_name, sweep.definition
    FROM job JOIN sweep ON sweep.id = job.sweep_id
    JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
    JOIN scene ON scene.id = sweep_scene.scene_id
    JOIN configuration ON configuration.id = job.configuration_id
    JOIN target ON target.id = job.target_id LEFT JOIN device ON device.id = target.device_id"""


def find(db: Database, job_id: str) -> Row:
    """A job with its scene, settings and sweep definition. Raises NotFoundError."""
    found = row(db, f"{FIELDS} WHERE job.id = ?", (job_id,))
    if found is None:
        raise NotFoundError(f"no job has the id {job_id!r}")
    return found


def settings_of(job: Row) -> dict[str, Any]:
    """What the renderer is to be given: the configuration with the job's own seed."""
    settings: dict[str, Any] = json.loads(job["settings"])
    return settings | {"seed": job["seed"]}


def listed(db: Database, sweep_id: str, limit: int, cursor: str | None) -> list[dict[str, Any]]:
    """Jobs in the order they were made; those after the job `cursor`."""
    found = rows(
        db,
        f"{FIELDS} WHERE job.sweep_id = ? AND job.id > ? ORDER BY job.id LIMIT ?",
        (sweep_id, cursor or "", limit),
    )
    return [
        {
            "id": job["id"],
            "scene": job["label"],
            "device": job["device_name"],
            "purpose": job["purpose"],
            "configuration_id": job["configuration_id"],
            "settings": settings_of(job),
            "repeat": job["repeat"],
            "state": job["state"],
            "attempts": job["attempts"],
            "reason": job["reason"],
        }
        for job in found
    ]


def retry(db: Database, job_id: str) -> str:
    """Queue one failed job again; returns its sweep. Raises ConflictError when it did not fail."""
    job = find(db, job_id)
    sweep = sweeps.find(db, job["sweep_id"])
    if job["state"] != "failed":
        raise ConflictError(f"this job is {job['state']}; only a failed one can be tried again")
    if sweep["state"] == "cancelled":
        raise ConflictError(f"the sweep {sweep['name']!r} is cancelled; submit it again instead")
    db.execute("UPDATE job SET attempts = 0 WHERE id = ?", (job_id,))
    set_state(db, job, "queued", None)
    if sweep["state"] in sweeps.ENDED:
        db.execute("UPDATE sweep SET state = 'running' WHERE id = ?", (sweep["id"],))
        events.add(db, "sweep", sweep["id"], {"state": "running"})
    return str(sweep["id"])


def set_state(db: Database, job: Row, state: str, reason: str | None, not_before_us: int = 0) -> None:
    """Change a job's state, and end its sweep when that was the last."""
    db.execute(
        "UPDATE job SET state = ?, reason = ?, not_before_us = ? WHERE id = ?",
        (state, reason, not_before_us, job["id"]),
    )
    events.add(db, "job", job["sweep_id"], {"job_id": job["id"], "state": state, "reason": reason})
    if state in ("done", "failed", "cancelled"):
        sweeps.settle(db, job["sweep_id"])


def spend_attempt(db: Database, job: Row, reason: str, max_attempts: int) -> None:
    """After a failure: queue the job again, or let it fail when its attempts are spent."""
    db.execute("UPDATE job SET attempts = attempts + 1 WHERE id = ?", (job["id"],))
    give_back(db, job, reason, max_attempts, spent=job["attempts"] + 1)


def give_back(db: Database, job: Row, reason: str, max_attempts: int, *, spent: int, not_before_us: int = 0) -> None:
    """A job without a result returns to the queue; to none when it is out of attempts or its sweep over."""
    sweep = sweeps.find(db, job["sweep_id"])
    if sweep["state"] == "cancelled":
        set_state(db, job, "cancelled", reason)
    elif spent >= max_attempts:
        set_state(db, job, "failed", reason)
    else:
        set_state(db, job, "queued", reason, not_before_us)
