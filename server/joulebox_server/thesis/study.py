"""A run of the study: its folder, its sweeps submitted once, watched to their end, and their rows kept."""

import json
import os
import uuid
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from joulebox_server.cli.connection import CommandError, Connection, WrongUseError, checked
from joulebox_server.cli.sweep_file import SCENE_FILE, send_scenes
from joulebox_server.store.ids import canonical, sha256_text
from joulebox_server.thesis import discharge
from joulebox_server.thesis.batch import Batch, Plan, Sweep
from joulebox_server.thesis.following import Follower
from joulebox_server.thesis.reading import read_row
from joulebox_server.thesis.results import Results
from joulebox_server.thesis.rows import CostBasis, Row

STUDY_FILE, ROWS_FILE = "study.json", "rows.ndjson"
EXPOSURE = 3.0
"""Of the Cornell scenes."""
FULL_REPEATS = 3
TIMED = {"window_s": 0.05, "min_windows": 1, "max_windows": 1, "meter": "none"}
TIMED_AGAIN = {"window_s": 5.0, "min_windows": 3, "max_windows": 3, "max_seconds": 1800.0}
METERED = {"window_s": 60.0, "min_windows": 3, "max_windows": 10, "max_seconds": 1800.0}
"""Of a quick run, which times single images, of a full one where nothing can be metered, and of a full one."""


@dataclass(frozen=True)
class Study:
    """What a folder holds: one run, quick or full, on one server; `metered` unless nothing could meter at its start.

    source   of the agent that is started here: `auto`, or one that was asked for
    """

    folder: Path
    id: str
    quick: bool
    server: str | None
    device: str | None
    metered: bool
    source: str = "auto"

    @property
    def plan(self) -> Plan:
        """How thorough the run is."""
        return Plan(self.quick)

    @classmethod
    def opened(
        cls,
        folder: Path,
        quick: bool,
        server: str | None = None,
        device: str | None = None,
        can_meter: Callable[[], bool] = lambda: True,
        source: str = "auto",
    ) -> "Study":
        """The study in a folder, a new one in an empty or new folder. `can_meter` is asked for a new one that is full.

        Raises WrongUseError for a folder that cannot be written, holds something else, or a study of another kind.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
            known = _known(folder)
            if known is None:
                if any(folder.iterdir()):
                    raise WrongUseError(f"{folder} is not empty and holds no study; give a new folder with -o")
                known = {
                    "id": str(uuid.uuid4()),
                    "quick": quick,
                    "server": server,
                    "device": device,
                    "metered": not quick and can_meter(),
                    "source": source,
                }
                _write(folder / STUDY_FILE, json.dumps(known, indent=1) + "\n")
        except OSError as error:
            raise WrongUseError(f"{error.filename or folder} cannot be used: {error.strerror}") from None
        wanted = {"quick": quick, "server": server, "device": device, "source": source}
        for name, value in wanted.items():
            if known[name] != value:
                was = "was started" + (f" with --{name}" if known[name] else f" without --{name}")
                more = f" {known[name]}" if isinstance(known[name], str) else ""
                raise WrongUseError(f"the study in {folder} {was}{more}; go on with the same, or give another folder")
        return cls(folder, **known)

    @classmethod
    def found(cls, folder: Path) -> "Study":
        """The study that a folder already holds. Raises WrongUseError without one."""
        known = _known(folder)
        if known is None:
            raise WrongUseError(f"{folder} holds no study; run `joulebox thesis -o {folder}` first")
        return cls(folder, **known)

    # --- running -------------------------------------------------------------------------------------------

    def run(self, batches: Sequence[Batch], connection: Connection, scenes: Path, follow: Follower) -> None:
        """Submit the batches' sweeps unless that was done before, wait for their end, keep their rows.

        Raises CommandError when a job failed for good, WrongUseError when the folder's sweeps are those of another
        version of the study.
        """
        submitted = {}
        self.send_scenes(batches, connection, scenes)
        with connection.opened() as client:
            for sweep in self._sweeps(batches):
                key = sha256_text(canonical([self.id, sweep["name"]]))
                answer = client.post("/v1/sweeps", json=self.definition(sweep), headers={"Idempotency-Key": key})
                if answer.status_code == 409:
                    raise WrongUseError(
                        f"the sweep {sweep['name']} in {self.folder} was made by another version of the study; "
                        "start again in a new folder"
                    )
                submitted[sweep["name"]] = checked(answer).json()
        for found in submitted.values():
            if found["state"] == "failed":
                connection.request("POST", f"/sweeps/{found['id']}:retry-failed")
        ids = {name: str(found["id"]) for name, found in submitted.items()}
        # Kept as each ends, so that an interrupted study has a report too.
        ended = follow.until_ended(connection, ids, lambda name: self._keep(connection, name, ids[name]))
        failed = {name: found for name, found in ended.items() if found["state"] != "done"}
        if failed:
            name, found = next(iter(failed.items()))
            jobs = connection.json("GET", f"/sweeps/{found['id']}/jobs", params={"limit": 200})["items"]
            why = next((job["reason"] for job in jobs if job["state"] == "failed"), found["state"])
            raise CommandError(
                f"{len(failed)} sweeps did not end well, {name} because {why}; the same command tries again, and "
                "--report-only writes the report of the rest"
            )

    def send_scenes(self, batches: Sequence[Batch], connection: Connection, scenes: Path) -> None:
        """Send the server every scene that the batches render, once; it keeps one that it has."""
        entries = [entry for sweep in self._sweeps(batches) for entry in sweep["scenes"]]
        names = dict.fromkeys(entry if isinstance(entry, str) else entry["name"] for entry in entries)
        with connection.opened() as client:
            send_scenes(client, {"scenes": list(names)}, scenes)

    def expected_s(self, batches: Sequence[Batch], connection: Connection) -> tuple[float, float]:
        """How long the batches take one device, at least and at most [s], by the server's previews.

        The server must have their scenes.
        """
        low_s = high_s = 0.0
        for sweep in self._sweeps(batches):
            time_s = connection.json("POST", "/sweeps:preview", json=self.definition(sweep))["time_s"]
            low_s, high_s = low_s + time_s["low"], high_s + time_s["high"]
        return low_s, high_s

    def _sweeps(self, batches: Sequence[Batch]) -> list[Sweep]:
        """All sweeps of the batches, in the order in which they are run."""
        return [sweep for batch in batches for sweep in batch.sweeps(self.plan)]

    def definition(self, sweep: Sweep) -> dict[str, Any]:
        """A batch's sweep with what is the same for all: seeds, exposure, repeats, how to measure, on what."""
        same = {
            "exposure": EXPOSURE,
            "repeats": 1 if self.quick else FULL_REPEATS,
            "controls": 0 if self.quick else 1,
            "measure": TIMED if self.quick else METERED if self.metered else TIMED_AGAIN,
        }
        settings = ({"threads": 1} if self.quick else {}) | sweep.get("settings", {})
        reference = {"seed_policy": "same"} | sweep.get("reference", {})
        reference["settings"] = {name: v for name, v in reference["settings"].items() if name != "preset"}
        preset = settings.pop("preset", None)
        devices = {} if self.device is None else {"devices": [self.device]}
        return same | sweep | {"settings": settings, "reference": reference, "preset": preset} | devices

    # --- rows ----------------------------------------------------------------------------------------------

    def _keep(self, connection: Connection, name: str, sweep_id: str) -> None:
        """Add the rows of a sweep to the folder; those of the same name are replaced."""
        kept = [row for row in self.rows() if row.sweep != name]
        lines = connection.request("GET", f"/sweeps/{sweep_id}/measurements").text.splitlines()
        kept += [read_row(name, json.loads(line)) for line in lines]
        _write(self.folder / ROWS_FILE, "".join(json.dumps(asdict(row)) + "\n" for row in kept))

    @property
    def pictures(self) -> Path:
        """The folder of the pictures that figures show, by hash."""
        return self.folder / "pictures"

    def keep_pictures(self, connection: Connection, wanted: Sequence[str]) -> None:
        """Fetch pictures by their hashes, those that are not here yet."""
        self.pictures.mkdir(exist_ok=True)
        for sha256 in dict.fromkeys(wanted):
            path = self.pictures / f"{sha256}.png"
            if not path.is_file():
                answer = connection.request("GET", f"/images/{sha256}.png", params={"exposure": EXPOSURE})
                path.write_bytes(answer.content)

    def results(self) -> Results:
        """Everything measured so far, with the discharge."""
        rows = self.rows()
        return Results(tuple(rows), basis_of(rows), self.quick, discharge.read(self.folder))

    def rows(self) -> list[Row]:
        """Rows kept so far."""
        path = self.folder / ROWS_FILE
        try:
            lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
            return [Row.from_json(json.loads(line)) for line in lines]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CommandError(
                f"{path} cannot be read: {error}; run the study again, it keeps what it measured"
            ) from None


def basis_of(rows: Sequence[Row]) -> CostBasis:
    """Joules if all that was to be metered has them, measured rather than replayed; else time."""
    qualities = {row.quality for row in rows if row.purpose in ("measure", "reference")}
    if qualities == {"measured"}:
        return "measured"
    return "replayed" if qualities == {"replayed"} else "time"


def scene_folder(given: Path | None) -> Path:
    """The folder of the scenes: as given, of this checkout, or below the working folder. Raises WrongUseError."""
    candidates = [given] if given is not None else [Path(__file__).resolve().parents[3] / "scenes", Path("scenes")]
    for folder in candidates:
        if (folder / "cornell-boxes" / SCENE_FILE).is_file():
            return folder
    raise WrongUseError(f"the scenes are not in {' nor in '.join(map(str, candidates))}; say where with --scenes")


def _known(folder: Path) -> dict[str, Any] | None:
    path = folder / STUDY_FILE
    try:
        if not path.is_file():
            return None
        known = json.loads(path.read_text(encoding="utf-8"))
        names = ("id", "quick", "server", "device", "metered", "source")
        return {name: known[name] for name in names}
    except OSError as error:
        raise WrongUseError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise WrongUseError(f"{path} is damaged; start again in a new folder") from None


def _write(path: Path, text: str) -> None:
    """Whole or not at all."""
    draft = path.with_suffix(".tmp")
    draft.write_text(text, encoding="utf-8")
    os.replace(draft, path)
