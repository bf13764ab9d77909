"""Scene bundles: a name and the zip it means now."""

from typing import Any

from sqlite_utils import Database

from joulebox_server.errors import NotFoundError
from joulebox_server.store.database import Row, row, rows
from joulebox_server.store.ids import new_id, now_us, timestamp

# A name means the bundle that was sent under it last; sweeps keep the one they were made with.
CURRENT = """FROM scene WHERE created_at_us =
    (SELECT max(created_at_us) FROM scene AS other WHERE other.name = scene.name)"""


def put(db: Database, name: str, bundle_sha256: str) -> bool:
    """Let `name` mean this bundle (its blob is stored); False when it did already."""
    known = row(db, f"SELECT bundle_sha256, created_at_us {CURRENT} AND name = ?", (name,))
    if known and known["bundle_sha256"] == bundle_sha256:
        return False
    # Later than the last one, also when the machine's clock was set back meanwhile.
    at_us = max(now_us(), known["created_at_us"] + 1 if known else 0)
    db.execute(
        """INSERT INTO scene (id, name, bundle_sha256, created_at_us) VALUES (?, ?, ?, ?)
        ON CONFLICT (name, bundle_sha256) DO UPDATE SET created_at_us = excluded.created_at_us""",
        (new_id(), name, bundle_sha256, at_us),
    )
    return True


def find(db: Database, name: str) -> Row:
    """The scene that a name means now. Raises NotFoundError."""
    found = row(db, f"SELECT * {CURRENT} AND name = ?", (name,))
    if found is None:
        known = [str(scene["name"]) for scene in rows(db, f"SELECT name {CURRENT} ORDER BY name LIMIT 20")]
        hint = f"known are {', '.join(known)}" if known else "none has been sent to the server yet"
        raise NotFoundError(f"no scene is named {name!r}; {hint}")
    return found


def listed(db: Database, limit: int, cursor: str | None) -> list[dict[str, Any]]:
    """Scenes by name, those after the name `cursor`."""
    found = rows(db, f"SELECT * {CURRENT} AND name > ? ORDER BY name LIMIT ?", (cursor or "", limit))
    return [
        {
            "name": scene["name"],
            "bundle_sha256": scene["bundle_sha256"],
            "created_at": timestamp(scene["created_at_us"]),
        }
        for scene in found
    ]
