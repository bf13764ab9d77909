"""Numbers for Prometheus, counted on a scrape from the store; `envelope` counts requests as they pass."""

from collections.abc import Iterator

from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from sqlite_utils import Database

from joulebox_server.store import Store, blobs, differences
from joulebox_server.store.database import Row, number, rows
from joulebox_server.store.life import JOB_STATES


class StoreCollector(Collector):
    """Gauges of what is stored."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def collect(self) -> Iterator[Metric]:
        """One read of the database."""
        jobs, single = self._store.read(_counted)
        by_state = GaugeMetricFamily("joulebox_jobs", "Jobs by state.", labels=["state"])
        counts = dict.fromkeys(JOB_STATES, 0) | {job["state"]: job["n"] for job in jobs}
        for state, count in counts.items():
            by_state.add_metric([state], count)
        yield by_state
        for name, (text, value) in single.items():
            yield GaugeMetricFamily(f"joulebox_{name}", text, value=value)


def _counted(db: Database) -> tuple[list[Row], dict[str, tuple[str, int]]]:
    return rows(db, "SELECT state, count(*) AS n FROM job GROUP BY state"), {
        "devices": (
            "Devices that are enrolled.",
            number(db, "SELECT count(*) FROM device WHERE revoked_at_us IS NULL"),
        ),
        "running_sweeps": (
            "Sweeps that run.",
            number(db, "SELECT count(*) FROM sweep WHERE state = 'running'"),
        ),
        "results": ("Results that are stored.", number(db, "SELECT count(*) FROM result")),
        "blob_bytes": ("Bytes of all blobs.", blobs.total_bytes(db)),
        "pending_differences": ("Differences to be computed.", differences.pending_count(db)),
    }
