"""Stage powers of a sweep whose configurations come as single jobs."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from agent_testing import FAKE_COMMAND
from fake_fleet import TOKEN, FakeFleet
from joulebox_agent.estimates.windows import StageTotals, Window
from joulebox_agent.fleet.daemon import Daemon
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.options import RunOptions
from joulebox_agent.fleet.server import Server
from joulebox_agent.fleet.state import StateDir
from joulebox_agent.fleet.stopping import Stop
from joulebox_agent.loop import Build, ReadyEvent
from joulebox_agent.measuring.ledger import MOST_WINDOWS, StageLedger
from joulebox_agent.measuring.progress import Lines
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.reading import Reading
from joulebox_agent.sources.sysfs import Sysfs

POWERS_W = {"direct": 24.0, "indirect": 14.0}
READY = ReadyEvent(event="ready", protocol=1, scene="cornell", scene_sha256="a" * 64, settings={},
                   build=Build(name="r", version="1"))  # fmt: skip


def job(root: Path, number: int, direct_share: float, windows: int = 5) -> Recording:
    """Windows of a minute in which one stage takes this share of the time; a gauge of 2 s and 1 % noise."""
    source, rng = BatteryGauge(Sysfs(root)), np.random.default_rng(number)
    power_w = direct_share * POWERS_W["direct"] + (1 - direct_share) * POWERS_W["indirect"]
    start_s = 1000.0 * number
    record = Recording(source, source.report(), start_s, ready=READY, before={"governor": "powersave"})
    shown_w = power_w * (1 + 0.01 * rng.standard_normal(30 * windows + 1))
    polls = range(120 * windows + 1)
    record.samples = [
        Sample(start_s + poll / 2, Reading(power_w=float(shown_w[poll // 4]), raw=(poll // 4,))) for poll in polls
    ]
    for k in range(windows):
        at_s = start_s + 60.0 * k
        stages = {"direct": StageTotals(60 * direct_share), "indirect": StageTotals(60 * (1 - direct_share))}
        record.windows.append(Window(at_s, at_s + 60.0, images=20, stages=stages))
    return record


def test_powers_are_known_from_the_third_job_on(tree: Callable[[str], Path]) -> None:
    """Fifteen windows of 30 updates at 1 %: 0.2 % a window, and shares of 0.2 to 0.8 tell the powers to 0.5 %."""
    root, ledger = tree("thinkpad_power_now"), StageLedger()
    jobs = [job(root, number, share) for number, share in enumerate([0.2, 0.5, 0.8])]
    for record in jobs[:2]:
        ledger.add(record)
        powers, reason = ledger.powers(record)
        assert powers is None
        assert "need 12 metered windows" in (reason or "")
    ledger.add(jobs[2])
    powers, reason = ledger.powers(jobs[2])
    assert powers is not None, reason
    assert powers.window_count == 15
    assert {name: watts.value for name, watts in powers.powers_w.items()} == pytest.approx(POWERS_W, rel=0.02)


def test_another_scene_renderer_or_state_is_another_sweep(tree: Callable[[str], Path]) -> None:
    root, ledger = tree("thinkpad_power_now"), StageLedger()
    for number, share in enumerate([0.2, 0.5, 0.8]):
        ledger.add(job(root, number, share))
    known = job(root, 3, 0.4)
    assert ledger.powers(known)[0] is not None
    for change in (
        {"ready": READY.model_copy(update={"scene_sha256": "b" * 64})},
        {"ready": READY.model_copy(update={"build": Build(name="r", version="2")})},
        {"before": {"governor": "performance"}},
        {"ready": None},
    ):
        assert ledger.powers(replace(known, **change))[0] is None
    ledger.add(replace(job(root, 4, 0.9), void="the cable was plugged in"))
    found = ledger.powers(known)[0]
    assert found is not None
    assert found.window_count == 15
    for number in range(5, 25):
        ledger.add(job(root, number, 0.1 + 0.04 * number % 0.8))
    found = ledger.powers(known)[0]
    assert found is not None
    assert found.window_count == MOST_WINDOWS


def test_the_daemon_s_documents_have_regressed_joules_once_its_jobs_can_tell_them(tmp_path: Path) -> None:
    """Two windows a job: the sixth has the twelve that the fit needs."""
    fleet, state = FakeFleet(), StateDir.at(tmp_path / "state")
    digest = fleet.add_scene()
    for number in range(1, 7):
        fleet.add_job(number, digest, direct=0.15 * number)
    options = RunOptions(source="replay@0.05", wait_s=0.0, pause_s=0.01, longest_pause_s=0.05, max_jobs=6)
    server = Server("http://fleet", TOKEN, transport=fleet.transport, quick_wait_s=0.001)
    said: list[dict[str, object]] = []
    Daemon(state, "device-1", server, FAKE_COMMAND, options, Stop(), Journal(said.append, state.doing), Lines).run()
    regressed = {
        attempt: [stage["energy_j"]["regressed"] for stage in json.loads(document)["stages"].values()]
        for attempt, document in fleet.results.items()
    }
    assert [regressed[f"attempt-{number}"] for number in range(1, 6)] == [[None, None]] * 5
    assert all(joules > 0 for joules in regressed["attempt-6"])
