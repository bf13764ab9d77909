"""The discharge trace behind a point: which result holds it."""

from sqlite_utils import Database

from joulebox_server.store.database import Row, rows


def of_configuration(db: Database, sweep_id: str, device: str, label: str, configuration_id: str) -> list[Row]:
    """Documents and samples of a configuration's results on one device and scene, the first repeat first.

    Rows hold `document` (JSON text), `samples_sha256` (or None) and `repeat`; voided results stay out.
    """
    return rows(
        db,
        """SELECT result.document, result.samples_sha256, job.repeat FROM result JOIN job ON job.id = result.job_id
        JOIN sweep_scene ON sweep_scene.id = job.sweep_scene_id JOIN device ON device.id = result.device_id
        WHERE result.sweep_id = ? AND job.configuration_id = ? AND device.name = ? AND sweep_scene.label = ?
        AND job.purpose IN ('measure', 'reference') AND result.void IS NULL ORDER BY job.repeat, result.id""",
        (sweep_id, configuration_id, device, label),
    )
