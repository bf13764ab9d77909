"""Whether a device or its work is to blame for failures.

A device that fails in a row gets no more jobs until an operator has looked at it. But a scene that no renderer reads
and settings that no memory holds fail wherever they are tried, and must not take the whole shelf along. Of the
failures of a device since its last good result

- those of work that failed on another device too, and that nobody has done, do not count;
- those of a scene that nobody has rendered count as one together;
- every other counts.

Work is a configuration of a scene; another seed is the same work.
"""

from sqlite_utils import Database

from joulebox_server.store import devices
from joulebox_server.store.database import Row, row, rows


def blame(db: Database, attempt: Row, reason: str, suspect_after: int) -> None:
    """Note that an attempt failed; its device becomes suspect once so many failures in a row are its own."""
    device_id = attempt["device_id"]
    db.execute("UPDATE attempt SET failed = 1, in_row = 1 WHERE id = ?", (attempt["id"],))
    db.execute("UPDATE device SET failures_in_row = failures_in_row + 1 WHERE id = ?", (device_id,))
    device = row(db, "SELECT health, failures_in_row FROM device WHERE id = ?", (device_id,))
    if device is None or device["health"] != "good" or device["failures_in_row"] < suspect_after:
        return
    own = own_failures(db, device_id)
    if own >= suspect_after:
        devices.mark(db, device_id, "suspect", f"{own} failures in a row, the last: {reason}")


def own_failures(db: Database, device_id: str) -> int:
    """How many of a device's failures since its last good result count against it."""
    failed = rows(
        db,
        """SELECT job.configuration_id, sweep_scene.scene_id, sweep_scene.defines, count(*) AS n
        FROM attempt JOIN job ON job.id = attempt.job_id JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
        WHERE attempt.device_id = ? AND attempt.in_row = 1 GROUP BY 1, 2, 3""",
        (device_id,),
    )
    counted, unread_scenes = 0, set()
    for work in failed:
        scene = (work["scene_id"], work["defines"])
        if _done(db, work):
            counted += work["n"]
        elif _failed_elsewhere(db, work, device_id):
            continue
        elif _rendered(db, *scene):
            counted += work["n"]
        else:
            unread_scenes.add(scene)
    return counted + len(unread_scenes)


def _done(db: Database, work: Row) -> bool:
    """Whether any device has done this work."""
    done = """SELECT 1 FROM job JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
        WHERE job.configuration_id = ? AND job.state = 'done' AND scene_id = ? AND defines = ? LIMIT 1"""
    return row(db, done, (work["configuration_id"], work["scene_id"], work["defines"])) is not None


def _failed_elsewhere(db: Database, work: Row, device_id: str) -> bool:
    """Whether another device has failed in this work."""
    failed = """SELECT 1 FROM job JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
        JOIN attempt ON attempt.job_id = job.id WHERE job.configuration_id = ? AND scene_id = ? AND defines = ?
        AND attempt.failed = 1 AND attempt.device_id != ? LIMIT 1"""
    return row(db, failed, (work["configuration_id"], work["scene_id"], work["defines"], device_id)) is not None


def _rendered(db: Database, scene_id: str, defines: str) -> bool:
    """Whether any device has rendered this scene with any settings."""
    rendered = """SELECT 1 FROM sweep_scene JOIN job ON job.sweep_id = sweep_scene.sweep_id AND job.state = 'done'
        AND job.sweep_scene_id = sweep_scene.id WHERE scene_id = ? AND defines = ? LIMIT 1"""
    return row(db, rendered, (scene_id, defines)) is not None
