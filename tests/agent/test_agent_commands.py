"""enroll, run and status as commands: tokens, wrong use, signals."""

import contextlib
import http.server
import json
import os
import shlex
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx2
import joulebox_agent.cli.fleet as commands
import pytest
from agent_testing import RENDERER, build_tree
from fake_fleet import TOKEN, FakeFleet
from joulebox_agent.errors import AgentError
from joulebox_agent.fleet.server import Server
from joulebox_agent.fleet.state import Enrolment, StateDir, machine_lock

Agent = Callable[..., tuple[int, str, str]]


@pytest.fixture
def fleet() -> FakeFleet:
    return FakeFleet()


@pytest.fixture
def state(tmp_path: Path) -> StateDir:
    return StateDir.at(tmp_path / "state")


def test_enrolling_keeps_the_token_to_this_user(
    agent: Agent, tmp_path: Path, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commands, "Server", lambda url: Server(url, transport=fleet.transport, quick_wait_s=0.001))
    secret = tmp_path / "secret"
    secret.write_text("the-code\n")
    words = ("enroll", "--server", "http://fleet/", "--code-file", secret, "--name", "shelf-3")
    code, out, _ = agent(*words, "--state-dir", tmp_path / "s", "--json")
    assert code == 0
    assert json.loads(out) == {"server": "http://fleet", "device_id": "device-1", "name": "shelf-3",
                               "state_dir": str(tmp_path / "s")}  # fmt: skip
    file = tmp_path / "s" / "device.json"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert TOKEN in file.read_text()
    assert TOKEN not in out
    assert agent(*words, "--state-dir", tmp_path / "s")[0] == 0  # a restart of a container enrols again
    assert fleet.calls == ["POST /devices"]
    code, _, err = agent("enroll", "--server", "http://other", "--code", "x", "--state-dir", tmp_path / "s")
    assert code == 2
    assert "belongs to http://fleet" in err
    code, out, _ = agent("status", "--state-dir", tmp_path / "s", "--json", "--source", "none")
    assert code == 0
    assert json.loads(out)["name"] == "shelf-3"
    assert TOKEN not in out


@pytest.mark.parametrize("status", [401, 403, 410])
def test_a_wrong_code_is_one_sentence(
    agent: Agent, tmp_path: Path, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch, status: int
) -> None:
    monkeypatch.setattr(commands, "Server", lambda url: Server(url, transport=fleet.transport, quick_wait_s=0.001))
    fleet.answers["POST /devices"] = (status, {"detail": "this code is unknown or was used"})
    code, _, err = agent("enroll", "--server", "http://fleet", "--code", "x", "--state-dir", tmp_path)
    assert code == 1
    assert "this code is unknown or was used" in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "device.json").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("enroll", "--server", "fleet:8080", "--code", "x"),
        ("enroll", "--server", "http://fleet"),
        ("enroll", "--server", "http://fleet", "--code", "x", "--code-file", "/dev/null"),
        ("enroll", "--server", "http://fleet", "--code-file", "/no/such/file"),
        ("enroll", "--server", "http://fleet", "--code-file", "/dev/null"),
        ("run",),
        ("run", "--max-jobs", "0"),
        ("measure", "scenes/cornell-boxes", "--source", "none", "--renderer", "'unbalanced"),
        ("measure", "scenes/cornell-boxes", "--source", "none", "--cool-to", "nan"),
        ("measure", "scenes/cornell-boxes", "--source", "none", "-o", "/"),
        ("measure", "scenes/cornell-boxes", "--source", "none", "--configurations", "/dev/zero"),
        ("measure", "scenes/cornell-boxes", "--source", "none", "--resume", "/dev/zero"),
    ],
)
def test_wrong_use(agent: Agent, tmp_path: Path, words: tuple[str, ...]) -> None:
    code, out, err = agent(*words, "--state-dir", tmp_path)
    assert code == 2
    assert out == ""
    assert err.strip()


def test_a_file_of_configurations_that_nests_without_end(agent: Agent, tmp_path: Path) -> None:
    (tmp_path / "deep.json").write_text("[" * 100_000)
    code, _, err = agent("measure", "scene", "--source", "none", "--configurations", tmp_path / "deep.json")
    assert code == 2
    assert "is not JSON" in err


def test_an_unreachable_server_is_one_sentence(agent: Agent, tmp_path: Path) -> None:
    code, _, err = agent("enroll", "--server", "http://127.0.0.1:9", "--code", "x", "--state-dir", tmp_path)
    assert code == 1
    assert err.startswith("joulebox-agent: The server at http://127.0.0.1:9 cannot be reached")
    assert len(err.splitlines()) == 1


def test_a_damaged_state_is_one_sentence(agent: Agent, tmp_path: Path) -> None:
    (tmp_path / "device.json").write_text('{"server": "http://x"}')
    code, _, err = agent("run", "--state-dir", tmp_path)
    assert code == 1
    assert "is damaged; enrol again with --again" in err


@contextlib.contextmanager
def on_a_socket(fleet: FakeFleet) -> Iterator[str]:
    """The fake fleet behind a real socket; its URL."""

    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def answer(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            request = httpx2.Request(self.command, f"http://fleet{self.path}", headers=dict(self.headers), content=body)
            response = fleet.handle(request)
            self.send_response(response.status_code)
            self.send_header("Content-Type", response.headers.get("Content-Type", "application/octet-stream"))
            if response.status_code != 204:
                self.send_header("Content-Length", str(len(response.content)))
            self.end_headers()
            self.wfile.write(response.content if self.command != "HEAD" else b"")

        do_GET = do_HEAD = do_POST = do_PUT = answer  # noqa: N815

        def log_message(self, *words: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as listening:
        thread = threading.Thread(target=listening.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.server_address[1]}"
        finally:
            listening.shutdown()
            thread.join()


def program(lock: Path, *words: str) -> list[str]:
    """The command as a process, its lock of the machine in a place of its own: tests run beside each other."""
    start = f"import joulebox_agent.cli.fleet as f, pathlib; f.machine_lock_file = lambda: pathlib.Path({str(lock)!r})"
    return [sys.executable, "-c", f"{start}; from joulebox_agent.cli import main; main()", *words]


def test_a_signal_stops_the_real_command_and_its_renderer(agent: Agent, tmp_path: Path) -> None:
    """The installed command against a real socket: one lease, SIGTERM while it renders, the lease comes back."""
    fleet = FakeFleet()
    fleet.add_job(1, fleet.add_scene(), image_s=0.1)
    fleet.jobs[0]["measure"] |= {"window_s": 60}
    state, other = StateDir.at(tmp_path / "state"), StateDir.at(tmp_path / "other")
    with on_a_socket(fleet) as url:
        for place in (state, other):
            place.save(Enrolment(server=url, device_id="device-1", token=TOKEN, name="me"))
        words = ["run", "--renderer", RENDERER, "--wait-s", "0"]
        command = program(tmp_path / "lock", *words, "--source", "none", "--state-dir", str(state.root))
        meter = "exec:" + shlex.join([sys.executable, "-S", "-E", "-c", "print('{\"power_w\": 5}')"])
        metering = program(tmp_path / "lock", *words, "--source", meter, "--state-dir", str(other.root))
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        lines = []
        try:
            for line in process.stderr:
                lines.append(line)
                if "rendering cornell" in line:
                    break
            assert state.locked()
            with machine_lock(tmp_path / "lock"):  # free until here: the first one reads no energy
                second, third = (
                    subprocess.run(run, capture_output=True, text=True, timeout=30, check=False)
                    for run in (command, metering)
                )
            told = json.loads(agent("status", "--state-dir", state.root, "--source", "none", "--json")[1])
            process.send_signal(signal.SIGTERM)
            rest = process.stderr.read()
            code = process.wait(15)
        finally:
            process.kill()
            process.wait()
            process.stderr.close()
    assert code == 0, "".join(lines) + rest
    assert fleet.releases == [("attempt-1", "the agent was stopped", False)]
    assert second.returncode == 1
    assert "Another joulebox-agent runs on" in second.stderr
    assert third.returncode == 1
    assert "Another joulebox-agent measures this machine" in third.stderr
    assert "Traceback" not in rest + second.stderr + third.stderr
    assert (told["running"], told["leased"], told["spooled"]) == (True, 1, 0)
    assert told["doing"].startswith("Job job-1: measure of cornell")
    after = json.loads(agent("status", "--state-dir", state.root, "--source", "none", "--json")[1])
    assert (after["running"], after["leased"], after["doing"]) == (False, 0, None)


def test_the_machine_s_lock_ends_with_its_holder(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    with machine_lock(lock), pytest.raises(AgentError, match="measures this machine"), machine_lock(lock):
        pytest.fail("two agents measure this machine")
    with machine_lock(lock):
        pass
    lock.chmod(0o444)  # another user's
    with machine_lock(lock):
        pass
    lock.unlink()
    lock.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(AgentError, match="cannot be opened"), machine_lock(lock):
        pass


def test_a_log_of_json_lines(tmp_path: Path) -> None:
    fleet = FakeFleet()
    fleet.add_job(1, fleet.add_scene())
    state = StateDir.at(tmp_path / "state")
    with on_a_socket(fleet) as url:
        state.save(Enrolment(server=url, device_id="device-1", token=TOKEN, name="me"))
        words = ("run", "--once", "--json", "--renderer", RENDERER, "--source", "replay@0.05", "--wait-s", "0")
        done = subprocess.run(program(tmp_path / "lock", *words, "--state-dir", str(state.root)),
                              capture_output=True, text=True, timeout=60, check=False)  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    records = [json.loads(line) for line in done.stdout.splitlines()]
    assert {"ready", "job", "measuring", "delivered"} <= {record["event"] for record in records}
    assert all({"time", "level", "event", "message"} <= record.keys() for record in records)
    assert not (tmp_path / "lock").exists()  # a replay measures nothing, so others may run beside it


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a program without a signal")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_measurement_that_is_told_to_end_leaves_nothing_behind(tmp_path: Path, number: signal.Signals) -> None:
    """Its battery, which drains on the cable so as to be measured, is charged again; its pictures' folder is gone."""
    tree = build_tree(tmp_path / "sys", {
        "AC": {"type": "Mains", "online": 1},
        "BAT0": {"type": "Battery", "present": 1, "status": "Discharging", "power_now": 9_000_000,
                 "energy_now": 10_000_000, "energy_full": 50_000_000, "charge_behaviour": "[auto] force-discharge"},
    })  # fmt: skip
    online, pack = tree / "class/power_supply/AC/online", tree / "class/power_supply/BAT0"
    online.write_text("0\n")
    words = ["measure", "scene", "--renderer", RENDERER, "--sysfs-root", str(tree), "--charge-band", "90-30"]
    scratch = tmp_path / "tmp"
    scratch.mkdir()
    # Signals that these tests were started without, as by nohup, would be ignored by the agent, too.
    usual = "default_int_handler" if number == signal.SIGINT else "SIG_DFL"
    start = f"import signal; signal.signal({int(number)}, signal.{usual}); "
    start += "import joulebox_agent.measuring.charging as c; c.LOOK_EVERY_S = 0.1"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{start}; from joulebox_agent.cli import main; main()", *words],
        stderr=subprocess.PIPE, text=True, env=os.environ | {"TMPDIR": str(scratch)},
    )  # fmt: skip
    assert process.stderr is not None
    try:
        for line in process.stderr:
            if "charging to 90%" in line:  # full at once, and the cable stays
                online.write_text("1\n")
                (pack / "energy_now").write_text("49000000\n")
            if "waiting for a discharge" in line:
                break
        assert (pack / "charge_behaviour").read_text() == "force-discharge"
        (pack / "charge_behaviour").write_text("auto [force-discharge]\n")  # as the kernel shows what it was told
        process.send_signal(number)
        _, rest = process.communicate(timeout=30)
        code = process.returncode
    finally:
        process.kill()
        process.wait()
        process.stderr.close()
    assert code == 128 + number
    assert "Traceback" not in rest
    assert (pack / "charge_behaviour").read_text() == "auto"
    assert list(scratch.iterdir()) == []
