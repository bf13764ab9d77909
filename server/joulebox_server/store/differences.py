"""Differences of pictures: pure functions of two hashes, a metric, its version and a display; cached for ever."""

import json
from typing import Any

from sqlite_utils import Database

from joulebox_server.analysis.difference import METRIC, VERSION
from joulebox_server.errors import NotFoundError
from joulebox_server.schemas.sweep import definition_of
from joulebox_server.store import events, sweeps
from joulebox_server.store.database import Row, number, row, rows
from joulebox_server.store.ids import canonical, new_id, now_us

MAX_TRIES = 3
"""How often a comparison may break its process before it is given up."""


def display_key(exposure: float) -> str:
    """What a difference depends on beside the pictures; the rest of the display is as the metric defines."""
    return canonical({"exposure": exposure})


def request(db: Database, job: Row, result_id: str) -> None:
    """After a result: ask for the comparisons that it makes possible.

    A measured picture is compared with its reference if that is there; a reference with all that waited for it.
    """
    definition = definition_of(job["definition"])
    same = definition.reference.seed_policy == "same"
    reference = _reference(db, job, job["repeat"] if same else 0)
    if reference is None:
        return
    display = display_key(definition.picture_exposure)
    if job["purpose"] == "reference":
        waiting = _waiting(db, job, same)
    else:
        waiting = rows(db, "SELECT id, image_sha256 FROM result WHERE id = ?", (result_id,))
    for result in waiting:
        if result["image_sha256"] is None:
            continue
        difference_id = _wanted(db, reference["image_sha256"], result["image_sha256"], display)
        db.execute(
            """INSERT INTO comparison (result_id, reference_result_id, sweep_id, difference_id)
            VALUES (?, ?, ?, ?)""",
            (result["id"], reference["id"], job["sweep_id"], difference_id),
        )


def _reference(db: Database, job: Row, repeat: int) -> Row | None:
    """The first good reference picture of a job's scene and device."""
    return row(
        db,
        """SELECT result.id, result.image_sha256 FROM job JOIN result ON result.job_id = job.id
        WHERE job.target_id = ? AND job.sweep_scene_id = ? AND job.purpose = 'reference' AND job.repeat = ?
        AND result.void IS NULL AND result.image_sha256 IS NOT NULL ORDER BY result.id LIMIT 1""",
        (job["target_id"], job["sweep_scene_id"], repeat),
    )


def _waiting(db: Database, job: Row, same: bool) -> list[Row]:
    """Pictures of a reference's scene and device that were not compared yet, and may be with this one."""
    return rows(
        db,
        """SELECT result.id, result.image_sha256 FROM job JOIN result ON result.job_id = job.id
        WHERE job.target_id = ? AND job.sweep_scene_id = ? AND job.purpose NOT IN ('reference', 'control')
        AND (job.repeat = ? OR NOT ?) AND result.void IS NULL
        AND NOT EXISTS (SELECT 1 FROM comparison WHERE comparison.result_id = result.id) ORDER BY result.id""",
        (job["target_id"], job["sweep_scene_id"], job["repeat"], same),
    )


def _wanted(db: Database, reference_sha256: str, test_sha256: str, display: str) -> str:
    """Id of the cached difference, which is asked for when it is new."""
    known = find(db, reference_sha256, test_sha256, display)
    if known is not None:
        return str(known["id"])
    difference_id = new_id()
    db.execute(
        """INSERT INTO image_difference (id, reference_sha256, test_sha256, metric, metric_version, display,
        state, created_at_us) VALUES (?, ?, ?, ?, ?, ?, 'pending', ?)""",
        (difference_id, reference_sha256, test_sha256, METRIC, VERSION, display, now_us()),
    )
    return difference_id


def want(db: Database, reference_sha256: str, test_sha256: str, exposure: float) -> str:
    """As for a sweep's comparison, for a pair that somebody asks about; returns the difference's id."""
    return _wanted(db, reference_sha256, test_sha256, display_key(exposure))


def find(db: Database, reference_sha256: str, test_sha256: str, display: str) -> Row | None:
    """The cached difference of a pair by the metric of today."""
    return row(
        db,
        """SELECT * FROM image_difference WHERE reference_sha256 = ? AND test_sha256 = ? AND metric = ?
        AND metric_version = ? AND display = ?""",
        (reference_sha256, test_sha256, METRIC, VERSION, display),
    )


def get(db: Database, difference_id: str) -> Row:
    """A difference by id. Raises NotFoundError: a sweep that is deleted takes its own along."""
    found = row(db, "SELECT * FROM image_difference WHERE id = ?", (difference_id,))
    if found is None:
        raise NotFoundError(f"no difference has the id {difference_id!r}")
    return found


def versions(db: Database, reference_sha256: str, test_sha256: str) -> list[dict[str, Any]]:
    """The values of a pair by every metric, version and display that it was compared with, the newest first."""
    found = rows(
        db,
        """SELECT * FROM image_difference WHERE reference_sha256 = ? AND test_sha256 = ? AND state = 'done'
        ORDER BY id DESC""",
        (reference_sha256, test_sha256),
    )
    return [document(difference) for difference in found]


def recompute(db: Database, sweep_key: str | None) -> tuple[int, int]:
    """Ask again for the comparisons of a sweep (None: of all) that today's metric has not made, or failed in.

    Returns how many are asked for and how many are of today's metric already. The values of other versions stay.
    """
    sweep_id = None if sweep_key is None else str(sweeps.find(db, sweep_key)["id"])
    found = rows(
        db,
        """SELECT comparison.result_id, d.* FROM comparison
        JOIN image_difference AS d ON d.id = comparison.difference_id
        WHERE comparison.sweep_id = coalesce(?, comparison.sweep_id)""",
        (sweep_id,),
    )
    asked = 0
    for difference in found:
        current = (difference["metric"], difference["metric_version"]) == (METRIC, VERSION)
        if current and difference["state"] != "failed":
            continue
        asked += 1
        difference_id = _wanted(db, difference["reference_sha256"], difference["test_sha256"], difference["display"])
        db.execute("UPDATE image_difference SET state = 'pending', tries = 0 WHERE id = ? AND state = 'failed'",
                   (difference_id,))  # fmt: skip
        db.execute(
            "UPDATE comparison SET difference_id = ? WHERE result_id = ?", (difference_id, difference["result_id"])
        )
    return asked, len(found) - asked


def pending(db: Database, limit: int) -> list[Row]:
    """Differences to be computed, the oldest first."""
    return rows(db, "SELECT * FROM image_difference WHERE state = 'pending' ORDER BY id LIMIT ?", (limit,))


def pending_count(db: Database) -> int:
    """How many differences are to be computed."""
    return number(db, "SELECT count(*) FROM image_difference WHERE state = 'pending'")


def complete(db: Database, difference_id: str, outcome: dict[str, Any], delta_sha256: str) -> None:
    """Keep a computed difference; `outcome` holds its value, companions, display and second opinions."""
    db.execute(
        """UPDATE image_difference SET state = 'done', value = ?, outcome = ?, delta_sha256 = ?, reason = NULL
        WHERE id = ?""",
        (outcome["value"], canonical(outcome), delta_sha256, difference_id),
    )
    _tell(db, difference_id, {"state": "done", "value": outcome["value"], "reason": None})


def fail(db: Database, difference_id: str, reason: str) -> None:
    """Keep why a pair cannot be compared; the jobs that brought the pictures say it too."""
    db.execute("UPDATE image_difference SET state = 'failed', reason = ? WHERE id = ?", (reason, difference_id))
    db.execute(
        """UPDATE job SET reason = ? WHERE id IN (SELECT result.job_id FROM comparison
        JOIN result ON result.id = comparison.result_id WHERE comparison.difference_id = ?)""",
        (f"no difference: {reason}", difference_id),
    )
    _tell(db, difference_id, {"state": "failed", "value": None, "reason": reason})


def count_try(db: Database, difference_id: str) -> int:
    """Note that computing a difference broke its process; returns how often that happened."""
    db.execute("UPDATE image_difference SET tries = tries + 1 WHERE id = ?", (difference_id,))
    return number(db, "SELECT tries FROM image_difference WHERE id = ?", (difference_id,))


def document(difference: Row) -> dict[str, Any]:
    """A finished difference as the API shows it."""
    outcome: dict[str, Any] = json.loads(difference["outcome"])
    return {
        "metric": difference["metric"],
        "version": difference["metric_version"],
        **outcome,
        "reference_sha256": difference["reference_sha256"],
        "test_sha256": difference["test_sha256"],
        "delta_sha256": difference["delta_sha256"],
    }


def _tell(db: Database, difference_id: str, news: dict[str, Any]) -> None:
    waiting = rows(
        db,
        """SELECT DISTINCT comparison.sweep_id, result.job_id FROM comparison
        JOIN result ON result.id = comparison.result_id WHERE difference_id = ?""",
        (difference_id,),
    )
    for comparison in waiting:
        events.add(db, "difference", comparison["sweep_id"], {"job_id": comparison["job_id"], **news})
    for sweep_id in {comparison["sweep_id"] for comparison in waiting}:
        sweeps.settle(db, sweep_id)
