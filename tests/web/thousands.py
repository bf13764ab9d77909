"""A sweep of thousands of points, for timing alone: the stored grid's results again and again, costs and values moved.

Nothing of it is a finding; it goes straight into the tables, because two thousand jobs through HTTP take minutes.
"""

import json
import math
import random
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from stored import GRID

NAME = "thousands"


class _Copier:
    """Rows copied under new ids, within one database."""

    def __init__(self, database: sqlite3.Connection) -> None:
        database.row_factory = sqlite3.Row
        self.database = database
        self.count = 0

    def rows(self, sql: str, *values: Any) -> list[dict[str, Any]]:
        return [dict(found) for found in self.database.execute(sql, values)]

    def add(self, table: str, row: dict[str, Any], **changes: Any) -> str:
        """The id of the copy; a table without ids gets none."""
        self.count += 1
        new = f"02000000-0000-7000-8000-{self.count:012d}"
        made = row | ({"id": new} if "id" in row else {}) | changes
        places = ", ".join("?" * len(made))
        self.database.execute(f"INSERT INTO {table} ({', '.join(made)}) VALUES ({places})", tuple(made.values()))
        return new


def add_thousands(path: Path, count: int) -> None:
    """Add a finished sweep of `count` configurations to the database of a stored server."""
    with closing(sqlite3.connect(path)) as database, database:
        copier = _Copier(database)
        (sweep,) = copier.rows("SELECT * FROM sweep WHERE name = ?", GRID)
        (scene, *_) = copier.rows("SELECT * FROM sweep_scene WHERE sweep_id = ? ORDER BY position", sweep["id"])
        (target,) = copier.rows("SELECT * FROM target WHERE sweep_id = ?", sweep["id"])
        definition = json.loads(sweep["definition"])
        definition |= {
            "name": NAME,
            "scenes": definition["scenes"][:1],
            "axes": {"global_photons": [1], "final_gather_rays": [1]},
        }
        new_sweep = copier.add("sweep", sweep, name=NAME, definition=json.dumps(definition))
        new_scene = copier.add("sweep_scene", scene, sweep_id=new_sweep)
        new_target = copier.add("target", target, sweep_id=new_sweep)
        jobs = copier.rows(
            "SELECT * FROM job WHERE sweep_scene_id = ? AND purpose != 'control' AND repeat = 0", scene["id"]
        )
        reference = next(job for job in jobs if job["purpose"] == "reference")
        measured = [job for job in jobs if job["purpose"] == "measure"]
        moved = {"sweep_id": new_sweep, "target_id": new_target, "sweep_scene_id": new_scene}
        base = _add_job(copier, reference, moved, None, None)
        for place in range(count):
            _add_job(copier, measured[place % len(measured)], moved, place, base)


def _add_job(copier: _Copier, job: dict[str, Any], moved: dict[str, str], place: int | None, base: str | None) -> str:
    """One job with its result; returns the result's id. Photons and rays are those of the place-th of a grid."""
    configuration = job["configuration_id"]
    factor = 1.0
    if place is not None:
        (known,) = copier.rows("SELECT * FROM configuration WHERE id = ?", configuration)
        rays, photons = 8 * (1 + place % 50), 1000 * (1 + place // 50)
        factor = (0.2 + rays / 100 + photons / 20_000) * random.Random(place).lognormvariate(0, 0.05)
        settings = json.loads(known["settings"]) | {"final_gather_rays": rays, "global_photons": photons}
        configuration = copier.add("configuration", known, sha256=f"{place:064x}", settings=json.dumps(settings))
    new_job = copier.add("job", job, **moved, configuration_id=configuration)
    (result,) = copier.rows("SELECT * FROM result WHERE job_id = ? LIMIT 1", job["id"])
    (attempt,) = copier.rows("SELECT * FROM attempt WHERE id = ?", result["attempt_id"])
    document = json.loads(result["document"])
    if place is not None:
        document["settings"] |= {"final_gather_rays": rays, "global_photons": photons}
        for cost in (
            document["time_s_per_image"],
            document["cpu_s_per_image"],
            document["energy_j_per_image"]["gross"],
        ):
            cost.update({bound: factor * value for bound, value in cost.items()})
    new_result = copier.add(
        "result", result, attempt_id=copier.add("attempt", attempt, job_id=new_job), job_id=new_job,
        sweep_id=moved["sweep_id"], document=json.dumps(document),
    )  # fmt: skip
    for compared in copier.rows("SELECT * FROM comparison WHERE result_id = ?", result["id"]) if base else []:
        (found,) = copier.rows("SELECT * FROM image_difference WHERE id = ?", compared["difference_id"])
        value = found["value"] / math.sqrt(factor) * random.Random(-factor).lognormvariate(0, 0.4)
        difference = copier.add("image_difference", found, value=value, test_sha256=f"{place:064x}")
        ends = {"result_id": new_result, "reference_result_id": base, "sweep_id": moved["sweep_id"]}
        copier.add("comparison", compared, **ends, difference_id=difference)
    return new_result
