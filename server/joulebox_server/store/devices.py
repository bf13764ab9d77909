"""Devices: enrolment, what they can do, their health."""

import json
from typing import Any

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, NotFoundError
from joulebox_server.schemas.device import Capabilities, Health
from joulebox_server.schemas.sweep import Requires
from joulebox_server.store import events, tokens
from joulebox_server.store.database import Row, check_match, row, rows
from joulebox_server.store.ids import canonical, new_id, now_us, timestamp

FIELDS = """device.*, shown AS capabilities, build,
    (SELECT count(*) FROM attempt WHERE attempt.device_id = device.id AND attempt.state = 'leased') AS leased,
    (SELECT count(*) FROM picture_check AS one WHERE one.device_id = device.id AND agrees = 0)
    + (SELECT count(*) FROM picture_check AS two WHERE two.other_device_id = device.id
        AND two.device_id != device.id AND agrees = 0) AS disagreements
    FROM device LEFT JOIN device_capabilities AS capabilities ON capabilities.device_id = device.id"""


def enroll(db: Database, name: str, boot_id: str) -> tuple[str, str]:
    """Add a device; returns its id and its token. Raises ConflictError when the name is taken."""
    if row(db, "SELECT id FROM device WHERE name = ? AND revoked_at_us IS NULL", (name,)):
        raise ConflictError(f"a device named {name!r} is enrolled; choose another name or revoke that one first")
    device_id, at_us = new_id(), now_us()
    db.execute(
        "INSERT INTO device (id, name, boot_id, health, created_at_us, last_seen_at_us) VALUES (?, ?, ?, ?, ?, ?)",
        (device_id, name, boot_id, "good", at_us, at_us),
    )
    events.add(db, "device", None, {"device_id": device_id, "name": name, "state": "enrolled"})
    return device_id, tokens.create(db, "device", name, device_id)


def find(db: Database, key: str) -> Row:
    """A device that is not revoked, by id or name. Raises NotFoundError."""
    found = row(db, f"SELECT {FIELDS} WHERE (device.id = ? OR device.name = ?) AND revoked_at_us IS NULL", (key, key))
    if found is None:
        names = rows(db, "SELECT name FROM device WHERE revoked_at_us IS NULL ORDER BY name LIMIT 20")
        known = ", ".join(str(device["name"]) for device in names)
        hint = f"enrolled are {known}" if known else "none is enrolled yet"
        raise NotFoundError(f"no device has the id or name {key!r}; {hint}")
    return found


def listed(db: Database, limit: int, cursor: str | None) -> list[Row]:
    """Devices that are not revoked, by name, those after the name `cursor`; `capabilities` is JSON text or None."""
    return rows(
        db,
        f"SELECT {FIELDS} WHERE revoked_at_us IS NULL AND device.name > ? ORDER BY device.name LIMIT ?",
        (cursor or "", limit),
    )


def working(db: Database) -> list[Row]:
    """Devices that are given jobs, the most recently seen first: `id`, `name`, `capabilities`, `build`."""
    return rows(
        db,
        """SELECT id, name, shown AS capabilities, build FROM device
        LEFT JOIN device_capabilities ON device_id = id WHERE revoked_at_us IS NULL AND health != 'retired'
        ORDER BY last_seen_at_us DESC""",
    )


def fleet_build(db: Database) -> str | None:
    """The renderer's name and version that most devices in service have; None when none told its own."""
    found = row(
        db,
        """SELECT build FROM device JOIN device_capabilities ON device_id = id
        WHERE revoked_at_us IS NULL AND health != 'retired' AND build IS NOT NULL
        GROUP BY build ORDER BY count(*) DESC, build DESC LIMIT 1""",
    )
    return None if found is None else str(found["build"])


def document(device: Row, fleet: str | None, *, now: int) -> dict[str, Any]:
    """A device as the API shows it; `fleet` is the build of the others."""
    return {
        "id": device["id"],
        "name": device["name"],
        "health": device["health"],
        "health_reason": device["health_reason"],
        "failures_in_row": device["failures_in_row"],
        "created_at": timestamp(device["created_at_us"]),
        "last_seen_at": timestamp(device["last_seen_at_us"]),
        "last_seen_age_s": max(0, now - device["last_seen_at_us"]) / 1e6,
        "leased_jobs": device["leased"],
        "capabilities": json.loads(device["capabilities"]) if device["capabilities"] else None,
        "disagreements": device["disagreements"],
        "flags": list(_flags(device, fleet)),
    }


def _flags(device: Row, fleet: str | None) -> list[dict[str, str]]:
    flags = []
    if device["health"] == "suspect":
        why = device["health_reason"] or "an operator marked it"
        flags.append({"code": "suspect", "message": f"gets no jobs until its health is set to good: {why}"})
    if device["build"] is not None and fleet is not None and device["build"] != fleet:
        message = f"renders with {device['build']}, most of the fleet with {fleet}"
        flags.append({"code": "other_build", "message": message})
    if device["disagreements"]:
        message = f"{device['disagreements']} picture(s) differ from what another device made of the same settings"
        flags.append({"code": "pictures_disagree", "message": message})
    return flags


def set_capabilities(db: Database, device_id: str, capabilities: Capabilities) -> None:
    """Replace what is known of a device."""
    found = capabilities.model_dump(mode="json")
    whole = canonical(found)
    renderer = capabilities.renderer
    if renderer is not None:
        found["renderer"].pop("settings_schema")
    db.execute(
        """INSERT INTO device_capabilities (device_id, document, shown, build, updated_at_us)
        VALUES (?, ?, ?, ?, ?) ON CONFLICT (device_id) DO UPDATE SET document = excluded.document,
        shown = excluded.shown, build = excluded.build, updated_at_us = excluded.updated_at_us""",
        (
            device_id,
            whole,
            canonical(found),
            None if renderer is None else f"{renderer.name} {renderer.version}",
            now_us(),
        ),
    )
    db.execute("UPDATE device SET last_seen_at_us = ? WHERE id = ?", (now_us(), device_id))
    events.add(db, "device", None, {"device_id": device_id, "state": "ready"})


def settings_schema(db: Database, device_id: str) -> dict[str, Any] | None:
    """The JSON Schema of the settings that a device's renderer takes, None when it told none."""
    found = row(db, "SELECT document FROM device_capabilities WHERE device_id = ?", (device_id,))
    renderer = None if found is None else json.loads(found["document"])["renderer"]
    return None if renderer is None else renderer["settings_schema"]


def set_health(db: Database, key: str, health: Health, wanted: str | None = None) -> str:
    """Change a device's health; returns its id. Only one in good health gets jobs.

    wanted  the If-Match header: PreconditionError unless it names the device's state
    """
    device = find(db, key)
    check_match(wanted, device["version"], f"the device {device['name']!r}")
    forgive(db, device["id"])
    mark(db, device["id"], health, None)
    return str(device["id"])


def forgive(db: Database, device_id: str) -> None:
    """End a device's row of failures: a good result came, or an operator looked at it."""
    ended = db.execute("UPDATE device SET failures_in_row = 0 WHERE id = ? AND failures_in_row > 0", (device_id,))
    if ended.rowcount:
        db.execute("UPDATE attempt SET in_row = 0 WHERE device_id = ? AND in_row = 1", (device_id,))


def mark(db: Database, device_id: str, health: Health, reason: str | None) -> None:
    """Change a device's health and say so; `reason` is for people."""
    db.execute(
        "UPDATE device SET health = ?, health_reason = ?, version = version + 1 WHERE id = ?",
        (health, reason, device_id),
    )
    events.add(db, "device", None, {"device_id": device_id, "state": health, "reason": reason})


def rotate_token(db: Database, key: str) -> tuple[str, str]:
    """A new token for a device, its old ones shut out; returns id and token."""
    device = find(db, key)
    _revoke_tokens(db, device["id"])
    return device["id"], tokens.create(db, "device", device["name"], device["id"])


def revoke(db: Database, key: str) -> str:
    """Shut a device out; its results stay. Returns its id. (`leases.revoke` also takes its jobs back.)"""
    device_id = str(find(db, key)["id"])
    _revoke_tokens(db, device_id)
    db.execute("UPDATE device SET revoked_at_us = ? WHERE id = ?", (now_us(), device_id))
    events.add(db, "device", None, {"device_id": device_id, "state": "revoked"})
    return device_id


def fits(capabilities: str | None, requires: str | None) -> bool:
    """Whether a device with these capabilities is what a target asks for (both JSON text)."""
    if requires is None:
        return True
    if capabilities is None:
        return False
    wish = Requires.model_validate_json(requires)
    has = Capabilities.model_validate_json(capabilities)
    renderer = has.renderer
    same = all(
        wanted is None or (found or "").casefold().startswith(wanted.casefold())
        for wanted, found in (
            (wish.platform, has.platform),
            (wish.machine, has.machine),
            (wish.os, has.os),
            (wish.isa, has.isa),
            (wish.renderer, None if renderer is None else renderer.name),
        )
    )
    methods = {method.method for method in has.energy_methods if method.available}
    version = None if renderer is None else renderer.version
    return (
        same
        and (wish.min_cores is None or has.cores >= wish.min_cores)
        and (wish.energy_method is None or wish.energy_method in methods)
        and (wish.renderer_version is None or wish.renderer_version == version)
    )


def _revoke_tokens(db: Database, device_id: str) -> None:
    db.execute(
        "UPDATE token SET revoked_at_us = ? WHERE device_id = ? AND revoked_at_us IS NULL", (now_us(), device_id)
    )
