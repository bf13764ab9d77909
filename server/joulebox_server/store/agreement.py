"""Whether devices agree on a picture: to the bit within a class, closely across classes.

A class is renderer build, operating system and instruction set in use: there the same settings must give the
same pixel hash. Across classes the 99th percentile of the difference must stay below 1 JND. Each result is
compared with the first of its class, and the first of each class with those of the others, so that the work
grows with the classes and not with the square of the results. Energy is never voted on.
"""

import json
from typing import Any

from sqlite_utils import Database

from joulebox_server.schemas.measure import MeasureDocument
from joulebox_server.schemas.sweep import definition_of
from joulebox_server.store import differences, events
from joulebox_server.store.database import Row, row, rows
from joulebox_server.store.ids import canonical, new_id, sha256_text

LARGEST_P99_JND = 1.0
MOST_CLASSES = 20
PICTURE = "id, device_id, picture_key, render_class, pixel_sha256, image_sha256"
"""Of a result; not its document, which is long."""


def picture_key(job: Row) -> str:
    """Equal for jobs that every device should render alike: scene, its defines, settings and seed."""
    asked = (job["bundle_sha256"], json.loads(job["defines"]), json.loads(job["settings"]), job["seed"])
    return sha256_text(canonical(asked))


def render_class(db: Database, device_id: str, document: MeasureDocument) -> str:
    """Within it the pixels must be the same: `joulebox-render 0.1.0, Linux, x86-64-v3`."""
    found = row(db, "SELECT shown FROM device_capabilities WHERE device_id = ?", (device_id,))
    has = {} if found is None else json.loads(found["shown"])
    renderer = document.renderer
    isa = renderer.isa or has.get("isa") or has.get("machine") or "unknown"
    return f"{renderer.name} {renderer.version}, {has.get('os', 'unknown')}, {isa}"


def check(db: Database, job: Row, result_id: str) -> None:
    """After a good result: compare its picture with those that others made of the same settings."""
    result = row(db, f"SELECT {PICTURE} FROM result WHERE id = ?", (result_id,))
    if result is None or result["pixel_sha256"] is None:
        return
    firsts = rows(
        db,
        f"""SELECT {PICTURE} FROM result JOIN (SELECT min(id) AS first_id FROM result
            WHERE picture_key = ? AND id < ? AND void IS NULL AND pixel_sha256 IS NOT NULL
            GROUP BY render_class ORDER BY 1 LIMIT ?) ON first_id = id""",
        (result["picture_key"], result_id, MOST_CLASSES),
    )
    own = next((first for first in firsts if first["render_class"] == result["render_class"]), None)
    if own is not None:
        if own["pixel_sha256"] != result["pixel_sha256"]:
            _add(db, result, own, same_class=True, difference_id=None)
            _tell(db, result["device_id"], own["device_id"])
        return
    exposure = definition_of(job["definition"]).picture_exposure
    for first in firsts:
        images = (first["image_sha256"], result["image_sha256"])
        if first["pixel_sha256"] != result["pixel_sha256"] and None not in images:
            _add(db, result, first, same_class=False, difference_id=differences.want(db, *images, exposure))
            judge_known(db, result_id)


def _add(db: Database, result: Row, other: Row, *, same_class: bool, difference_id: str | None) -> None:
    db.execute(
        """INSERT INTO picture_check (id, result_id, other_result_id, device_id, other_device_id, same_class,
        agrees, difference_id) VALUES (?, ?, ?, ?, ?, ?, ?, ?)""",
        (
            new_id(),
            result["id"],
            other["id"],
            result["device_id"],
            other["device_id"],
            same_class,
            0 if same_class else None,
            difference_id,
        ),
    )


def complete(db: Database, difference_id: str, outcome: dict[str, Any], delta_sha256: str) -> None:
    """Keep a computed difference, and settle the checks that waited for it."""
    differences.complete(db, difference_id, outcome, delta_sha256)
    judge(db, difference_id, outcome)


def judge_known(db: Database, result_id: str) -> None:
    """Judge the checks of a result whose differences were computed before."""
    for found in rows(
        db,
        """SELECT DISTINCT d.id, d.outcome FROM picture_check JOIN image_difference AS d ON d.id = difference_id
        WHERE result_id = ? AND agrees IS NULL AND d.state = 'done'""",
        (result_id,),
    ):
        judge(db, found["id"], json.loads(found["outcome"]))


def judge(db: Database, difference_id: str, outcome: dict[str, Any]) -> None:
    """Settle the checks that waited for a difference."""
    p99_jnd = outcome.get("p99_jnd")
    if p99_jnd is None:
        return
    agrees = p99_jnd < LARGEST_P99_JND
    waiting = rows(db, "SELECT * FROM picture_check WHERE difference_id = ? AND agrees IS NULL", (difference_id,))
    for found in waiting:
        db.execute("UPDATE picture_check SET agrees = ?, p99_jnd = ? WHERE id = ?", (agrees, p99_jnd, found["id"]))
        if not agrees:
            _tell(db, found["device_id"], found["other_device_id"])


def _tell(db: Database, *device_ids: str) -> None:
    for device_id in dict.fromkeys(device_ids):
        events.add(db, "device", None, {"device_id": device_id, "state": "pictures_disagree"})


def disagreements(db: Database, device_id: str, limit: int, cursor: str | None) -> list[dict[str, Any]]:
    """Where a device and another made different pictures, the newest first; those before the check `cursor`."""
    found = rows(
        db,
        """SELECT checked.id, checked.same_class, checked.p99_jnd, device.name AS device, other_device.name AS other,
        one.id AS result_id, two.id AS other_result_id, one.render_class, two.render_class AS other_class,
        one.pixel_sha256, two.pixel_sha256 AS other_pixels, one.image_sha256, two.image_sha256 AS other_image,
        sweep_scene.label, configuration.settings, job.seed
        FROM picture_check AS checked JOIN device ON device.id = checked.device_id
        JOIN device AS other_device ON other_device.id = checked.other_device_id
        JOIN result AS one ON one.id = checked.result_id JOIN result AS two ON two.id = checked.other_result_id
        JOIN job ON job.id = one.job_id JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
        JOIN configuration ON configuration.id = job.configuration_id
        WHERE agrees = 0 AND (checked.device_id = ? OR checked.other_device_id = ?) AND checked.id < ?
        ORDER BY checked.id DESC LIMIT ?""",
        (device_id, device_id, cursor or "~", limit),
    )
    return [
        {
            "id": check["id"],
            "device": check["device"],
            "other_device": check["other"],
            "scene": check["label"],
            "settings": json.loads(check["settings"]) | {"seed": check["seed"]},
            "same_class": bool(check["same_class"]),
            "render_class": check["render_class"],
            "other_render_class": check["other_class"],
            "p99_jnd": check["p99_jnd"],
            "pixel_sha256": check["pixel_sha256"],
            "other_pixel_sha256": check["other_pixels"],
            "image_sha256": check["image_sha256"],
            "other_image_sha256": check["other_image"],
            "result_id": check["result_id"],
            "other_result_id": check["other_result_id"],
        }
        for check in found
    ]
