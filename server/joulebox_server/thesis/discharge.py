"""The power of a discharge over time: measured by the study's device, or replayed where it can measure nothing."""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from joulebox_server.cli.connection import CommandError, Connection
from joulebox_server.thesis.rows import Row

FILE = "discharge.json"
REPLAY = ("--source", "replay", "--window-s", "9", "--min-windows", "4", "--max-windows", "4",
          "--set", "width=64", "--set", "height=64", "--set", "threads=1")  # fmt: skip
"""Half a minute of the scripted trace, whose values change every 3 to 5 s as the thesis' gauge did."""


@dataclass(frozen=True)
class Discharge:
    """Gauge updates of one measurement: (seconds, watts), and whether a device's own or a scripted trace's."""

    quality: str
    samples: tuple[tuple[float, float], ...]


def read(folder: Path) -> Discharge | None:
    """The discharge that a study's folder keeps, None without one."""
    try:
        told = json.loads((folder / FILE).read_text(encoding="utf-8"))
        return Discharge(told["quality"], tuple((float(t), float(w)) for t, w in told["samples"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def keep_replayed(folder: Path, agent: str, scene: Path) -> None:
    """Measure a scene with the scripted trace as the source, and keep its samples."""
    kept = folder / "discharge"
    command = [agent, "measure", str(scene), *REPLAY, "--keep", str(kept), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["it wrote nothing"]
        raise CommandError(f"the discharge could not be replayed: {lines[-1]}")
    sha256 = json.loads(done.stdout)["power_samples"]
    _keep(folder, "replayed", (kept / f"{sha256}.ndjson").read_text(encoding="utf-8"))


def keep_measured(folder: Path, connection: Connection, rows: list[Row]) -> None:
    """Keep the samples of the longest-lasting picture that was measured."""
    measured = [row for row in rows if row.quality == "measured" and row.samples_sha256]
    if measured:
        row = max(measured, key=lambda row: row.image.time_s)
        _keep(folder, "measured", connection.request("GET", f"/blobs/{row.samples_sha256}").text)


def _keep(folder: Path, quality: str, ndjson: str) -> None:
    """Updates alone: a gauge that is polled faster than it refreshes tells one value many times."""
    updates: list[tuple[float, float]] = []
    for line in ndjson.splitlines():
        sample = json.loads(line)
        power_w = sample.get("power_w")
        if power_w is not None and (not updates or power_w != updates[-1][1]):
            updates.append((sample["time_s"], power_w))
    (folder / FILE).write_text(json.dumps({"quality": quality, "samples": updates}), encoding="utf-8")
