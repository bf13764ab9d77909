"""`doctor`: the document every recorded machine gets, and what watching adds."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_testing import DATA
from joulebox_agent.doctor import _discharge, filled
from joulebox_agent.estimates.resolution import window_s_for_share
from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sources.battery_counter import BatteryCounter
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.reading import Reading
from joulebox_agent.sources.sysfs import Sysfs
from scipy.stats import t as student

EXPECTED = json.loads((DATA / "expected.json").read_text())
Agent = Callable[..., tuple[int, str, str]]


def row(document: dict[str, Any], method: str) -> dict[str, Any]:
    return next(dict(source) for source in document["sources"] if source["method"] == method)


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
    assert conditions["mains_online"] is False
    assert conditions["battery_status"] == ["Discharging"]


def test_conditions_of_a_machine_in_full(agent: Agent, tree: Callable[[str], Path]) -> None:
    root = tree("thinkpad_power_now")
    files = {
        "class/backlight/intel_backlight/brightness": "300",
        "class/backlight/intel_backlight/max_brightness": "1200",
        "firmware/acpi/platform_profile": "balanced",
        "devices/system/cpu/cpu0/cpufreq/scaling_governor": "powersave",
        "devices/system/cpu/cpu0/cpufreq/energy_performance_preference": "balance_power",
        "devices/system/cpu/cpu0/thermal_throttle/core_throttle_count": "3",
        "class/thermal/thermal_zone0/temp": "48000",
        "class/thermal/thermal_zone1/temp": "61500",
        "class/net/wlan0/operstate": "up",
        "class/net/wlan0/device/vendor": "0x8086",
        "class/net/wlan0/statistics/rx_bytes": "123456",
        "class/net/wlan0/statistics/tx_bytes": "1000",
        "class/net/enp0s31f6/operstate": "down",
        "class/net/enp0s31f6/device/vendor": "0x8086",
        "class/net/br0/operstate": "up",
        "class/net/br0/statistics/rx_bytes": "123456",
    }
    for name, value in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(value + "\n")
    conditions = json.loads(agent("doctor", "--json", "--sysfs-root", root)[1])["conditions"]
    assert conditions["brightness_share"] == 0.25
    assert conditions["power_profile"] == "balanced"
    assert (conditions["governor"], conditions["energy_preference"]) == ("powersave", "balance_power")
    assert (conditions["temperature_c"], conditions["throttle_count"]) == (61.5, 3)
    assert (conditions["network_up"], conditions["network_bytes"]) == (["wlan0"], 124_456)
    words = agent("doctor", "--sysfs-root", root)[1]
    for line in (
        "network: wlan0",
        "mains: unplugged",
        "charge: 86%",
        "hottest (C): 61.5",
        "governor: powersave",
        "brightness: 25%",
    ):
        assert line in words


def test_conditions_that_nobody_tells_are_null(agent: Agent) -> None:
    document = json.loads(agent("doctor", "--json", "--sysfs-root", DATA / "no_battery_pi" / "sys")[1])
    conditions = document["conditions"]
    for name in ("mains_online", "battery_charge_share", "temperature_c", "governor", "brightness_share", "network_up"):
        assert conditions[name] is None
    assert conditions["cpu_busy_s"] > 0
    assert document["other_cpu_share"] >= 0


def test_reading_costs_next_to_nothing_and_doctor_says_how_much(agent: Agent) -> None:
    """A battery's dozen small files at two looks a second cost under 0.1 % of a core; fifty times that fails."""
    document = json.loads(agent("doctor", "--json", "--sysfs-root", DATA / "thinkpad_dual" / "sys")[1])
    assert 0 < row(document, "battery_gauge")["cpu_share"] < 0.05
    assert row(document, "rapl")["cpu_share"] is None


def test_the_window_that_five_percent_needs(agent: Agent) -> None:
    """Steps of 72 J at 6.81 W. The mean of five differences of two uniform errors has the standard error
    72 J sqrt(2/12) / sqrt(5); times Student's t of 2.776 it has to be 5 % of 6.81 W x window: 107.2 s."""
    document = json.loads(agent("doctor", "--json", "--sysfs-root", DATA / "thinkpad_dual" / "sys")[1])
    counter = row(document, "battery_counter")
    assert counter["resolution_j"] == pytest.approx(72.0)
    expected_s = float(student.ppf(0.975, 4)) * 72.0 * (2 / 12) ** 0.5 / 5**0.5 / (0.05 * 6.81)
    assert counter["window_s_for_5_percent"] == pytest.approx(expected_s)
    assert row(document, "battery_gauge")["window_s_for_5_percent"] is None  # its refresh is not known yet
    assert window_s_for_share(0.05, 6.81, 30.0, 72.0) == 450.0
    assert window_s_for_share(0.05, 6.81, 4.0, None) == 60.0
    assert window_s_for_share(0.05, None, 4.0, 72.0) is None


def test_a_window_of_that_length_is_enough() -> None:
    """The joules of five windows read off a counter's steps are within 5 % in 95 of 100 measurements.

    At least: Student's t is made for a spread that is not known, and this one is. 20,000 measurements give the
    share a standard deviation of 0.15 %; a window of half the length would reach 83 %.
    """
    random = np.random.default_rng(20261122)
    step_j, power_w = 36.0, 17.0
    window_s = window_s_for_share(0.05, power_w, None, step_j) or 0.0
    starts_j = random.uniform(0, step_j, (20_000, 5))
    counted_j = np.floor((starts_j + power_w * window_s) / step_j) * step_j
    means_j = counted_j.mean(axis=1)
    assert np.mean(np.abs(means_j / (power_w * window_s) - 1) <= 0.05) >= 0.945


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
    document = json.loads(out)
    gauge = document["sources"][0]
    assert code == 0
    assert 0 < document["sampler_cpu_share"] < 0.05  # ten times what is allowed, on whatever runs the tests
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
