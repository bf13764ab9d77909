"""How much the server bears, in ratio to a bare writer of the same run: `make test-load`.

Fifty simulated agents over loopback lease and deliver for a minute, with and without two new blobs each; a single
writer does the same statements without a server; 1,000 devices and 100,000 results are asked for what the
dashboard shows. Ends with exit code 1 when a goal is missed, and says which.
"""

import argparse
import gc
import json
import os
import signal
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "server")]

from crowd import answers, fill_crowd  # noqa: E402
from joulebox_server.cli.serving import YOUNG_OBJECTS  # noqa: E402
from joulebox_server.schemas.measure import MeasureDocument  # noqa: E402
from joulebox_server.store import Store, leases, results  # noqa: E402
from joulebox_server.store.jobs import LeaseRules  # noqa: E402
from seeded import Device, fill, result_body  # noqa: E402

AGENTS = 50
RULES = LeaseRules(
    slack_s=300, release_pause_s=5, retry_pause_s=5, longest_retry_pause_s=300, max_attempts=3, suspect_after=5
)


@dataclass(frozen=True)
class Loaded:
    """What a minute under load gave."""

    rate: float
    """Lease and result [1/s]."""
    lease_p50_s: float
    lease_p99_s: float
    errors: list[str]
    leased_twice: int
    lost: int
    """Results that were acknowledged and are not in the database."""
    integrity: str
    server_cpu_s: float
    agents_cpu_s: float


@contextmanager
def serving(folder: Path) -> Iterator[tuple[int, int]]:
    """A server process on a free port of loopback: (port, process id)."""
    start = "from joulebox_server.cli import main; main()"
    command = [sys.executable, "-c", start, "serve", "--port", "0", "--data", str(folder), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        told = ""
        while not told.endswith("}\n"):
            line = process.stdout.readline() if process.stdout else ""
            if not line:
                raise RuntimeError(f"the server ended at its start with {process.wait()}")
            told += line
        yield int(json.loads(told)["url"].rpartition(":")[2]), process.pid
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)


def cpu_s(pid: int) -> float:
    """CPU time of a process and its ended children so far; 0 where there is no /proc."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def load(seconds: float, blobs: int, jobs_each: int, folder: Path) -> Loaded:
    """Agents against a server for so many seconds."""
    devices = fill(folder, AGENTS, jobs_each)
    with serving(folder) as (port, pid):
        before_s = cpu_s(pid)
        command = [sys.executable, str(HERE / "simulated_agents.py"), "127.0.0.1", str(port), str(seconds), str(blobs)]
        known = json.dumps([asdict(device) for device in devices])
        path = os.pathsep.join([str(HERE.parent / "server"), os.environ.get("PYTHONPATH", "")])
        agents = subprocess.run(
            command, input=known, capture_output=True, text=True, check=True, env=os.environ | {"PYTHONPATH": path}
        )
        spent_s = cpu_s(pid) - before_s
    ledger = json.loads(agents.stdout)
    return judged(ledger, folder, spent_s)


def judged(ledger: dict[str, Any], folder: Path, spent_s: float) -> Loaded:
    """The ledgers of the agents beside the database of the server that has ended."""
    with sqlite3.connect(folder / "joulebox.db") as db:
        stored = {attempt for (attempt,) in db.execute("SELECT attempt_id FROM result")}
        integrity = db.execute("PRAGMA integrity_check").fetchone()[0]
    waits_s = sorted(ledger["lease_s"])
    return Loaded(
        rate=len(ledger["acknowledged"]) / ledger["time_s"],
        lease_p50_s=statistics.median(waits_s),
        lease_p99_s=waits_s[int(0.99 * len(waits_s))],
        errors=ledger["errors"],
        leased_twice=len(ledger["jobs"]) - len(set(ledger["jobs"])),
        lost=len(set(ledger["acknowledged"]) - stored),
        integrity=integrity,
        server_cpu_s=spent_s,
        agents_cpu_s=ledger["cpu_s"],
    )


def bare_writer(seconds: float, jobs_each: int, folder: Path) -> float:
    """Leases and results [1/s] of one thread that runs the store's statements, a commit for each, and no more.

    Only the two writes are timed, not the making of documents; and as in the server, what is loaded is no work for
    the garbage collector.
    """
    devices = fill(folder, AGENTS, jobs_each)
    store = Store(folder)
    now_us = time.time_ns() // 1000
    done, spent_s = 0, 0.0
    gc.collect()
    gc.freeze()
    gc.set_threshold(YOUNG_OBJECTS)
    while spent_s < seconds:
        device: Device = devices[done % len(devices)]
        began_s = time.perf_counter()
        (lease,) = store.write(leases.lease, device.device_id, "boot-1", {}, 1, RULES, now_us, [])
        leased_s = time.perf_counter()
        document = MeasureDocument.model_validate_json(result_body(lease.model_dump()))
        made_s = time.perf_counter()
        store.write(results.accept, store.blob_dir, lease.attempt_id, device.device_id, document, RULES, now_us)
        spent_s += (leased_s - began_s) + (time.perf_counter() - made_s)
        done += 1
    gc.unfreeze()
    store.close()
    return done / spent_s


def main(arguments: list[str]) -> int:
    """Measure, print, and say what was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--folder", type=Path, help="where the data folders are made; on the disk to be measured")
    parser.add_argument("--devices", type=int, default=1000)
    parser.add_argument("--results", type=int, default=100_000)
    parser.add_argument("--only", choices=("load", "questions"), help="half of it")
    given = parser.parse_args(arguments)
    jobs_each = max(20, round(given.seconds * 12))
    with tempfile.TemporaryDirectory(dir=given.folder) as place:
        folder = Path(place)
        met = True
        if given.only != "questions":
            bare = [bare_writer(given.seconds / 12, jobs_each, folder / "bare-1")]
            plain = load(given.seconds, 0, jobs_each, folder / "plain")
            bare.append(bare_writer(given.seconds / 12, jobs_each, folder / "bare-2"))
            heavy = load(given.seconds / 2, 2, jobs_each, folder / "blobs")
            met = told_load(statistics.fmean(bare), plain, heavy)
        if given.only != "load":
            met = told_questions(crowded(given.devices, given.results, folder / "crowd")) and met
    return 0 if met else 1


def crowded(device_count: int, result_count: int, folder: Path) -> dict[str, float]:
    """Seconds that each question of the dashboard takes with very much stored."""
    _, sweeps = fill_crowd(folder, device_count, result_count)
    with serving(folder) as (port, _):
        return answers(port, sweeps[0], times=9)


def told_load(bare: float, plain: Loaded, heavy: Loaded) -> bool:
    """Print what the agents met; returns whether the goals are."""
    print(f"bare writer, a commit for each statement group   {bare:8.1f} leases with results /s")
    for name, found in (("50 agents", plain), ("50 agents, two blobs of 100 kB each", heavy)):
        cpu = f"CPU: server {found.server_cpu_s:.1f} s, agents {found.agents_cpu_s:.1f} s"
        waits = f"lease p50 {1e3 * found.lease_p50_s:.0f} ms, p99 {1e3 * found.lease_p99_s:.0f} ms"
        print(f"{name:<48} {found.rate:8.1f} /s, {found.rate / bare:.2f} of the bare writer; {waits}; {cpu}")
        print(f"  errors {len(found.errors)}, leased twice {found.leased_twice}, lost {found.lost}, {found.integrity}")
    return goals({
        "250 leases with results a second": plain.rate >= 250,
        "0.8 of a bare writer": plain.rate >= 0.8 * bare,
        "100 a second with two blobs": heavy.rate >= 100,
        "p99 of a lease under 400 ms": plain.lease_p99_s < 0.4,
        "no error": not plain.errors and not heavy.errors,
        "no job leased twice": not plain.leased_twice and not heavy.leased_twice,
        "nothing acknowledged is lost": not plain.lost and not heavy.lost,
        "integrity": plain.integrity == heavy.integrity == "ok",
    })  # fmt: skip


def told_questions(waits_s: dict[str, float]) -> bool:
    """Print how long the dashboard waits; returns whether the goal is met."""
    for question, wait_s in waits_s.items():
        print(f"{question:<48} {1e3 * wait_s:8.1f} ms")
    return goals({"each question of the dashboard under 200 ms": max(waits_s.values()) < 0.2})


def goals(met: dict[str, bool]) -> bool:
    for goal, is_met in met.items():
        print(f"{'met   ' if is_met else 'MISSED'} {goal}")
    return all(met.values())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
