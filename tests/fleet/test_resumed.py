"""The installed agent against a real server: killed at awkward moments, started again, nothing lost or waited out."""

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from fake_device import scene_zip
from joulebox_agent.fleet.server import Server as Client
from joulebox_agent.fleet.state import Enrolment, StateDir
from server_testing import Server, listening

FAKE_RENDERER = Path(__file__).parents[1] / "agent" / "fake_renderer.py"
RENDERER = f"{sys.executable} -S -E {FAKE_RENDERER}"
START = "from joulebox_agent.cli import main; main()"
KILL = "os.kill(os.getpid(), 9)"
# Where a kill comes, as a change to the agent before it starts.
MOMENTS = {
    "before it wrote down what it leased": (
        f"import os, joulebox_agent.fleet.attempts as m; m.Attempts.take = lambda self, leases: {KILL}"
    ),
    "before the result is in the spool": (
        f"import os, joulebox_agent.fleet.delivery as m; m.Delivery.keep = lambda self, entry, blobs: {KILL}"
    ),
    "before it wrote down that the result is safe": (
        f"import os, joulebox_agent.fleet.attempts as m; m.Attempts.finish = lambda self, lease: {KILL}"
    ),
    "before the result is delivered": (
        f"import os, joulebox_agent.fleet.server as m; m.Server.put_result = lambda self, *a: {KILL}"
    ),
    "before the spool forgets what was delivered": (
        f"import os, joulebox_agent.fleet.spool as m; m.Spool.done = lambda self, path: {KILL}"
    ),
}

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX")


class Shelf:
    """A server with a sweep for one device, and that device's agent as a process."""

    def __init__(self, server: Server, folder: Path) -> None:
        self.server, self.state, self.boot = server, StateDir.at(folder / "state"), folder / "boot_id"
        url = str(server.client.base_url).rstrip("/")
        code = server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["code"]
        self.boot.write_text("first")
        client = Client(url)
        device_id, token = client.enroll(code, "shelf", "first")
        client.close()
        self.state.save(Enrolment(server=url, device_id=device_id, token=token, name="shelf"))

    def agent(self, change: str = "pass", *options: str) -> subprocess.Popen[str]:
        boot = f"import pathlib, joulebox_agent.fleet.state as s; s.BOOT_ID = pathlib.Path({str(self.boot)!r})"
        words = ["run", "--renderer", RENDERER, "--source", "replay@0.05", "--wait-s", "1", "--state-dir"]
        command = [sys.executable, "-c", f"{boot}\n{change}\n{START}", *words, str(self.state.root), *options]
        return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)

    def sweep(self) -> str:
        known = {"settings": {"image_s": 0.02}, "axes": {"gap_s": [0.0, 0.001, 0.002, 0.003]}, "repeats": 1}
        measure = {"window_s": 0.2, "min_windows": 2, "max_windows": 2, "max_seconds": 600, "half_width": 0.5}
        return str(self.server.add_sweep(**known, measure=measure)["id"])


def finish(process: subprocess.Popen[str]) -> str:
    try:
        return process.communicate(timeout=120)[1]
    finally:
        process.kill()


def test_an_agent_killed_at_every_moment(tmp_path: Path, executor: Any) -> None:
    """Once at each, once by a signal in a window, once with a reboot after it; then it finishes everything.

    Leases last more than ten minutes here: had one to be waited out, the sweep would not end.
    """
    with listening(tmp_path / "data", executor, max_attempts=5) as server:
        server.add_scene("box", scene_zip())
        shelf = Shelf(server, tmp_path)
        sweep = shelf.sweep()
        for change in MOMENTS.values():
            process = shelf.agent(change)
            finish(process)
            assert process.returncode == -signal.SIGKILL
        for _ in ("the same boot", "another boot"):
            process = shelf.agent()
            assert process.stderr is not None
            for line in process.stderr:
                if line.startswith("window 1"):
                    break
            process.kill()
            process.communicate()
            shelf.boot.write_text("second")
        began_s = time.monotonic()
        said = finish(shelf.agent("pass", "--idle-exit-s", "3"))
        assert time.monotonic() - began_s < 300
        assert "Traceback" not in said
        found = server.get(f"/sweeps/{sweep}")
        assert (found["state"], found["jobs"]["failed"]) == ("done", 0), said
        results = server.get("/results", limit=200)["items"]
        jobs = server.get(f"/sweeps/{sweep}/jobs", limit=200)["items"]
        assert sorted(result["job_id"] for result in results) == sorted(job["id"] for job in jobs)
        assert shelf.state.leased() == []
        assert server.get("/devices/shelf")["health"] == "good"
