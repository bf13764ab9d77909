"""Results: taking one in exactly once, and giving them out."""

import json
from pathlib import Path
from typing import Any, Literal

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, FieldError, InvalidError
from joulebox_server.schemas.base import Interval
from joulebox_server.schemas.measure import MeasureDocument
from joulebox_server.store import agreement, blobs, differences, jobs, leases
from joulebox_server.store.database import Row, insert, row, rows
from joulebox_server.store.ids import canonical, micro, new_id, sha256_text, timestamp, unit
from joulebox_server.store.jobs import LeaseRules
from joulebox_server.store.life import Event

Accepted = Literal["ok", "late"]
BATCH = 500
DOCUMENTS = 50
"""Results in a batch with their documents, which may be long."""
COLUMNS = (
    *("id", "sweep_id", "job_id", "scene", "device", "purpose", "configuration_id", "repeat", "seed"),
    *("method", "quality", "accepted", "void", "images", "windows"),
    *("time_s", "time_low_s", "time_high_s", "cpu_s", "energy_j", "energy_low_j", "energy_high_j"),
    *("difference", "pixel_sha256", "image_sha256", "received_at", "settings"),
)
"""Of an exported row."""


def accept(
    db: Database,
    blob_dir: Path,
    attempt_id: str,
    device_id: str,
    document: MeasureDocument,
    rules: LeaseRules,
    now_us: int,
) -> tuple[Accepted, bool]:
    """Keep the result of an attempt; returns how it was taken, and whether it is new.

    A result after the lease ended is `late` and kept: measured energy is never thrown away. The same document
    again changes nothing. Raises ConflictError for another document, InvalidError for a missing blob or a
    document that does not answer the job, and what `leases.find_attempt` raises.
    """
    attempt = leases.find_attempt(db, attempt_id, device_id)
    body = canonical(document.model_dump(mode="json", by_alias=True))
    known = row(db, "SELECT body_sha256, accepted FROM result WHERE attempt_id = ?", (attempt_id,))
    if known is not None:
        if known["body_sha256"] != sha256_text(body):
            raise ConflictError("this attempt has another result already; what was measured first is kept")
        return known["accepted"], False
    job = jobs.find(db, attempt["job_id"])
    _check(db, blob_dir, document, job)
    in_time = attempt["state"] == "leased" and attempt["expires_at_us"] > now_us
    accepted: Accepted = "ok" if in_time else "late"
    result_id = _insert(db, attempt, job, document, body, accepted, now_us)
    if document.void is None:
        if job["purpose"] == "control":
            _insert_control(db, job, result_id)
        else:
            differences.request(db, job, result_id)
        agreement.check(db, job, result_id)
        jobs.happen(db, Event.RESULT, job, attempt, rules, None, now_us)
    else:
        reason = f"the measurement was voided: {document.void}"
        jobs.happen(db, Event.VOID, job, attempt, rules, reason, now_us)
    return accepted, True


def _check(db: Database, blob_dir: Path, document: MeasureDocument, job: Row) -> None:
    wrong = [
        FieldError(field, f"the blob {sha256} is not here; send it first")
        for field, sha256 in (("image_blob", document.image_blob), ("power_samples", document.power_samples))
        if sha256 is not None and not blobs.exists(db, blob_dir, sha256)
    ]
    # Of the settings only those that decide which picture this is: others may be resolved (threads = 0).
    asked = jobs.settings_of(job)
    wrong += [
        FieldError(f"settings.{key}", f"is {document.settings[key]!r}, the job asked for {asked[key]!r}")
        for key in ("seed", "width", "height")
        if asked.get(key) is not None and key in document.settings and document.settings[key] != asked[key]
    ]
    if wrong:
        raise InvalidError(f"the result cannot be taken: {wrong[0].field}: {wrong[0].message}", wrong)


def _insert(
    db: Database, attempt: Row, job: Row, document: MeasureDocument, body: str, accepted: str, now_us: int
) -> str:
    result_id = new_id()
    time_s, energy_j = document.time_s_per_image, document.energy_j_per_image.gross
    insert(
        db,
        "result",
        {
            "id": result_id,
            "attempt_id": attempt["id"],
            "job_id": job["id"],
            "sweep_id": job["sweep_id"],
            "device_id": attempt["device_id"],
            "body_sha256": sha256_text(body),
            "document": body,
            "accepted": accepted,
            "method": document.method,
            "quality": document.quality,
            "void": document.void,
            "images": document.images,
            "windows": document.windows,
            "time_us": time_s and micro(time_s.value),
            "time_low_us": time_s and micro(time_s.low),
            "time_high_us": time_s and micro(time_s.high),
            "cpu_us": document.cpu_s_per_image and micro(document.cpu_s_per_image.value),
            "energy_uj": energy_j and micro(energy_j.value),
            "energy_low_uj": energy_j and micro(energy_j.low),
            "energy_high_uj": energy_j and micro(energy_j.high),
            "pixel_sha256": document.pixel_sha256,
            "image_sha256": document.image_blob,
            "samples_sha256": document.power_samples,
            "received_at_us": now_us,
            "picture_key": agreement.picture_key(job),
            "render_class": agreement.render_class(db, attempt["device_id"], document),
        },
    )
    _insert_stages(db, result_id, document)
    return result_id


def _insert_stages(db: Database, result_id: str, document: MeasureDocument) -> None:
    db.conn.executemany(
        "INSERT INTO stage (result_id, name, time_us, cpu_us, rays, energy_uj) VALUES (?, ?, ?, ?, ?, ?)",
        [
            (
                result_id,
                name,
                micro(stage.time_s),
                micro(stage.cpu_s),
                None if stage.rays is None else round(stage.rays),
                micro(stage.energy_j.equation_2),
            )
            for name, stage in document.stages.items()
        ],
    )


def _insert_control(db: Database, job: Row, result_id: str) -> None:
    """Keep how far a control run is from the first of its scene and device."""
    runs = rows(
        db,
        """SELECT result.id, time_us, energy_uj FROM result JOIN job ON job.id = result.job_id
        WHERE job.target_id = ? AND job.sweep_scene_id = ? AND job.purpose = 'control' AND result.void IS NULL
        AND (result.id = ? OR result.id = (SELECT min(r.id) FROM result AS r JOIN job AS j ON j.id = r.job_id
            WHERE j.target_id = job.target_id AND j.sweep_scene_id = job.sweep_scene_id
            AND j.purpose = 'control' AND r.void IS NULL)) ORDER BY result.id""",
        (job["target_id"], job["sweep_scene_id"], result_id),
    )
    first, own = runs[0], runs[-1]
    if not first["time_us"]:
        return  # nothing to compare with
    energy = own["energy_uj"] / first["energy_uj"] if own["energy_uj"] is not None and first["energy_uj"] else None
    db.execute(
        """INSERT INTO control_run (result_id, sweep_id, target_id, sweep_scene_id, block, time_ratio, energy_ratio)
        VALUES (?, ?, ?, ?, ?, ?, ?)""",
        (
            result_id,
            job["sweep_id"],
            job["target_id"],
            job["sweep_scene_id"],
            job["block"],
            own["time_us"] / first["time_us"],
            energy,
        ),
    )


def interval(found: Row, quantity: Literal["time", "energy"]) -> Interval | None:
    """Seconds or joules an image of a row of `result`."""
    suffix = "us" if quantity == "time" else "uj"
    value, low, high = (unit(found[f"{quantity}{bound}_{suffix}"]) for bound in ("", "_low", "_high"))
    if value is None or low is None or high is None:
        return None
    return Interval(value=value, low=low, high=high)


def exported(db: Database, sweep_id: str | None, limit: int, cursor: str | None) -> list[dict[str, Any]]:
    """Results as flat rows, oldest first, those after the result `cursor`: one unit a column."""
    condition = "" if sweep_id is None else "AND result.sweep_id = ?"
    found = rows(
        db,
        f"""SELECT result.*, job.purpose, job.repeat, job.seed, job.configuration_id, sweep_scene.label,
        device.name AS device_name, configuration.settings, difference.value AS difference
        FROM result JOIN job ON job.id = result.job_id JOIN device ON device.id = result.device_id
        JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
        JOIN configuration ON configuration.id = job.configuration_id
        LEFT JOIN comparison ON comparison.result_id = result.id
        LEFT JOIN image_difference AS difference ON difference.id = comparison.difference_id
        WHERE result.id > ? {condition} ORDER BY result.id LIMIT ?""",
        (cursor or "", *([] if sweep_id is None else [sweep_id]), limit),
    )
    return [_flat(result) for result in found]


def measurements(db: Database, sweep_id: str, cursor: str | None) -> list[dict[str, Any]]:
    """Results of a sweep that were not voided, oldest first, those after the result `cursor`, with documents."""
    found = rows(
        db,
        """SELECT result.id, result.document, job.purpose, job.repeat, job.seed, sweep_scene.label, sweep_scene.defines,
        device.name AS device, difference.value AS difference, difference.state AS difference_state,
        difference.reference_sha256, difference.delta_sha256
        FROM result JOIN job ON job.id = result.job_id JOIN device ON device.id = result.device_id
        JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
        LEFT JOIN comparison ON comparison.result_id = result.id
        LEFT JOIN image_difference AS difference ON difference.id = comparison.difference_id
        WHERE result.id > ? AND result.sweep_id = ? AND result.void IS NULL ORDER BY result.id LIMIT ?""",
        (cursor or "", sweep_id, DOCUMENTS),
    )
    return [
        {
            **{name: value for name, value in result.items() if name != "label"},
            "scene": result["label"],
            "defines": json.loads(result["defines"]),
            "document": json.loads(result["document"]),
        }
        for result in found
    ]


def _flat(result: Row) -> dict[str, Any]:
    time_s, energy_j = interval(result, "time"), interval(result, "energy")
    return {
        "id": result["id"],
        "sweep_id": result["sweep_id"],
        "job_id": result["job_id"],
        "scene": result["label"],
        "device": result["device_name"],
        "purpose": result["purpose"],
        "configuration_id": result["configuration_id"],
        "repeat": result["repeat"],
        "seed": result["seed"],
        "method": result["method"],
        "quality": result["quality"],
        "accepted": result["accepted"],
        "void": result["void"],
        "images": result["images"],
        "windows": result["windows"],
        "time_s": time_s and time_s.value,
        "time_low_s": time_s and time_s.low,
        "time_high_s": time_s and time_s.high,
        "cpu_s": unit(result["cpu_us"]),
        "energy_j": energy_j and energy_j.value,
        "energy_low_j": energy_j and energy_j.low,
        "energy_high_j": energy_j and energy_j.high,
        "difference": result["difference"],
        "pixel_sha256": result["pixel_sha256"],
        "image_sha256": result["image_sha256"],
        "received_at": timestamp(result["received_at_us"]),
        "settings": result["settings"],
    }


def of_target(db: Database, sweep_id: str, device_id: str, label: str) -> list[Row]:
    """Results of a sweep on one device and scene that were not voided, with job and difference."""
    return rows(
        db,
        """SELECT result.*, job.purpose, job.repeat, job.seed, job.configuration_id,
        difference.state AS difference_state, difference.outcome, difference.value AS difference,
        difference.reference_sha256, difference.reason AS difference_reason
        FROM result JOIN job ON job.id = result.job_id
        JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id
        LEFT JOIN comparison ON comparison.result_id = result.id
        LEFT JOIN image_difference AS difference ON difference.id = comparison.difference_id
        WHERE result.sweep_id = ? AND result.device_id = ? AND sweep_scene.label = ? AND result.void IS NULL
        ORDER BY result.id""",
        (sweep_id, device_id, label),
    )


def newest_documents(db: Database, device: str, limit: int = 20) -> list[str]:
    """The last measure documents of the device of this name, the newest first."""
    found = rows(
        db,
        """SELECT result.document FROM result JOIN device ON device.id = result.device_id
        WHERE device.name = ? AND device.revoked_at_us IS NULL ORDER BY result.id DESC LIMIT ?""",
        (device, limit),
    )
    return [str(result["document"]) for result in found]
