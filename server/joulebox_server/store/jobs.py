"""Jobs of a sweep: lists, retries, and what an event makes of one."""

import json
from dataclasses import dataclass
from typing import Any

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, NotFoundError
from joulebox_server.store import devices, events, life, suspicion, sweeps
from joulebox_server.store.database import Row, number, row, rows
from joulebox_server.store.ids import MICRO
from joulebox_server.store.life import Event

FIELDS = """SELECT job.*, sweep_scene.label, sweep_scene.defines, scene.name AS scene_name,
    scene.bundle_sha256, configuration.settings, device.name AS device_name, sweep.definition,
    sweep.state AS sweep_state
    FROM job JOIN sweep ON sweep.id = job.sweep_id
    JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
    JOIN scene ON scene.id = sweep_scene.scene_id
    JOIN configuration ON configuration.id = job.configuration_id
    JOIN target ON target.id = job.target_id LEFT JOIN device ON device.id = target.device_id"""


@dataclass(frozen=True)
class LeaseRules:
    """The settings that leases, retries and the health of devices depend on.

    slack_s          added to the longest time a measurement may take
    release_pause_s  a job given back unmeasured is not handed out sooner
    retry_pause_s    the same after the first failure; doubles with each, up to `longest_retry_pause_s`
    max_attempts     failures after which a job fails
    suspect_after    failures in a row that are a device's own (`suspicion`), after which it gets no more jobs
    """

    slack_s: float
    release_pause_s: float
    retry_pause_s: float
    longest_retry_pause_s: float
    max_attempts: int
    suspect_after: int


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
            "metered": bool(job["metered"]),
            "state": job["state"],
            "attempts": job["attempts"],
            "reason": job["reason"],
        }
        for job in found
    ]


def retry(db: Database, job_id: str) -> str:
    """Queue one failed job again; returns its sweep. Raises ConflictError when it did not fail."""
    job = find(db, job_id)
    step = life.step(Event.RETRY, job["state"], None)
    if step.refused or step.job is None:
        raise ConflictError(f"this job is {job['state']}; only a failed one can be tried again")
    sweeps.reopen(db, job["sweep_id"])
    db.execute("UPDATE job SET attempts = 0 WHERE id = ?", (job_id,))
    _set_state(db, job, step.job, None)
    return str(job["sweep_id"])


def happen(
    db: Database, event: Event, job: Row, attempt: Row, rules: LeaseRules, reason: str | None, now_us: int
) -> None:
    """Let an event take its effect on a job and one of its attempts, as the table of `life` says.

    Raises ConflictError when the table refuses it.
    """
    step = life.step(event, job["state"], attempt["state"])
    if step.refused:
        raise ConflictError("this attempt has its result already; it cannot be given back")
    if step.attempt is not None:
        db.execute("UPDATE attempt SET state = ?, reason = ? WHERE id = ?", (step.attempt, reason, attempt["id"]))
    if step.blames:
        suspicion.blame(db, attempt, reason or event.value, rules.suspect_after)
    elif event is Event.RESULT and attempt["state"] == "leased":
        devices.forgive(db, attempt["device_id"])
    if step.job == "back":
        _give_back(db, job, rules, step.spends, reason, now_us)
    elif step.job is not None:
        _set_state(db, job, step.job, None)
    elif step.attempt is not None:  # a late result changes no job, and still is news
        events.add(db, "job", job["sweep_id"], {"job_id": job["id"], "state": job["state"], "reason": job["reason"]})


def _give_back(db: Database, job: Row, rules: LeaseRules, spends: bool, reason: str | None, now_us: int) -> None:
    attempts = int(job["attempts"]) + spends
    state = life.returned(
        cancelled=job["sweep_state"] == "cancelled",
        answered=_answered(db, job["id"]),
        spent=attempts >= rules.max_attempts,
    )
    if spends:
        db.execute("UPDATE job SET attempts = ? WHERE id = ?", (attempts, job["id"]))
        pause_s = min(rules.longest_retry_pause_s, rules.retry_pause_s * 2.0 ** (attempts - 1))
    else:
        pause_s = rules.release_pause_s
    _set_state(db, job, state, None if state == "done" else reason, now_us + round(pause_s * MICRO))


def _answered(db: Database, job_id: str) -> bool:
    return bool(number(db, "SELECT EXISTS (SELECT 1 FROM result WHERE job_id = ? AND void IS NULL)", (job_id,)))


def _set_state(db: Database, job: Row, state: str, reason: str | None, not_before_us: int = 0) -> None:
    """Change a job's state, and end its sweep when that was the last."""
    db.execute(
        "UPDATE job SET state = ?, reason = ?, not_before_us = ? WHERE id = ?",
        (state, reason, not_before_us, job["id"]),
    )
    events.add(db, "job", job["sweep_id"], {"job_id": job["id"], "state": state, "reason": reason})
    if state not in life.OPEN:
        sweeps.settle(db, job["sweep_id"])
