"""The daemon: leases to results, and everything that can stand in between."""

import errno
import json
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest
from agent_testing import DATA, FAKE_COMMAND
from fake_fleet import TOKEN, FakeFleet, scene_zip
from joulebox_agent.errors import AgentError, ServerUnreachableError, TokenRejectedError
from joulebox_agent.fleet.daemon import Daemon
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.options import RunOptions
from joulebox_agent.fleet.server import Server
from joulebox_agent.fleet.state import StateDir
from joulebox_agent.fleet.stopping import Stop
from joulebox_agent.measuring.progress import Lines

FAST: dict[str, Any] = {"source": "replay@0.05", "wait_s": 0.0, "pause_s": 0.01, "longest_pause_s": 0.05}


@pytest.fixture
def fleet() -> FakeFleet:
    return FakeFleet()


@pytest.fixture
def state(tmp_path: Path) -> StateDir:
    return StateDir.at(tmp_path / "state")


class Bench:
    """A daemon on the fake fleet, with its log."""

    def __init__(self, state: StateDir, fleet: FakeFleet, token: str = TOKEN, **options: Any) -> None:
        self.records: list[dict[str, Any]] = []
        self.stop = Stop()
        server = Server("http://fleet", token, transport=fleet.transport, quick_wait_s=0.001)
        self.daemon = Daemon(state, "device-1", server, FAKE_COMMAND, RunOptions(**(FAST | options)), self.stop,
                             Journal(self.records.append, state.doing), Lines)  # fmt: skip

    @property
    def said(self) -> list[str]:
        return [record["message"] for record in self.records]


def test_jobs_are_measured_and_delivered(state: StateDir, fleet: FakeFleet) -> None:
    digest = fleet.add_scene()
    for number in (1, 2):
        fleet.add_job(number, digest, seed=number)
    bench = Bench(state, fleet, max_jobs=2)
    bench.daemon.run()
    assert fleet.results.keys() == {"attempt-1", "attempt-2"}
    document = json.loads(fleet.results["attempt-2"])
    assert document["settings"]["seed"] == 2
    assert document["quality"] == "replayed"
    assert document["scene"] == "cornell"
    assert fleet.blobs[document["image_blob"]] == b"v/1\x01 picture of seed 2"
    assert fleet.blobs[document["power_samples"]].startswith(b'{"time_s"')
    assert fleet.releases == []
    assert fleet.calls.count(f"GET /blobs/{digest}") == 1
    told = fleet.capabilities
    assert told is not None
    assert told["renderer"]["name"] == "fake-render"
    assert told["renderer"]["settings_schema"]["additionalProperties"] is False
    assert {"method", "available", "scope", "reason"} == set(told["energy_methods"][0])
    assert list(state.scratch.iterdir()) == []


def test_nothing_is_said_to_the_server_inside_a_measurement(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene(), seed=1)
    Bench(state, fleet, once=True).daemon.run()
    fetched = next(i for i, call in enumerate(fleet.calls) if call.startswith("GET /blobs"))
    assert fleet.calls[fetched + 1].startswith("HEAD /blobs")  # the next word is the upload


def test_an_unmetered_job_sends_a_picture(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene(), meter=False, seed=5, image_s=0.3)
    Bench(state, fleet, once=True).daemon.run()
    document = json.loads(fleet.results["attempt-1"])
    assert document["quality"] == "none"
    assert document["images"] == 1
    assert fleet.blobs[document["image_blob"]].endswith(b"seed 5")


def test_refused_settings_spend_the_attempt_with_the_renderers_sentence(state: StateDir, fleet: FakeFleet) -> None:
    digest = fleet.add_scene()
    fleet.add_job(1, digest, image_ss=3)
    fleet.add_job(2, digest, seed=1)
    Bench(state, fleet, max_jobs=2).daemon.run()
    attempt, reason, failed = fleet.releases[0]
    assert (attempt, failed) == ("attempt-1", True)
    assert "There is no setting 'image_ss'" in reason
    assert fleet.results.keys() == {"attempt-2"}


@pytest.mark.parametrize(
    ("how", "words"), [("die", "Segmentation fault"), ("flicker", "picture changed"), ("garbage", "not JSON")]
)
def test_a_bad_renderer_spends_the_attempt(state: StateDir, fleet: FakeFleet, how: str, words: str) -> None:
    fleet.add_job(1, fleet.add_scene(), misbehave=how)
    Bench(state, fleet, once=True).daemon.run()
    assert len(fleet.releases) == 1
    assert words in fleet.releases[0][1]
    assert fleet.releases[0][2] is True
    assert fleet.results == {}


def test_a_bad_bundle_spends_the_attempt(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene(scene_zip({"../scene.xml": b""})))
    Bench(state, fleet, once=True).daemon.run()
    assert "outside" in fleet.releases[0][1]
    assert fleet.releases[0][2] is True


def test_a_machine_on_mains_takes_no_job(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene())
    root = DATA / "chromebook_c300_full_on_ac" / "sys"
    bench = Bench(state, fleet, source="auto", sysfs_root=root, idle_exit_s=0.3)
    bench.daemon.run()
    assert "POST /leases" not in fleet.calls
    assert bench.said.count("Not fit to measure now: mains power online (AC).") == 1


def test_a_cable_that_appears_gives_the_job_back(
    state: StateDir, fleet: FakeFleet, tree: Callable[[str], Path]
) -> None:
    root = tree("thinkpad_power_now")
    fleet.add_job(1, fleet.add_scene(), image_s=0.2)
    fleet.jobs[0]["measure"] |= {"window_s": 60}
    bench = Bench(state, fleet, source="auto", sysfs_root=root, once=True)
    threading.Timer(1.0, (root / "class/power_supply/AC/online").write_text, ("1",)).start()
    bench.daemon.run()
    _, reason, failed = fleet.releases[0]
    assert "mains power online (AC)" in reason
    assert failed is False  # not fit to measure now spends no retry
    assert fleet.results == {}


def test_an_unreachable_server_is_said_once_and_outlived(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene())
    fleet.down = 20
    bench = Bench(state, fleet, max_jobs=1)
    bench.daemon.run()
    assert "attempt-1" in fleet.results
    assert sum("cannot be reached" in line for line in bench.said) == 1


def test_results_outlive_a_server_that_goes_away(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene())
    fleet.answers["HEAD /blobs"] = (503, {"title": "down for repair"})
    with pytest.raises(ServerUnreachableError, match="1 finished result is kept in the spool"):
        Bench(state, fleet, once=True).daemon.run()
    assert len(list(state.spool.glob("*.json"))) == 1
    fleet.answers.clear()
    Bench(state, fleet, once=True).daemon.run()  # the next run of the agent
    assert "attempt-1" in fleet.results
    assert list(state.spool.glob("*.json")) == []


def test_a_revoked_token_ends_the_agent(state: StateDir, fleet: FakeFleet) -> None:
    with pytest.raises(TokenRejectedError, match="rejects this device's credentials"):
        Bench(state, fleet, token="revoked").daemon.run()


def test_a_full_disk_holds_new_jobs_and_loses_nothing(
    state: StateDir, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = fleet.add_scene()
    for number in (1, 2):
        fleet.add_job(number, digest)
    fleet.answers["HEAD /blobs"] = (503, {"title": "down"})
    bench = Bench(state, fleet, max_jobs=2)
    real, broken = os.fsync, True

    def fsync(descriptor: int) -> None:
        if broken:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    runner = threading.Thread(target=bench.daemon.run)
    runner.start()
    deadline = time.monotonic() + 10
    while not bench.daemon.delivery.in_memory and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.3)
    assert len(bench.daemon.delivery.in_memory) == 1
    assert len(fleet.jobs) == 1  # the second job was not taken
    broken = False
    fleet.answers.clear()
    runner.join(15)
    assert fleet.results.keys() == {"attempt-1", "attempt-2"}
    assert sum("is full" in line for line in bench.said) >= 1


def test_a_refused_result_that_cannot_be_set_aside_holds_new_jobs(
    state: StateDir, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full and the server wants another result: it stays in memory, and nothing new is started."""

    def fsync(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    digest = fleet.add_scene()
    for number in (1, 2):
        fleet.add_job(number, digest)
    fleet.results["attempt-1"] = b"{}"
    bench = Bench(state, fleet, idle_exit_s=0.6)
    with pytest.raises(AgentError, match="1 results in memory"):
        bench.daemon.run()
    assert len(fleet.jobs) == 1
    assert any("waits in memory" in line for line in bench.said)


def test_little_room_holds_new_jobs(state: StateDir, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("joulebox_agent.fleet.spool.ROOM_WANTED_BYTES", 2**60)
    fleet.add_job(1, fleet.add_scene())
    bench = Bench(state, fleet, idle_exit_s=0.2)
    bench.daemon.run()
    assert len(fleet.jobs) == 1
    assert any("64 MiB" in line for line in bench.said)


def test_memory_that_cannot_be_saved_is_said(
    state: StateDir, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fsync(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    fleet.add_job(1, fleet.add_scene())
    fleet.answers["HEAD /blobs"] = (503, {"title": "down"})
    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(AgentError, match="1 results in memory are lost"):
        Bench(state, fleet, once=True).daemon.run()


def test_a_stop_gives_the_job_back(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene(), image_s=0.2)
    fleet.jobs[0]["measure"] |= {"window_s": 60}
    bench = Bench(state, fleet)
    threading.Timer(0.8, bench.stop.ask).start()
    bench.daemon.run()
    assert fleet.releases == [("attempt-1", "the agent was stopped", False)]
    assert fleet.results == {}


def long_job(fleet: FakeFleet, window_s: float, min_windows: int = 2) -> None:
    """A job of very many windows, the renderer's images 20 ms long."""
    fleet.add_job(1, fleet.add_scene(), image_s=0.02)
    fleet.jobs[0]["measure"] |= {
        "window_s": window_s, "min_windows": min_windows, "max_windows": 500, "half_width": 1e-6, "max_seconds": 300,
    }  # fmt: skip


def stop_when(bench: Bench, ready: Callable[[], bool], times: int = 1) -> threading.Thread:
    """Asks the agent to end as soon as `ready()`, so many times in a row."""

    def wait_and_ask() -> None:
        deadline = time.monotonic() + 30
        while not ready() and time.monotonic() < deadline:
            time.sleep(0.005)
        for _ in range(times):
            bench.stop.ask()

    thread = threading.Thread(target=wait_and_ask)
    thread.start()
    return thread


def windows_told(capfd: pytest.CaptureFixture[str], seen: list[str]) -> int:
    seen.append(capfd.readouterr().err)
    return "".join(seen).count("window ")


def test_a_stop_keeps_the_windows_that_make_a_result(
    state: StateDir, fleet: FakeFleet, capfd: pytest.CaptureFixture[str]
) -> None:
    long_job(fleet, window_s=0.1)
    bench, seen = Bench(state, fleet), list[str]()
    asking = stop_when(bench, lambda: windows_told(capfd, seen) >= 3)
    bench.daemon.run()
    asking.join()
    document = json.loads(fleet.results["attempt-1"])
    assert 3 <= document["windows"] < 500
    assert any("a stop of the agent ended it after" in line for line in bench.said)
    assert fleet.releases == []


def test_a_stop_waits_for_the_one_window_that_is_missing(
    state: StateDir, fleet: FakeFleet, capfd: pytest.CaptureFixture[str]
) -> None:
    long_job(fleet, window_s=1.0)
    bench, seen = Bench(state, fleet), list[str]()
    asking = stop_when(bench, lambda: windows_told(capfd, seen) >= 1)
    bench.daemon.run()
    asking.join()
    assert json.loads(fleet.results["attempt-1"])["windows"] == 2
    assert fleet.releases == []


@pytest.mark.parametrize("impatience", ["asked twice", "no grace", "several are missing"])
def test_a_stop_that_cannot_wait_gives_the_job_back(
    state: StateDir, fleet: FakeFleet, capfd: pytest.CaptureFixture[str], impatience: str
) -> None:
    """The next window would take minutes."""
    long_job(fleet, window_s=0.1, min_windows=2)
    if impatience == "several are missing":
        fleet.jobs[0]["measure"] |= {"window_s": 250, "min_windows": 3}
    else:
        fleet.jobs[0]["measure"] |= {"window_s": 250, "min_windows": 1}
    bench = Bench(state, fleet)
    if impatience == "no grace":
        bench.stop = bench.daemon._stop = bench.daemon.worker._stop = Stop(grace_s=0.1)
    asking = stop_when(bench, lambda: "rendering" in capfd.readouterr().err, 2 if impatience == "asked twice" else 1)
    began_s = time.monotonic()
    bench.daemon.run()
    asking.join()
    assert time.monotonic() - began_s < 60
    assert fleet.releases == [("attempt-1", "the agent was stopped", False)]
    assert fleet.results == {}


PORTAL = {
    "a page": httpx2.Response(200, html="<html>Welcome to the hotel</html>"),
    "a redirect": httpx2.Response(302, headers={"Location": "http://hotel.example/"}),
    "a refusal": httpx2.Response(403, html="<html>Please sign in</html>"),
    "not known": httpx2.Response(404, text="Not Found"),
    "asks for a name": httpx2.Response(401, headers={"WWW-Authenticate": "Basic"}),
    "sign in first": httpx2.Response(511, html="<html>Please sign in</html>"),
    "other JSON": httpx2.Response(200, json={"status": "captive"}),
}


@pytest.mark.parametrize("answer", PORTAL)
def test_the_sign_in_page_of_a_network_takes_no_result(state: StateDir, fleet: FakeFleet, answer: str) -> None:
    """A laptop away from home: whatever answers every address there, the results wait until it is back."""
    fleet.add_job(1, fleet.add_scene())
    fleet.answers["HEAD /blobs"] = (503, {"title": "down"})
    with pytest.raises(ServerUnreachableError):
        Bench(state, fleet, once=True).daemon.run()
    fleet.answers.clear()
    bench = Bench(state, fleet, idle_exit_s=0.3)
    portal = httpx2.MockTransport(lambda request: httpx2.Response(
        PORTAL[answer].status_code, headers=PORTAL[answer].headers, content=PORTAL[answer].content
    ))  # fmt: skip
    away = Server("http://fleet", TOKEN, transport=portal, quick_wait_s=0.001)
    bench.daemon._server = bench.daemon.delivery.server = away
    bench.daemon.run()
    assert len(list(state.spool.glob("*.json"))) == 1
    assert list((state.spool / "bad").iterdir()) == []
    Bench(state, fleet, once=True).daemon.run()
    assert fleet.results.keys() == {"attempt-1"}


def test_days_without_a_server(state: StateDir, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three days, the wall clock stepping by days meanwhile: seldom asked, said once, delivered exactly once."""
    digest = fleet.add_scene()
    for number in (1, 2, 3):
        fleet.add_job(number, digest, meter=False)
    fleet.answers["HEAD /blobs"] = (503, {"title": "away"})
    away = Bench(state, fleet, max_jobs=3, longest_pause_s=60.0, pause_s=1.0)
    away.daemon._server._quick_wait_s = 0.0
    waited_s: list[float] = []
    three_days_s = 3 * 86_400

    def wait(timeout_s: float | None = None) -> bool:
        waited_s.append(timeout_s or 0.0)
        if sum(waited_s[-1000:]) and sum(waited_s) > three_days_s:
            away.stop.asked.set()
        return away.stop.asked.is_set()

    monkeypatch.setattr(away.stop.asked, "wait", wait)
    monkeypatch.setattr(time, "time", lambda: 1.9e9 + 86_400.0 * (len(waited_s) % 5 - 2))
    spool = away.daemon.delivery.spool
    away.daemon.run()  # the first job is measured; its result cannot be delivered, and no other is taken
    assert len(spool.waiting()) == 1
    rounds = len(waited_s)
    assert three_days_s / 60 <= rounds <= three_days_s / 30 + 10
    assert all(30 <= pause_s <= 60 for pause_s in waited_s[8:])
    assert waited_s[0] <= 1 and waited_s[3] <= 8
    assert sum("asks to wait" in line for line in away.said) == 1
    fleet.answers.clear()
    Bench(state, fleet, max_jobs=2).daemon.run()
    assert fleet.results.keys() == {"attempt-1", "attempt-2", "attempt-3"}
    assert [call for call in fleet.calls if call.endswith("/result")] == [
        f"PUT /attempts/attempt-{number}/result" for number in (1, 2, 3)
    ]


def test_what_is_logged_is_structured_and_tells_the_job(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene())
    bench = Bench(state, fleet, once=True)
    bench.daemon.run()
    for record in bench.records:
        assert {"time", "level", "event", "message"} <= record.keys()
        assert record["level"] in ("info", "warning")
        assert TOKEN not in json.dumps(record)
    events = [record["event"] for record in bench.records if record["event"] != "note"]
    assert events == ["ready", "job", "delivered"]
    job = next(record for record in bench.records if record["event"] == "job")
    assert (job["job_id"], job["attempt_id"], job["sweep_id"]) == ("job-1", "attempt-1", "sweep")


def test_no_job_and_idle_end_quietly(state: StateDir, fleet: FakeFleet) -> None:
    bench = Bench(state, fleet, once=True)
    bench.daemon.run()
    assert "The server has no job for this device." in bench.said
    bench = Bench(state, fleet, idle_exit_s=0.1)
    bench.daemon.run()


def test_an_answer_that_is_not_understood_is_refused_in_words() -> None:
    transport = httpx2.MockTransport(lambda request: httpx2.Response(200, json={"leases": [{"attempt_id": "../x"}]}))
    server = Server("http://fleet", TOKEN, transport=transport)
    with pytest.raises(AgentError, match=r"is not understood: leases\.0\.attempt_id"):
        server.lease("boot", {}, 0)


def test_a_killed_agent_gives_its_job_back_when_it_starts_again(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene(), image_s=0.2)
    fleet.jobs[0]["measure"] |= {"window_s": 60}
    killed = Bench(state, fleet)
    killed.daemon.worker.do = lambda lease: bool(killed.stop.ask())  # type: ignore[method-assign]  # as if it ended here
    killed.daemon.run()
    assert fleet.releases == []
    assert state.leased() == ["attempt-1"]
    Bench(state, fleet, once=True).daemon.run()
    assert fleet.releases == [("attempt-1", "the agent was killed while it had this job", False)]
    assert state.leased() == []


def test_a_killed_agent_that_had_its_result_safe_delivers_it_and_gives_nothing_back(
    state: StateDir, fleet: FakeFleet
) -> None:
    """Killed between the spool and the note that the attempt is done: the result is what the server wants."""
    fleet.add_job(1, fleet.add_scene())
    fleet.answers["HEAD /blobs"] = (503, {"title": "down"})
    with pytest.raises(ServerUnreachableError):
        Bench(state, fleet, once=True).daemon.run()
    state.leases.write_text('["attempt-1"]')
    fleet.answers.clear()
    Bench(state, fleet, once=True).daemon.run()
    assert fleet.results.keys() == {"attempt-1"}
    assert fleet.releases == []


def test_a_delivered_job_is_not_given_back(state: StateDir, fleet: FakeFleet) -> None:
    fleet.add_job(1, fleet.add_scene())
    Bench(state, fleet, once=True).daemon.run()
    assert state.leased() == []
    state.leases.write_text("not JSON")
    assert state.leased() == []


def test_a_low_battery_takes_no_job_until_it_was_charged(
    state: StateDir, fleet: FakeFleet, tree: Callable[[str], Path]
) -> None:
    root = tree("thinkpad_power_now")
    battery = root / "class/power_supply/BAT0"
    full = int((battery / "energy_full").read_text())
    (battery / "energy_now").write_text(str(full // 5))
    fleet.add_job(1, fleet.add_scene())
    bench = Bench(state, fleet, source="auto", sysfs_root=root, idle_exit_s=0.3)
    bench.daemon.run()
    assert "POST /leases" not in fleet.calls
    assert "the charge is 20%: charging to 90%" in bench.said
    assert "Not fit to measure now: the charge is 20% and goes up to 90%." in bench.said
    (battery / "energy_now").write_text(str(full))  # charged, and off the cable again
    Bench(state, fleet, source="auto", sysfs_root=root, once=True).daemon.run()
    assert "POST /leases" in fleet.calls


def test_a_job_that_reaches_the_band_s_end_is_given_back(
    state: StateDir, fleet: FakeFleet, tree: Callable[[str], Path]
) -> None:
    root = tree("thinkpad_power_now")
    battery = root / "class/power_supply/BAT0"
    full = int((battery / "energy_full").read_text())
    (battery / "energy_now").write_text(str(full * 7 // 10))
    fleet.add_job(1, fleet.add_scene(), image_s=0.05)
    fleet.jobs[0]["measure"] |= {"window_s": 0.2, "min_windows": 100, "max_windows": 100}
    bench = Bench(state, fleet, source="auto", sysfs_root=root, once=True)
    threading.Timer(1.0, (battery / "energy_now").write_text, (str(full // 4),)).start()
    bench.daemon.run()
    _, reason, failed = fleet.releases[0]
    assert "the charge is 25%, the lower end of its band 90-30 %" in reason
    assert failed is False
    assert fleet.results == {}
