"""`doctor`: the document every recorded machine gets, and what watching adds."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from agent_testing import DATA
from joulebox_agent.doctor import _discharge, filled
from joulebox_agent.sampler import Sample
from joulebox_agent.sources.battery_counter import BatteryCounter
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.reading import Reading
from joulebox_agent.sources.sysfs import Sysfs

EXPECTED = json.loads((DATA / "expected.json").read_text())
Agent = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize("name", EXPECTED)
def test_document_of_every_recorded_machine(agent: Agent, name: str) -> None:
    code, out, _ = agent("doctor", "--json", "--sysfs-root", DATA / name / "sys")
    document = json.loads(out)
    assert code == 0
    watts = EXPECTED[name]["expect_watts"]
    assert document["discharge_w"] == (None if watts is None else pytest.approx(watts, abs=1e-6))
    assert document["reason"]
    gauge = document["sources"][0]
    assert gauge["method"] == "battery_gauge"
    assert gauge["available"] == (watts is not None)
    assert gauge["files"] or not gauge["available"]
    assert document["chosen"] == {"acpi_unknown_rate": "battery_counter"}.get(name, "battery_gauge" if watts else None)
    fields = {"method", "scope", "available", "power_w", "refresh_s", "resolution_j", "files", "reason", "remedy"}
    assert all(fields <= set(source) for source in document["sources"])
    assert len({source["method"] for source in document["sources"]}) == len(document["sources"])
    assert all(source["refresh_s"] is None for source in document["sources"])


def test_conditions_of_a_recorded_laptop(agent: Agent) -> None:
    _, out, _ = agent("doctor", "--json", "--sysfs-root", DATA / "thinkpad_power_now" / "sys")
    conditions = json.loads(out)["conditions"]
    assert conditions["battery_charge_share"] == pytest.approx(40.73 / 47.39)
    assert conditions["battery_health_share"] == pytest.approx(47.39 / 47.52)
    assert conditions["battery_full_j"] == pytest.approx(47.39 * 3600)
    assert conditions["cables_online"] == []


def test_counter_step_is_what_all_its_values_share(agent: Agent) -> None:
    _, out, _ = agent("doctor", "--json", "--sysfs-root", DATA / "thinkpad_power_now" / "sys")
    assert json.loads(out)["sources"][1]["resolution_j"] == pytest.approx(36.0)  # 10 mWh


def test_watching_learns_the_refresh(agent: Agent, tree: Callable[[str], Path]) -> None:
    """No replay file can be given to doctor's list, so a gauge is moved while it is watched."""
    import threading

    root = tree("thinkpad_power_now")
    ended = threading.Event()

    def move() -> None:
        step = 0
        while not ended.wait(0.45):
            step += 1
            (root / "class/power_supply/BAT0/power_now.new").write_text(f"{5_000_000 + 10_000 * step}\n")
            (root / "class/power_supply/BAT0/power_now.new").replace(root / "class/power_supply/BAT0/power_now")

    mover = threading.Thread(target=move)
    mover.start()
    try:
        code, out, _ = agent("doctor", "--json", "--watch", "2.0", "--sysfs-root", root)
    finally:
        ended.set()
        mover.join()
    gauge = json.loads(out)["sources"][0]
    assert code == 0
    assert 0.3 <= gauge["refresh_s"] <= 1.1
    assert gauge["power_w"] == pytest.approx(5.02, abs=0.03)


def test_a_watched_counter_gives_the_rate_the_gauge_does_not() -> None:
    """Two steps of the counter make a rate; one does not."""
    source = BatteryCounter(Sysfs(DATA / "acpi_unknown_rate" / "sys"))
    gauge = BatteryGauge(Sysfs(DATA / "acpi_unknown_rate" / "sys")).report()
    for steps, power_w in ((1, None), (3, pytest.approx(9.0, rel=0.1))):
        samples = [Sample(float(t), Reading(counter_j=36.0 * (t // 4), raw=(t // 4,))) for t in range(4 * steps + 1)]
        discharge_w, reason = _discharge([gauge, filled(source.report(), samples, source)])
        assert discharge_w == power_w
        assert "no power_now" in reason


def test_the_table_says_the_same_in_words(agent: Agent) -> None:
    code, out, _ = agent("doctor", "--sysfs-root", DATA / "chromebook_c300_full_on_ac" / "sys")
    assert code == 0
    assert "Discharge unknown: mains power online (AC)." in out
    assert "no joules" in out


@pytest.mark.parametrize("words", [("--sysfs-root", "/no/such/root"), ("--source", "solar"), ("--watch", "-1")])
def test_wrong_use(agent: Agent, words: tuple[str, ...]) -> None:
    code, out, err = agent("doctor", "--json", *words)
    assert code == 2
    assert out == ""
    assert err.strip()
