"""Devices: enrolment, what they can do, their health."""

import json
from typing import Any

from sqlite_utils import Database

from joulebox_server.errors import ConflictError, NotFoundError
from joulebox_server.schemas.device import Capabilities, Health
from joulebox_server.schemas.sweep import Requires
from joulebox_server.store import events, tokens
from joulebox_server.store.database import Row, row, rows
from joulebox_server.store.ids import canonical, new_id, now_us, timestamp

FIELDS = """device.*, capabilities.document AS capabilities,
    (SELECT count(*) FROM attempt WHERE attempt.device_id = device.id AND attempt.state = 'leased') AS leased
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
        known = [str(device["name"]) for device in rows(db, "SELECT name FROM device WHERE revoked_at_us IS NULL")]
        hint = f"enrolled are {', '.join(known[:20])}" if known else "none is enrolled yet"
        raise NotFoundError(f"no device has the id or name {key!r}; {hint}")
    return found


def enrolled(db: Database) -> list[Row]:
    """Every device that is not revoked, the most recently seen first, `capabilities` as JSON text or None."""
    return rows(db, f"SELECT {FIELDS} WHERE revoked_at_us IS NULL ORDER BY last_seen_at_us DESC LIMIT 1000")


def document(device: Row, *, now: int) -> dict[str, Any]:
    """A device as the API shows it. The settings schema is left out: it is long and the same for most."""
    capabilities = json.loads(device["capabilities"]) if device["capabilities"] else None
    if capabilities and capabilities.get("renderer"):
        capabilities["renderer"].pop("settings_schema", None)
    return {
        "id": device["id"],
        "name": device["name"],
        "health": device["health"],
        "created_at": timestamp(device["created_at_us"]),
        "last_seen_at": timestamp(device["last_seen_at_us"]),
        "last_seen_age_s": max(0, now - device["last_seen_at_us"]) / 1e6,
        "leased_jobs": device["leased"],
        "capabilities": capabilities,
    }


def set_capabilities(db: Database, device_id: str, capabilities: Capabilities) -> None:
    """Replace what is known of a device."""
    db.execute(
        """INSERT INTO device_capabilities (device_id, document, updated_at_us) VALUES (?, ?, ?)
        ON CONFLICT (device_id) DO UPDATE SET document = excluded.document,
        updated_at_us = excluded.updated_at_us""",
        (device_id, canonical(capabilities.model_dump(mode="json")), now_us()),
    )
    db.execute("UPDATE device SET last_seen_at_us = ? WHERE id = ?", (now_us(), device_id))
    events.add(db, "device", None, {"device_id": device_id, "state": "ready"})


def set_health(db: Database, key: str, health: Health) -> str:
    """Change a device's health; returns its id. One in maintenance or retired gets no jobs."""
    device_id = str(find(db, key)["id"])
    db.execute("UPDATE device SET health = ? WHERE id = ?", (health, device_id))
    events.add(db, "device", None, {"device_id": device_id, "state": health})
    return device_id


def rotate_token(db: Database, key: str) -> tuple[str, str]:
    """A new token for a device, its old ones shut out; returns id and token."""
    device = find(db, key)
    _revoke_tokens(db, device["id"])
    return device["id"], tokens.create(db, "device", device["name"], device["id"])


def revoke(db: Database, key: str) -> str:
    """Shut a device out; its results stay. Returns its id. Its unfinished jobs return when their leases end."""
    device_id = str(find(db, key)["id"])
    _revoke_tokens(db, device_id)
    db.execute("UPDATE device SET revoked_at_us = ? WHERE id = ?", (now_us(), device_id))
    events.add(db, "device", None, {"device_id": device_id, "state": "revoked"})
    return device_id


def fits(capabilities: str | None, requires: str | None) -> bool:
    """Whether a device with this capabilities document is what a target asks for (both JSON text)."""
    if requires is None:
        return True
    if capabilities is None:
        return False
    wish = Requires.model_validate_json(requires)
    has = Capabilities.model_validate_json(capabilities)
    same = all(
        wanted is None or (found or "").casefold().startswith(wanted.casefold())
        for wanted, found in (
            (wish.platform, has.platform),
            (wish.machine, has.machine),
            (wish.os, has.os),
            (wish.isa, has.isa),
        )
    )
    methods = {method.method for method in has.energy_methods if method.available}
    return (
        same
        and (wish.min_cores is None or has.cores >= wish.min_cores)
        and (wish.energy_method is None or wish.energy_method in methods)
    )


def _revoke_tokens(db: Database, device_id: str) -> None:
    db.execute(
        "UPDATE token SET revoked_at_us = ? WHERE device_id = ? AND revoked_at_us IS NULL", (now_us(), device_id)
    )
