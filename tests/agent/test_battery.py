"""The Linux battery: every trap of the recorded trees, and what a careless reader would say instead."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
from agent_testing import DATA, EIO, ENODATA, ENODEV, FaultySysfs, faults_of
from joulebox_agent.conditions import read_conditions
from joulebox_agent.errors import UsageError
from joulebox_agent.sources.battery_counter import BatteryCounter
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.choose import choose, unfit_reason
from joulebox_agent.sources.sysfs import Sysfs

EXPECTED = json.loads((DATA / "expected.json").read_text())
Tree = Callable[[str], Path]
BAT0 = "class/power_supply/BAT0"


@pytest.mark.parametrize("name", EXPECTED)
def test_recorded_tree_gives_the_watts_a_careful_reader_derives(name: str) -> None:
    gauge = BatteryGauge(Sysfs(DATA / name / "sys"))
    report, reading = gauge.report(), gauge.read()
    if EXPECTED[name]["expect_watts"] is None:
        assert report.power_w is None
        assert not report.available
        assert report.reason
        assert report.remedy
        assert reading.power_w is None
        assert reading.problem or reading.refusal
    else:
        assert report.power_w == pytest.approx(EXPECTED[name]["expect_watts"], abs=1e-6)
        assert reading.power_w == pytest.approx(EXPECTED[name]["expect_watts"], abs=1e-6)


def test_unknown_rate_answers_enodev_and_the_counter_takes_over() -> None:
    root = DATA / "acpi_unknown_rate" / "sys"
    sysfs = FaultySysfs(root, faults_of("acpi_unknown_rate"))
    assert "tells no rate" in BatteryGauge(sysfs).report().reason
    assert BatteryCounter(sysfs).report().available
    assert choose("auto", root).source.method == "battery_counter"


@pytest.mark.parametrize("code", [ENODEV, ENODATA])
def test_unknown_power_falls_back_to_current_times_voltage(tree: Tree, code: int) -> None:
    root = tree("dell_current_voltage")
    (root / BAT0 / "power_now").write_text("1\n")
    gauge = BatteryGauge(FaultySysfs(root, {f"{BAT0}/power_now": code}))
    assert gauge.read().power_w == pytest.approx(9.5256, abs=1e-6)


def test_eio_once_is_tried_again_and_twice_voids_the_sample_only(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    once = BatteryGauge(FaultySysfs(root, {f"{BAT0}/power_now": EIO}, times=1)).read()
    assert once.power_w == pytest.approx(5.064)
    assert once.problem is None
    always = BatteryGauge(FaultySysfs(root, {f"{BAT0}/power_now": EIO})).read()
    assert always.power_w is None
    assert "injected" in (always.problem or "")
    assert always.refusal is None


def test_a_file_that_really_answers_eio(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    (root / BAT0 / "power_now").unlink()
    (root / BAT0 / "power_now").symlink_to("/proc/self/mem")
    gauge = BatteryGauge(Sysfs(root))
    assert "power_now" in (gauge.read().problem or "")
    report = gauge.report()
    assert not report.available
    assert "power_now" in report.reason


def test_power_and_current_are_never_added_and_signs_do_not_matter(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    (root / BAT0 / "current_now").write_text("-430979\n")
    (root / BAT0 / "power_now").write_text("-5064000\n")
    assert BatteryGauge(Sysfs(root)).read().power_w == pytest.approx(5.064)


@pytest.mark.parametrize("status", ["Full", "Not charging", "Charging", "Unknown"])
def test_only_a_discharge_is_measured(tree: Tree, status: str) -> None:
    root = tree("thinkpad_power_now")
    (root / BAT0 / "status").write_text(status + "\n")
    assert BatteryGauge(Sysfs(root)).read().refusal
    assert BatteryCounter(Sysfs(root)).read().refusal
    assert unfit_reason("auto", root)
    assert choose("auto", root).source.method == "none"


@pytest.mark.parametrize("cable", ["Mains", "USB", "USB_C", "Wireless"])
def test_a_cable_that_appears_refuses(tree: Tree, cable: str) -> None:
    root = tree("thinkpad_power_now")
    gauge = BatteryGauge(Sysfs(root))
    assert gauge.read().refusal is None
    plug = root / "class/power_supply/plug"
    plug.mkdir()
    (plug / "type").write_text(cable)
    (plug / "online").write_text("1")
    assert gauge.read().refusal == "mains power online (plug)"


def test_a_peripheral_alone_is_no_system_battery(tree: Tree) -> None:
    root = tree("laptop_with_mouse_and_headset")
    for name in ("type", "status", "power_now"):
        (root / BAT0 / name).unlink()
    assert BatteryGauge(Sysfs(root)).report().reason == "no system battery"


def test_the_folder_above_a_sysfs_is_told_from_a_machine_without_a_battery(tree: Tree) -> None:
    above = tree("thinkpad_power_now").parent
    reason = BatteryGauge(Sysfs(above)).report().reason
    assert reason == f"no system battery; {above} has no folder class/, as the root of a sysfs has"


def test_two_gauges_of_one_cell_count_once_whatever_their_type(tree: Tree) -> None:
    root = tree("android_pixel_two_gauges")
    (root / "class/power_supply/bms/type").write_text("Battery\n")
    assert BatteryGauge(Sysfs(root)).read().power_w == pytest.approx(1.6545375, abs=1e-6)


def test_a_zero_rate_while_discharging_is_unknown_not_free(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    (root / BAT0 / "power_now").write_text("0\n")
    reading = BatteryGauge(Sysfs(root)).read()
    assert reading.power_w is None
    assert reading.problem


def test_energy_counter_adds_differences(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    counter = BatteryCounter(Sysfs(root))
    assert counter.read().counter_j == 0.0
    (root / BAT0 / "energy_now").write_text("40710000\n")
    assert counter.read().counter_j == pytest.approx(0.02 * 3600)  # 20 mWh


def test_charge_steps_count_at_the_voltage_they_passed_at(tree: Tree) -> None:
    """571 J: 12.59 mAh at 12.6 V. The difference of charge x voltage under 50 mV of sag says 1,417 J."""
    root = tree("dell_current_voltage")
    counter = BatteryCounter(Sysfs(root))
    assert counter.read().counter_j == 0.0
    (root / BAT0 / "voltage_now").write_text("12550000\n")
    (root / BAT0 / "charge_now").write_text("4710410\n")
    assert counter.read().counter_j == pytest.approx(12.59e-3 * 12.575 * 3600, rel=1e-6)


def test_a_counter_that_rises_starts_another_epoch(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    counter = BatteryCounter(Sysfs(root))
    before = counter.read()
    (root / BAT0 / "energy_now").write_text("40740000\n")
    after = counter.read()
    assert after.epoch == before.epoch + 1
    assert after.counter_j == before.counter_j


def test_a_pack_that_is_pulled_out_starts_another_epoch(tree: Tree) -> None:
    root = tree("thinkpad_dual")
    counter = BatteryCounter(Sysfs(root))
    before = counter.read()
    (root / BAT0 / "energy_now").unlink()
    assert counter.read().epoch == before.epoch + 1


def test_a_battery_waits_for_its_discharge_and_a_desktop_does_not() -> None:
    assert "mains" in (unfit_reason("auto", DATA / "chromebook_c300_full_on_ac" / "sys") or "")
    assert unfit_reason("auto", DATA / "no_battery_pi" / "sys") is None
    assert unfit_reason("battery_gauge", DATA / "no_battery_pi" / "sys") == "no system battery"
    assert unfit_reason("replay", DATA / "chromebook_c300_full_on_ac" / "sys") is None


def test_a_machine_that_is_not_linux_has_nothing_to_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No /sys at all: auto measures time, nothing fails, and of its state psutil tells what it can."""
    missing = tmp_path / "no_sys"
    monkeypatch.setattr("joulebox_agent.sources.sysfs.SYSTEM_ROOT", missing)
    assert choose("auto", missing).source.method == "none"
    assert unfit_reason("auto", missing) is None
    battery = SimpleNamespace(percent=62, power_plugged=True)
    monkeypatch.setattr(psutil, "sensors_battery", lambda: battery, raising=False)
    conditions = read_conditions(missing)
    assert conditions["battery_charge_share"] == 0.62
    assert conditions["mains_online"] is True
    assert not {"governor", "brightness_share", "temperature_c"} & conditions.keys()
    with pytest.raises(UsageError, match="is not a directory"):
        choose("auto", tmp_path / "other")
