"""What the last results of each device tell of it: battery, meter, control run."""

import json
from typing import Any

from sqlite_utils import Database

from joulebox_server.store.database import Row, row, rows
from joulebox_server.store.ids import timestamp


def listed(db: Database, limit: int, cursor: str | None) -> list[dict[str, Any]]:
    """The state of devices that are not revoked, by name, those after the name `cursor`."""
    found = rows(
        db,
        "SELECT id, name FROM device WHERE revoked_at_us IS NULL AND name > ? ORDER BY name LIMIT ?",
        (cursor or "", limit),
    )
    controls = _last_controls(db)
    return [_state(device, _last_result(db, device["id"]), controls.get(device["id"])) for device in found]


def _last_result(db: Database, device_id: str) -> Row | None:
    return row(
        db,
        """SELECT document, energy_uj, energy_low_uj, energy_high_uj, received_at_us FROM result
        WHERE device_id = ? ORDER BY id DESC LIMIT 1""",
        (device_id,),
    )


def _last_controls(db: Database) -> dict[str, Row]:
    """The newest control run of each device, by its id."""
    found = rows(
        db,
        """SELECT result.device_id, result.received_at_us, result.sweep_id, label, time_ratio, energy_ratio
        FROM control_run JOIN result ON result.id = control_run.result_id
        JOIN sweep_scene ON sweep_scene.id = control_run.sweep_scene_id ORDER BY result.id""",
    )
    return {control["device_id"]: control for control in found}


def _state(device: Row, result: Row | None, control: Row | None) -> dict[str, Any]:
    document = None if result is None else json.loads(result["document"])
    return {
        "device": device["name"],
        "result_at": None if result is None else timestamp(result["received_at_us"]),
        "battery": None if document is None else _battery(document.get("conditions") or {}),
        "meter": None if result is None or document is None else _meter(result, document),
        "control": control
        and {
            "sweep_id": control["sweep_id"],
            "scene": control["label"],
            "time_ratio": control["time_ratio"],
            "energy_ratio": control["energy_ratio"],
            "at": timestamp(control["received_at_us"]),
        },
    }


def _battery(conditions: dict[str, Any]) -> dict[str, Any] | None:
    """What was told of the battery after the measurement, else before; None for a device that has none."""
    for told in (conditions.get("after"), conditions.get("before")):
        known = told if isinstance(told, dict) else {}
        charge, full_j = known.get("battery_charge_share"), known.get("battery_full_j")
        if charge is not None or full_j is not None:
            return {"charge_share": charge, "full_j": full_j, "on_mains": known.get("mains_online")}
    return None


def _meter(result: Row, document: dict[str, Any]) -> dict[str, Any]:
    """How the energy of the last result was known: by what, how often it is read, and how closely it came out."""
    energy_uj = result["energy_uj"]
    close = energy_uj and (result["energy_high_uj"] - result["energy_low_uj"]) / (2 * energy_uj)
    return {
        "method": document["method"],
        "scope": document.get("scope"),
        "quality": document["quality"],
        "refresh_s": document.get("refresh_s"),
        "half_width_share": close or None,
    }
