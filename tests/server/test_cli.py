"""The command: it does what it says against a real server, and every fault is one sentence."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx2
import pytest
from fake_device import FakeDevice
from joulebox_server.cli.sweep_file import pack_scene
from server_testing import Run, Server, failed

SWEEP = """
name = "from-file"
scenes = ["scene-folder", {path = "scene-folder", defines = {size = "small"}}]
settings = {width = 32, height = 32}
axes = {global_photons = [10000, 50000]}
repeats = 1
measure = {window_s = 1, min_windows = 2, max_windows = 2, max_seconds = 10}
"""


@pytest.fixture
def sweep_file(tmp_path: Path) -> Path:
    scene = tmp_path / "scene-folder"
    (scene / "meshes").mkdir(parents=True)
    (scene / "scene.xml").write_text('<scene version="3.0.0"/>')
    (scene / "meshes" / "box.ply").write_text("ply")
    (scene / ".hidden").write_text("no")
    path = tmp_path / "sweep.toml"
    path.write_text(SWEEP)
    return path


def test_from_file_to_recommendation(run: Run, live: Server, there: list[str], sweep_file: Path) -> None:
    code, out, _ = run("device", "enroll", *there, "--json")
    enrolment = json.loads(out)
    assert enrolment["command"] == f"joulebox-agent enroll --server {there[1]} --code {enrolment['code']}"
    answer = live.client.post("/v1/devices", json={"code": enrolment["code"], "name": "lab", "boot_id": "1"}).json()
    device = FakeDevice(live.client, answer["token"], answer["device_id"])
    device.tell_capabilities()
    assert "lab" in run("device", "list", *there)[1]

    code, out, _ = run("sweep", "preview", str(sweep_file), *there)
    assert (code, "2 configurations, 8 jobs on 1 device(s)" in out) == (0, True)
    code, out, _ = run("sweep", "submit", str(sweep_file), *there, "--json")
    sweep = json.loads(out)
    assert sweep["scenes"] == ["scene-folder", "scene-folder size=small"]
    assert json.loads(run("sweep", "list", *there, "--json")[1])["items"][0]["id"] == sweep["id"]
    assert "0 of 8 jobs done (8 queued)" in run("sweep", "status", sweep["id"], *there)[1]

    failed(run("sweep", "watch", sweep["id"], "--timeout", "0.1", "--json", *there), 1, "still running", "goes on")
    worker = threading.Thread(target=device.work)
    worker.start()
    code, out, _ = run("sweep", "watch", "from-file", *there, "--timeout", "30")
    worker.join()
    assert code == 0
    assert "sweep from-file is done: 8 of 8 jobs done" in out

    assert "global_photons=50000" in run("tradeoff", sweep["id"], *there)[1]
    code, out, _ = run("recommend", sweep["id"], "--budget-j", "7", "--difference-limit", "1000", *there, "--json")
    assert json.loads(out)["settings"]["global_photons"] == 50_000
    code, out, _ = run("recommend", sweep["id"], "--budget-j", "0.01", *there)
    assert (code, "no setting meets this" in out) == (0, True)
    assert len(run("export", "--sweep", sweep["id"], *there)[1].splitlines()) == 9
    assert len(json.loads(run("export", *there, "--json")[1])) == 8
    assert run("sweep", "delete", sweep["id"], *there)[0] == 0


def test_a_name_is_taken_whole(run: Run, live: Server, there: list[str], tmp_path: Path) -> None:
    """`a?b`, `a#b` and `a%62` are other sweeps than `a`, and `a/jobs` is none."""
    kept = live.add_sweep(name="a")["id"]
    for name in ("a?b", "a#b", "a%62", "K\u00fcche \u2615"):
        live.add_sweep(name=name)
        assert json.loads(run("sweep", "status", name, *there, "--json")[1])["name"] == name
        assert run("sweep", "delete", name, *there)[0] == 0
    failed(run("sweep", "delete", "a?b", *there), 1, "no sweep has the id or name 'a?b'")
    failed(run("report", "a?b", "-o", str(tmp_path / "out"), *there), 1, "no sweep has the id or name 'a?b'")
    for name in ("", ".", "..", "a/jobs"):
        failed(run("sweep", "status", name, *there), 2, f"{name!r} is neither a name nor an id")
        failed(run("device", "revoke", name, *there), 2, f"{name!r} is neither a name nor an id")
    assert live.get(f"/sweeps/{kept}")["name"] == "a"


def test_state_changes(run: Run, live: Server, there: list[str]) -> None:
    sweep = live.add_sweep()
    for action, state in (("pause", "paused"), ("resume", "running"), ("cancel", "cancelled")):
        code, out, _ = run("sweep", action, "small", *there, "--json")
        assert (code, json.loads(out)["state"]) == (0, state)
    assert run("sweep", "watch", sweep["id"], *there)[0] == 1
    failed(run("sweep", "retry", sweep["id"], *there), 1, "cancelled")
    live.device()
    assert "maintenance" in run("device", "health", "laptop", "maintenance", *there)[1]
    failed(run("device", "health", "laptop", "ill", *there), 2, "'ill'")
    assert run("device", "revoke", "laptop", *there)[0] == 0


def test_what_goes_wrong_with_the_server(run: Run, live: Server, there: list[str]) -> None:
    failed(run("sweep", "list", "--server", "http://127.0.0.1:9"), 1, "no server answers", "joulebox serve")
    failed(run("sweep", "list", "--server", "nonsense"), 2, "is not an address")
    failed(run("sweep", "list", *there[:2], "--token", "jb_wrong"), 1, "token is not known")
    failed(run("device", "enroll", *there[:2]), 1, "needs a token")
    failed(run("sweep", "status", "nope", *there), 1, "no sweep has the id or name 'nope'")
    failed(run("recommend", "nope", *there), 1, "no sweep")
    live.add_sweep()
    failed(run("recommend", "small", "--budget-wh", "1", *there), 2, "belong together")


def test_what_goes_wrong_with_the_file(run: Run, live: Server, there: list[str], sweep_file: Path) -> None:
    live.device()

    def submit(text: str, suffix: str = ".toml") -> tuple[int, str, str]:
        path = sweep_file.with_suffix(suffix)
        path.write_text(text)
        return run("sweep", "submit", str(path), *there)

    failed(run("sweep", "submit", "missing.toml", *there), 2, "missing.toml cannot be read")
    failed(submit("name = \nx = 1"), 2, "is not valid TOML", "line 1")
    failed(submit("{", ".json"), 2, "is not valid JSON")
    failed(submit("[]", ".json"), 2, "must hold an object")
    failed(submit(SWEEP.replace("global_photons", "global_photns")), 2, "axes.global_photns[0]", "did you mean")
    failed(submit(SWEEP.replace('"scene-folder",', '"../nowhere",')), 2, "nowhere does not exist")
    unknown = re.sub("scenes = .*", 'scenes = ["unknown"]', SWEEP)
    failed(submit(unknown), 2, "no scene is named 'unknown'")
    assert live.get("/sweeps")["items"] == []


def test_wrong_use(run: Run) -> None:
    for arguments in (("sweep", "submit"), ("nonsense",), ("sweep", "watch", "x", "--timeout", "soon")):
        assert run(*arguments)[0] == 2
    assert run("--version")[0] == 0


def test_a_scene_folder_always_makes_the_same_zip(sweep_file: Path) -> None:
    scene = sweep_file.parent / "scene-folder"
    first = pack_scene(scene)
    os.utime(scene / "scene.xml", (0, 0))
    assert pack_scene(scene) == first
    assert b".hidden" not in first


def test_tokens_and_upkeep_need_no_server(run: Run, tmp_path: Path) -> None:
    data = ("--data", str(tmp_path / "data"))
    failed(run("token", "list", *data), 1, "holds no server's data")
    failed(run("token", "create", "--role", "king", *data), 2, "'king'")
    code, token, _ = run("token", "create", "--role", "viewer", "--name", "wall", *data)
    assert (code, bool(re.fullmatch(r"jb_\S{43}\n", token))) == (0, True)
    listed = run("token", "list", *data)[1]
    assert "wall" in listed
    assert token.strip() not in listed
    assert run("token", "revoke", "wall", *data)[0] == 0
    failed(run("token", "revoke", "wall", *data), 1, "no valid token")
    assert json.loads(run("gc", *data, "--json")[1]) == {"blobs_removed": 0}
    assert run("backup", str(tmp_path / "copy"), *data)[0] == 0
    assert (tmp_path / "copy" / "joulebox.db").is_file()
    (tmp_path / "data" / "joulebox.db").write_bytes(b"no database" * 100)
    failed(run("gc", *data), 1, "cannot be used")


def test_serve_refusals(run: Run, live: Server, tmp_path: Path) -> None:
    data = ("--data", str(tmp_path / "fresh"))
    taken = str(live.client.base_url.port)
    failed(run("serve", "--port", taken, *data), 1, f"port {taken} at 127.0.0.1 is taken")
    failed(run("serve", "--port", "0", "--host", "0.0.0.0", *data), 1, "no token protects this server")
    failed(run("serve", "--port", "0", "--host", "203.0.113.1", *data), 1, "cannot listen at 203.0.113.1")
    failed(run("serve", "--enrollment-secret-file", str(tmp_path / "none"), *data), 2, "cannot be read")
    (tmp_path / "short").write_text("short\n")
    failed(run("serve", "--enrollment-secret-file", str(tmp_path / "short"), *data), 2, "at least 16 characters")
    (tmp_path / "file").write_text("")
    failed(run("serve", "--port", "0", "--data", str(tmp_path / "file")), 1, "cannot be used")
    assert run("serve", "--port", "99999")[0] == 2


class Served:
    """`joulebox serve` as a process of its own."""

    def __init__(self, *options: str) -> None:
        command = [sys.executable, "-c", "from joulebox_server.cli import main; main()"]
        self.process = subprocess.Popen(
            [*command, "serve", "--port", "0", "--json", *options], stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        text = ""
        while not text.endswith("}\n"):
            line = self.process.stdout.readline()
            assert line, "the server ended"
            text += line
        self.told = json.loads(text)

    def stop(self, how: signal.Signals) -> int:
        self.process.send_signal(how)
        try:
            return self.process.wait(10)
        finally:
            self.process.kill()
            self.process.wait()
            assert self.process.stdout is not None
            self.process.stdout.close()


@pytest.fixture
def secret_file(tmp_path: Path) -> Path:
    path = tmp_path / "secret"
    path.write_text("a shared secret of some length\n")
    return path


@pytest.mark.skipif(sys.platform == "win32", reason="signals and file modes are POSIX")
def test_serve_as_a_process(run: Run, tmp_path: Path, secret_file: Path) -> None:
    """First start: a token once, private files; Ctrl-C ends it with a watcher connected; data outlives it."""
    data = tmp_path / "data"
    served = Served("--data", str(data), "--enrollment-secret-file", str(secret_file))
    try:
        url, token = served.told["url"], served.told["operator_token"]
        assert token.startswith("jb_")
        assert (data / "operator.token").stat().st_mode & 0o777 == 0o600
        assert "joulebox" not in run("sweep", "list", "--data", str(data))[2]  # address and token are found
        assert run("device", "enroll", "--data", str(data))[0] == 0
        body = {"code": "a shared secret of some length", "name": "one", "boot_id": "1"}
        assert httpx2.post(f"{url}/v1/devices", json=body).status_code == 201
        assert httpx2.post(f"{url}/v1/devices", json=body | {"name": "two"}).status_code == 201
        with httpx2.stream("GET", f"{url}/v1/events") as events:
            assert events.status_code == 200
            started_s = time.monotonic()
            assert served.stop(signal.SIGINT) == 0
            assert time.monotonic() - started_s < 6
    finally:
        served.process.kill()
    assert not (data / "server.json").exists()
    again = Served("--data", str(data))
    assert again.told["operator_token"] is None
    found = httpx2.get(f"{again.told['url']}/v1/devices").json()["items"]
    assert {device["name"] for device in found} == {"one", "two"}
    again.stop(signal.SIGTERM)


def test_confirming_and_recomputing(run: Run, live: Server, there: list[str]) -> None:
    """Thirteen of fifteen combinations measured: what promises more is queued, measured, and then known."""
    axes = [(p, c) for p in (10_000, 30_000, 60_000, 80_000, 100_000) for c in (50, 100, 200)]
    listed = [{"global_photons": p, "gather_count": c} for p, c in axes if (p, c) not in ((60_000, 50), (100_000, 200))]
    sweep = live.add_sweep(rule="list", axes={}, configurations=listed)
    device = live.device()
    device.work()
    live.wait(sweep["id"], "done")
    points = json.loads(run("tradeoff", sweep["id"], *there, "--json")[1])["points"]
    limit = 1.02 * max(p["difference"]["value"] for p in points if p["settings"]["global_photons"] == 100_000)
    asked = ["recommend", sweep["id"], "--budget-j", "13", "--difference-limit", str(limit), *there]
    code, out, _ = run(*asked)
    assert (code, "promises more, never measured: gather_count=200, global_photons=100000" in out) == (0, True), out
    code, out, _ = run(*asked, "--predict", "--confirm", "3", "--json")
    assert (code, json.loads(out)["queued_jobs"]) == (0, 6)  # the new one twice, two others with two more seeds
    assert device.work() == 6
    live.wait(sweep["id"], "done")
    assert "never measured" not in run(*asked)[1]
    failed(run("recommend", sweep["id"], "--battery-percent", "5", *there), 2, "capacity of this device's battery")
    failed(run("recommend", sweep["id"], "--images", "5", *there), 2, "images goes with budget_wh or battery_percent")
    code, out, _ = run("recompute", sweep["id"], *there)
    assert (code, "0 difference(s) are computed anew by ltdiff-style 1; 33 are of it already" in out) == (0, True), out
    failed(run("recompute", "no-such", *there), 1, "no sweep")
