"""What a sweep would take: checks and estimates before it is made, and making it exactly once."""

import json
import statistics
from collections.abc import Mapping
from typing import Any

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, FieldError, InvalidError, NotFoundError
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.store import devices, scenes, sweeps
from joulebox_server.store.database import Row, row, rows
from joulebox_server.store.ids import canonical, now_us, sha256_text
from joulebox_server.store.leases import TIMED_WINDOW_S, TIMED_WINDOWS
from joulebox_server.sweeps.checking import settings_errors
from joulebox_server.sweeps.expansion import configuration_count, configurations, plan_jobs, reference_configuration

RECENT_RESULTS = 200
CHARGE_SHARE = 0.6
"""Of a battery, used before it is charged again: from 90 to 30 %."""
START_S = 20.0
"""Added to the windows of a job in estimates: loading, compiling, the last image of a window."""


def check(db: Database, definition: SweepDefinition, max_configurations: int, max_jobs: int) -> None:
    """Raise InvalidError that names every scene, device, setting or count at fault."""
    count = configuration_count(definition)
    each = definition.repeats * (count + definition.controls)
    job_count = each * len(definition.scenes) * len(definition.devices or [""])
    wrong: list[FieldError] = []
    if count > max_configurations:
        wrong.append(FieldError("axes", f"make {count} configurations, at most {max_configurations} are accepted"))
    elif job_count > max_jobs:
        wrong.append(FieldError("repeats", f"make {job_count} jobs, at most {max_jobs} are accepted"))
    for position, entry in enumerate(definition.scenes):
        wrong += _missing(f"scenes[{position}]", scenes.find, db, entry.name)
    for position, name in enumerate(definition.devices or []):
        wrong += _missing(f"devices[{position}]", devices.find, db, name)
    for schema in _schemas(db, definition):
        wrong += [error for error in settings_errors(definition, schema) if error not in wrong]
    if wrong:
        detail = "; ".join(f"{error.field}: {error.message}" for error in wrong[:3])
        more = f"; and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        raise InvalidError(f"the sweep cannot be used: {detail}{more}", wrong)


def create_once(db: Database, definition: SweepDefinition, key: str | None) -> tuple[str, bool]:
    """Make a sweep; returns its id and whether it is new. The same `key` again gives the first one.

    Raises ConflictError when the key was used for another sweep.
    """
    if key is None:
        return sweeps.create(db, definition), True
    digest = sha256_text(canonical(definition.model_dump(mode="json")))
    known = row(db, "SELECT * FROM idempotency WHERE key_sha256 = ?", (sha256_text(key),))
    if known is not None:
        if known["body_sha256"] != digest:
            raise ConflictError("this Idempotency-Key was used for another sweep; use a new one")
        return str(known["sweep_id"]), False
    sweep_id = sweeps.create(db, definition)
    db.execute(
        "INSERT INTO idempotency (key_sha256, body_sha256, sweep_id, created_at_us) VALUES (?, ?, ?, ?)",
        (sha256_text(key), digest, sweep_id, now_us()),
    )
    return sweep_id, True


def preview(db: Database, definition: SweepDefinition) -> dict[str, Any]:
    """Jobs, hours, joules and battery charges of a checked sweep, as far as earlier results tell.

    `time_s` counts the windows that every measurement takes at least, and at most; `energy_j` multiplies the
    former with the median power of earlier results on these devices, and is None when there are none. A charge
    is what lies between 90 and 30 % of the battery that these devices told of last.
    """
    measured = configurations(definition)
    jobs = plan_jobs(definition, measured, reference_configuration(definition), "preview")
    target_count = len(definition.devices or [""])
    rules = definition.measure
    metered = sum(job.metered for job in jobs)
    floors = sum(job.purpose == "noise_floor" for job in jobs)
    timed_s = (len(jobs) - metered - floors) * (TIMED_WINDOWS * min(rules.window_s, TIMED_WINDOW_S) + START_S)
    always_s = floors * START_S + timed_s
    device_s = metered * (min(rules.min_windows * rules.window_s, rules.max_seconds) + START_S) + always_s
    most_s = metered * (min(rules.max_windows * rules.window_s, rules.max_seconds) + START_S) + always_s
    candidates = [str(device["id"]) for device in _candidates(db, definition)]
    power_w, full_j = _median_power_w(db, candidates), _battery_full_j(db, candidates)
    energy_j = None if power_w is None else power_w * device_s * target_count
    charges = None if energy_j is None or full_j is None else energy_j / (full_j * CHARGE_SHARE)
    return {
        "configurations": len(measured),
        "jobs": {
            "total": len(jobs) * target_count,
            **{
                purpose: sum(job.purpose == purpose for job in jobs) * target_count
                for purpose in ("measure", "reference", "noise_floor", "control")
            },
            "metered": metered * target_count,
        },
        "devices": target_count,
        "time_s": {"low": device_s, "high": most_s},
        "power_w": power_w,
        "energy_j": energy_j,
        "battery_charges": charges,
        "battery_full_j": full_j,
    }


def _missing(field: str, find: Any, db: Database, name: str) -> list[FieldError]:
    try:
        find(db, name)
    except NotFoundError as error:
        return [FieldError(field, str(error))]
    return []


def _candidates(db: Database, definition: SweepDefinition) -> list[Row]:
    """The devices that may work on a sweep."""
    known = devices.working(db)
    if definition.devices is not None:
        return [device for device in known if {device["id"], device["name"]} & set(definition.devices)]
    requires = definition.requires_text
    return [device for device in known if devices.fits(device["capabilities"], requires)]


def _schemas(db: Database, definition: SweepDefinition) -> list[Mapping[str, Any]]:
    """The settings schemas of the renderers on a sweep's devices, each version's once.

    For named devices all of them; else that of the device seen last, since any one will do the work.
    """
    found: dict[str, Mapping[str, Any]] = {}
    for device in _candidates(db, definition):
        if device["build"] is None or device["build"] in found:
            continue
        schema = devices.settings_schema(db, device["id"])
        if schema:
            found[str(device["build"])] = schema
            if definition.devices is None:
                break
    return list(found.values())


def _battery_full_j(db: Database, ids: list[str]) -> float | None:
    """What a full battery of these devices holds, all together one after the other: the mean of the known."""
    known = []
    for device_id in ids:
        last = row(db, "SELECT conditions FROM attempt WHERE device_id = ? ORDER BY id DESC LIMIT 1", (device_id,))
        full_j = None if last is None else json.loads(last["conditions"]).get("battery_full_j")
        if isinstance(full_j, int | float) and full_j > 0:
            known.append(float(full_j))
    return statistics.fmean(known) if known else None


def _median_power_w(db: Database, ids: list[str]) -> float | None:
    recent = rows(
        db,
        f"""SELECT energy_uj, time_us FROM result WHERE energy_uj IS NOT NULL AND time_us > 0
        AND quality = 'measured' AND device_id IN ({", ".join("?" * len(ids))}) ORDER BY id DESC LIMIT ?""",
        (*ids, RECENT_RESULTS),
    )
    if not recent:
        return None
    powers_w = [float(result["energy_uj"] / result["time_us"]) for result in recent]
    return statistics.median(powers_w)
