"""Leases: handing jobs to devices, and taking them back when a device falls silent.

Every question about a lease is asked inside the write transaction that acts on the answer.
"""

import json
from collections.abc import Collection
from typing import Any

from sqlite_utils import Database

from joulebox_server.errors import ForbiddenError, NotFoundError
from joulebox_server.schemas.device import Lease, LeasedMeasure, LeasedScene, ReleaseRequest
from joulebox_server.schemas.sweep import SweepDefinition, definition_of
from joulebox_server.store import devices, events, jobs, life
from joulebox_server.store.database import Row, row, rows
from joulebox_server.store.ids import MICRO, canonical, new_id, timestamp
from joulebox_server.store.jobs import LeaseRules
from joulebox_server.store.life import Event

NOISE_FLOOR_WINDOW_S = 1.0
TIMED_WINDOW_S = 10.0
TIMED_WINDOWS = 2
"""Of a job whose joules are not measured."""


def lease(
    db: Database,
    device_id: str,
    boot_id: str,
    conditions: dict[str, Any],
    max_jobs: int,
    rules: LeaseRules,
    now_us: int,
    holding: Collection[str] | None = None,
) -> list[Lease]:
    """Up to `max_jobs` jobs for a device, the oldest sweep's first; none when nothing is to be done.

    Leases that ended are taken back first, and those of this device that nobody works on at once: of an earlier
    boot, or not among those that it is `holding` (the answer with the lease was lost, or the agent restarted).
    """
    reap(db, rules, now_us)
    _take_back(db, rules, Event.RESTART, *_abandoned(device_id, boot_id, holding), now_us)
    db.execute("UPDATE device SET last_seen_at_us = ?, boot_id = ? WHERE id = ?", (now_us, boot_id, device_id))
    return [
        _grant(db, jobs.find(db, job_id), device_id, boot_id, conditions, rules, now_us)
        for job_id in _next_jobs(db, device_id, max_jobs, now_us)
    ]


def _abandoned(device_id: str, boot_id: str, holding: Collection[str] | None) -> tuple[str, tuple[str, ...]]:
    """Condition and parameters for the attempts of a device that nobody works on."""
    if holding is None:
        return "attempt.device_id = ? AND attempt.boot_id != ?", (device_id, boot_id)
    others = f"attempt.id NOT IN ({', '.join('?' * len(holding))})"
    return f"attempt.device_id = ? AND (attempt.boot_id != ? OR {others})", (device_id, boot_id, *holding)


def work_waits(db: Database, device_id: str, now_us: int) -> bool:
    """Whether `lease` would find a job; a cheap question for a device that waits."""
    ended = row(db, "SELECT 1 FROM attempt WHERE state = 'leased' AND expires_at_us <= ? LIMIT 1", (now_us,))
    return ended is not None or bool(_next_jobs(db, device_id, 1, now_us))


def reap(db: Database, rules: LeaseRules, now_us: int) -> int:
    """Take back every lease that ended; returns how many."""
    return _take_back(db, rules, Event.EXPIRY, "attempt.expires_at_us <= ?", (now_us,), now_us)


def set_back(db: Database, rules: LeaseRules, now_us: int) -> None:
    """Count again from now what a clock that was ahead and is right again would let last until it was reached."""
    db.execute(
        """UPDATE attempt SET expires_at_us = expires_at_us - leased_at_us + ?, leased_at_us = ?
        WHERE state = 'leased' AND leased_at_us > ?""",
        (now_us, now_us, now_us + round(rules.slack_s * MICRO)),
    )
    longest_s = max(rules.release_pause_s, rules.retry_pause_s, rules.longest_retry_pause_s)
    db.execute(
        """UPDATE job SET not_before_us = ? WHERE state = 'queued' AND not_before_us > ? AND target_id IN
        (SELECT target.id FROM target JOIN sweep ON sweep.id = sweep_id WHERE sweep.state IN ('running', 'paused'))""",
        (now_us, now_us + round((longest_s + rules.slack_s) * MICRO)),
    )


def release(
    db: Database, attempt_id: str, device_id: str, request: ReleaseRequest, rules: LeaseRules, now_us: int
) -> None:
    """A device gives a job back. Again, or after the lease ended: nothing more happens.

    Raises NotFoundError, ForbiddenError for another device's attempt, ConflictError after its result.
    """
    attempt = find_attempt(db, attempt_id, device_id)
    event = Event.FAILURE if request.failed else Event.RELEASE
    jobs.happen(db, event, jobs.find(db, attempt["job_id"]), attempt, rules, request.reason, now_us)


def revoke(db: Database, key: str, rules: LeaseRules, now_us: int) -> str:
    """Shut a device out and take its jobs back at once; its results stay. Returns its id."""
    device_id = devices.revoke(db, key)
    _take_back(db, rules, Event.REVOCATION, "attempt.device_id = ?", (device_id,), now_us)
    return device_id


def find_attempt(db: Database, attempt_id: str, device_id: str) -> Row:
    """An attempt of this device. Raises NotFoundError, or ForbiddenError when it is another's."""
    found = row(db, "SELECT * FROM attempt WHERE id = ?", (attempt_id,))
    if found is None:
        raise NotFoundError(f"no attempt has the id {attempt_id!r}; its sweep may have been deleted")
    if found["device_id"] != device_id:
        raise ForbiddenError("this attempt was leased to another device")
    return found


LOST = {
    Event.EXPIRY: "fell silent until the lease ended",
    Event.RESTART: "restarted, or never got the lease",
    Event.REVOCATION: "was shut out",
}


def _take_back(
    db: Database, rules: LeaseRules, event: Event, which: str, parameters: tuple[Any, ...], now_us: int
) -> int:
    lost = rows(
        db,
        f"""SELECT attempt.*, device.name FROM attempt JOIN device ON device.id = device_id
        WHERE attempt.state = 'leased' AND {which}""",
        parameters,
    )
    for attempt in lost:
        reason = f"the device {attempt['name']!r} {LOST[event]}"
        jobs.happen(db, event, jobs.find(db, attempt["job_id"]), attempt, rules, reason, now_us)
    return len(lost)


def _next_jobs(db: Database, device_id: str, count: int, now_us: int) -> list[str]:
    """Ids of the jobs that a device should do next. Reads no more of a long queue than it takes."""
    device = row(
        db,
        """SELECT health, shown AS capabilities FROM device LEFT JOIN device_capabilities ON device_id = id
        WHERE id = ? AND revoked_at_us IS NULL""",
        (device_id,),
    )
    if device is None or device["health"] != "good":
        return []
    targets = rows(
        db,
        """SELECT target.id, target.device_id, target.requires FROM sweep
        JOIN target ON target.sweep_id = sweep.id
        WHERE sweep.state = 'running' AND (target.device_id = ? OR target.device_id IS NULL)
        ORDER BY sweep.id, target.position""",
        (device_id,),
    )
    found: list[str] = []
    for target in targets:
        if len(found) == count:
            break
        if target["device_id"] is None and not devices.fits(device["capabilities"], target["requires"]):
            continue
        queued = rows(
            db,
            """SELECT id FROM job WHERE target_id = ? AND state = 'queued' AND not_before_us <= ?
            ORDER BY block, position, id LIMIT ?""",
            (target["id"], now_us, count - len(found)),
        )
        found += [str(job["id"]) for job in queued]
    return found


def _grant(
    db: Database,
    job: Row,
    device_id: str,
    boot_id: str,
    conditions: dict[str, Any],
    rules: LeaseRules,
    now_us: int,
) -> Lease:
    measure = _measure(definition_of(job["definition"]), job)
    expires_at_us = now_us + round((measure.max_seconds + measure.window_s + rules.slack_s) * MICRO)
    attempt_id, step = new_id(), life.step(Event.LEASE, job["state"], None)
    if job["device_name"] is None:  # the wish for a device: this one becomes it
        db.execute("UPDATE target SET device_id = ? WHERE id = ? AND device_id IS NULL", (device_id, job["target_id"]))
    db.execute("UPDATE job SET state = ? WHERE id = ?", (step.job, job["id"]))
    db.execute(
        """INSERT INTO attempt (id, job_id, device_id, boot_id, state, conditions, leased_at_us, expires_at_us)
        VALUES (?, ?, ?, ?, ?, ?, ?, ?)""",
        (attempt_id, job["id"], device_id, boot_id, step.attempt, canonical(conditions), now_us, expires_at_us),
    )
    events.add(
        db, "job", job["sweep_id"], {"job_id": job["id"], "state": step.job, "device_id": device_id, "reason": None}
    )
    return Lease(
        attempt_id=attempt_id,
        job_id=job["id"],
        sweep_id=job["sweep_id"],
        # A control run is measured like any other; an agent need not know of it.
        purpose="measure" if job["purpose"] == "control" else job["purpose"],
        expires_at=timestamp(expires_at_us) or "",
        scene=LeasedScene(name=job["scene_name"], bundle_sha256=job["bundle_sha256"]),
        defines=json.loads(job["defines"]),
        settings=jobs.settings_of(job),
        measure=measure,
    )


def _measure(definition: SweepDefinition, job: Row) -> LeasedMeasure:
    rules = definition.measure
    known = rules.model_dump(exclude={"meter", "metered_windows"})
    if job["metered"]:
        return LeasedMeasure(**known, meter=True)
    # Of a noise floor only the picture is wanted; a configuration that is timed needs no gauge to refresh.
    longest_s, windows = (
        (NOISE_FLOOR_WINDOW_S, 1) if job["purpose"] == "noise_floor" else (TIMED_WINDOW_S, TIMED_WINDOWS)
    )
    few = {"window_s": min(rules.window_s, longest_s), "min_windows": windows, "max_windows": windows}
    return LeasedMeasure(**known | few, meter=False)
