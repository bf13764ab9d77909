"""Access tokens and enrolment codes; only their SHA-256 is stored."""

import hmac
import secrets
from dataclasses import dataclass
from typing import Literal

from sqlite_utils import Database

from joulebox_server.errors import InvalidError, NotFoundError, UnauthenticatedError
from joulebox_server.store.database import Row, number, row, rows
from joulebox_server.store.ids import MICRO, new_id, now_us, sha256_text, timestamp

Role = Literal["admin", "operator", "viewer", "device"]
ENROLLMENT_S = 15 * 60
CODE_LETTERS = "ABCDEFGHJKLMNPQRSTUVWXYZ23456789"  # without those that look alike


@dataclass(frozen=True)
class Principal:
    """Who asks: the role, and the device behind a device's token."""

    role: Role
    token_id: str | None = None
    device_id: str | None = None


def create(db: Database, role: Role, name: str, device_id: str | None = None) -> str:
    """Make a token and return it; this is the only time it can be read."""
    token = f"jb_{secrets.token_urlsafe(32)}"
    db.execute(
        "INSERT INTO token (id, name, sha256, role, device_id, created_at_us) VALUES (?, ?, ?, ?, ?, ?)",
        (new_id(), name, sha256_text(token), role, device_id, now_us()),
    )
    return token


def principal(db: Database, token: str) -> Principal:
    """Who holds `token`. Raises UnauthenticatedError when nobody does, or not any more."""
    digest = sha256_text(token)
    found = row(db, "SELECT * FROM token WHERE sha256 = ?", (digest,))
    if found is None or not hmac.compare_digest(str(found["sha256"]), digest):
        raise UnauthenticatedError("this token is not known to the server; ask for a new one")
    if found["revoked_at_us"] is not None:
        raise UnauthenticatedError("this token was revoked; ask for a new one")
    return Principal(found["role"], found["id"], found["device_id"])


def listed(db: Database) -> list[dict[str, object]]:
    """All tokens, without anything that would let one in."""
    return [
        {
            "id": found["id"],
            "name": found["name"],
            "role": found["role"],
            "device_id": found["device_id"],
            "created_at": timestamp(found["created_at_us"]),
            "revoked_at": timestamp(found["revoked_at_us"]),
        }
        for found in rows(db, "SELECT * FROM token ORDER BY id")
    ]


def revoke(db: Database, token_id: str) -> None:
    """Shut a token out, by its id or name. Raises NotFoundError, or InvalidError when a name fits several."""
    found: list[Row] = rows(
        db, "SELECT id FROM token WHERE (id = ? OR name = ?) AND revoked_at_us IS NULL", (token_id, token_id)
    )
    if not found:
        raise NotFoundError(f"no valid token has the id or name {token_id!r}")
    if len(found) > 1:
        raise InvalidError(f"{len(found)} tokens are named {token_id!r}; give the id")
    db.execute("UPDATE token SET revoked_at_us = ? WHERE id = ?", (now_us(), found[0]["id"]))


def people_count(db: Database, *, valid: bool) -> int:
    """Tokens for people ever made, or those of them still valid."""
    condition = " AND revoked_at_us IS NULL" if valid else ""
    return number(db, f"SELECT count(*) FROM token WHERE role != 'device'{condition}")


def create_enrollment(db: Database, name: str | None) -> tuple[str, int]:
    """A one-time code for a device, and when it ends (microseconds)."""
    letters = "".join(secrets.choice(CODE_LETTERS) for _ in range(12))
    code = "-".join((letters[:4], letters[4:8], letters[8:]))
    at_us = now_us()
    expires_at_us = at_us + ENROLLMENT_S * MICRO
    db.execute("DELETE FROM enrollment WHERE expires_at_us < ?", (at_us,))
    db.execute(
        "INSERT INTO enrollment (sha256, name, created_at_us, expires_at_us) VALUES (?, ?, ?, ?)",
        (sha256_text(code), name, at_us, expires_at_us),
    )
    return code, expires_at_us


def use_enrollment(db: Database, code: str) -> None:
    """Spend a one-time code. Raises UnauthenticatedError when it is unknown, spent or too old."""
    digest = sha256_text(code.strip().upper())
    found = row(db, "SELECT * FROM enrollment WHERE sha256 = ?", (digest,))
    if found is None or found["used_at_us"] is not None or found["expires_at_us"] < now_us():
        raise UnauthenticatedError(
            "this enrolment code is unknown, used or older than 15 minutes; make a new one with "
            "`joulebox device enroll`"
        )
    db.execute("UPDATE enrollment SET used_at_us = ? WHERE sha256 = ?", (now_us(), digest))
