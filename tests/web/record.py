"""Measures the two sweeps that the dashboard's tests look at, with the real agent and renderer.

    python tests/web/record.py

Writes `tests/web/data/fleet.zip`, a backup (`joulebox backup`) of the server that took them, and takes about
ten minutes. Times, pictures, differences and failures are real; joules are replayed and labelled so, unless
this machine has an energy source and `--source` names it.
"""

import argparse
import json
import os
import platform
import sqlite3
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

DATA = Path(__file__).resolve().parent / "data"
PROGRAMS = Path(sys.executable).parent
START_S, END_S, POLL_S = 60.0, 20.0, 10.0


def ask(*command: str) -> str:
    """What a command prints; its own words on standard error are shown."""
    print("$", *command, flush=True)
    program = [sys.executable, str(PROGRAMS / command[0]), *command[1:]]
    return subprocess.run(program, check=True, stdout=subprocess.PIPE, text=True).stdout


@contextmanager
def running(*command: str) -> Iterator[None]:
    """A command in the background, ended with the block."""
    print("$", *command, "&", flush=True)
    with subprocess.Popen([sys.executable, str(PROGRAMS / command[0]), *command[1:]]) as process:
        try:
            yield
        finally:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()


def address(folder: Path) -> str:
    """The server's address, once it has written it."""
    file = folder / "server.json"
    ends_s = time.monotonic() + START_S
    while not file.is_file():
        if time.monotonic() > ends_s:
            sys.exit(f"the server did not start within {START_S:.0f} s")
        time.sleep(0.1)
    return str(json.loads(file.read_text())["url"])


def wait(sweep: str, data: tuple[str, str]) -> None:
    """Until the sweep ends. The second one's failures make the device suspect: it is cleared, as an operator would."""
    state = "running"
    while state == "running":
        time.sleep(POLL_S)
        ask("joulebox", "device", "health", "shelf-laptop", "good", *data)
        state = json.loads(ask("joulebox", "sweep", "status", sweep, *data, "--json"))["state"]


def record(folder: Path, source: str) -> Path:
    """Measure both sweeps; returns the folder of the backup."""
    data, state = ("--data", str(folder / "server")), ("--state-dir", str(folder / "agent"))
    with running("joulebox", "serve", "--port", "0", *data):
        url = address(folder / "server")
        code = json.loads(ask("joulebox", "device", "enroll", *data, "--json"))["code"]
        ask("joulebox-agent", "enroll", "--server", url, "--code", code, "--name", "shelf-laptop", *state)
        with running("joulebox-agent", "run", "--source", source, *state):
            for name in ("sweep", "failed"):
                submitted = json.loads(ask("joulebox", "sweep", "submit", str(DATA / f"{name}.toml"), *data, "--json"))
                wait(submitted["id"], data)
        ask("joulebox", "backup", str(folder / "backup"), *data)
    return folder / "backup"


SHOWN = """SELECT result.image_sha256, result.samples_sha256, difference.delta_sha256
    FROM result JOIN job ON job.id = result.job_id LEFT JOIN comparison ON comparison.result_id = result.id
    LEFT JOIN image_difference AS difference ON difference.id = comparison.difference_id
    WHERE job.repeat = 0 AND job.purpose IN ('measure', 'reference')"""


# Where the names of folders and kernels of the recording machine stand; they are nobody's business.
TOLD = (("job", "reason"), ("attempt", "reason"), ("event", "data"), ("device", "health_reason"),
        ("device_capabilities", "document"), ("device_capabilities", "shown"))  # fmt: skip


def pack(backup: Path, target: Path, folder: str) -> None:
    """A backup as one file, without what the dashboard never shows: scenes, and pictures of further repeats.

    folder  the temporary folder of the recording, which is taken out of every sentence
    """
    with closing(sqlite3.connect(backup / "joulebox.db")) as database:
        for table, column in TOLD:
            for word, instead in ((f"{folder}/", ""), (platform.platform(), "Linux")):
                database.execute(f"UPDATE {table} SET {column} = replace({column}, ?, ?)", (word, instead))
        database.commit()
        database.execute("VACUUM")
        shown = {sha256 for found in database.execute(SHOWN) for sha256 in found if sha256}
    with zipfile.ZipFile(target, "w", zipfile.ZIP_LZMA) as packed:
        for path in sorted(backup.rglob("*")):
            if path.is_file() and (path.parent == backup or path.name in shown):
                entry = zipfile.ZipInfo(path.relative_to(backup).as_posix())  # one time for all: 1980
                packed.writestr(entry, path.read_bytes(), zipfile.ZIP_LZMA)


def main() -> None:
    """Measure, pack, tell."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--source", default="replay@0.1", help="energy source of the agent")
    source = parser.parse_args().source
    with tempfile.TemporaryDirectory() as folder:
        backup = record(Path(folder), source)
        pack(backup, DATA / "fleet.zip", folder)
    print(f"{os.path.relpath(DATA / 'fleet.zip')}: {(DATA / 'fleet.zip').stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
