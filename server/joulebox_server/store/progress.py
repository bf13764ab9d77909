"""When a sweep will be done, judged by how long its finished jobs took."""

import math
import statistics
from typing import Any

from sqlite_utils import Database

from joulebox_server.store import sweeps
from joulebox_server.store.database import Row, row, rows
from joulebox_server.store.ids import MICRO, timestamp

NORMAL_95 = 1.96
FEWEST_DONE = 2
"""So many finished jobs of a device before an end is foretold."""


def progress(db: Database, sweep_key: str, now_us: int) -> dict[str, Any]:
    """How far a sweep is: when it began and last moved, and the seconds until its end [s] with a 95 % range.

    Devices work beside each other, so the slowest decides. Without an answer `reason` says what it waits for.
    """
    sweep = sweeps.find(db, sweep_key)
    span = row(
        db,
        """SELECT min(leased_at_us) AS first, (SELECT max(received_at_us) FROM result WHERE sweep_id = ?) AS last
        FROM attempt JOIN job ON job.id = attempt.job_id WHERE job.sweep_id = ?""",
        (sweep["id"], sweep["id"]),
    )
    remaining, reason = _remaining(db, sweep, now_us)
    return {
        "sweep_id": sweep["id"],
        "state": sweep["state"],
        "started_at": span and timestamp(span["first"]),
        "last_result_at": span and timestamp(span["last"]),
        "remaining_s": remaining,
        "reason": reason,
    }


def _remaining(db: Database, sweep: Row, now_us: int) -> tuple[dict[str, float] | None, str | None]:
    if sweep["state"] in ("done", "failed", "cancelled"):
        return None, f"the sweep is {sweep['state']}"
    if sweep["state"] == "paused":
        return None, "the sweep is paused; resume it"
    targets = rows(
        db,
        """SELECT target_id, sum(state IN ('queued', 'leased')) AS left, max(device_id) AS device_id
        FROM job JOIN target ON target.id = job.target_id WHERE job.sweep_id = ? GROUP BY target_id""",
        (sweep["id"],),
    )
    slowest = {"value": 0.0, "low": 0.0, "high": 0.0}
    for target in targets:
        if not target["left"]:
            continue
        if target["device_id"] is None:
            return None, "no device has taken a job yet; is a fitting agent running?"
        found = _of_target(db, target["target_id"], target["left"], now_us)
        if found is None:
            return None, "the end can be told after the first jobs are done"
        slowest = max(slowest, found, key=lambda each: each["value"])
    return slowest, None


def _of_target(db: Database, target_id: str, left: int, now_us: int) -> dict[str, float] | None:
    """Time until a device has done what is left, from the times of what it did, what runs now counted in part."""
    took = rows(
        db,
        """SELECT received_at_us - leased_at_us AS took_us FROM result JOIN attempt ON attempt.id = attempt_id
        JOIN job ON job.id = attempt.job_id WHERE job.target_id = ? ORDER BY result.id DESC LIMIT 500""",
        (target_id,),
    )
    if len(took) < FEWEST_DONE:
        return None
    times_s = [each["took_us"] / MICRO for each in took]
    mean_s, spread_s = statistics.fmean(times_s), statistics.stdev(times_s)
    running = rows(
        db,
        """SELECT leased_at_us FROM attempt JOIN job ON job.id = attempt.job_id
        WHERE job.target_id = ? AND attempt.state = 'leased'""",
        (target_id,),
    )
    spent_s = sum(min(mean_s, max(0, now_us - each["leased_at_us"]) / MICRO) for each in running)
    value_s = max(0.0, left * mean_s - spent_s)
    # what is left scatters by itself, and the mean is known only from what was done
    half_s = NORMAL_95 * spread_s * math.sqrt(left + left * left / len(times_s))
    return {"value": value_s, "low": max(0.0, value_s - half_s), "high": value_s + half_s}
