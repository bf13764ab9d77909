"""Layouts of class/power_supply as they are found in the world, and the watts a careful reader derives from each.

Node names, types and sets of files follow the kernel's drivers named beside them; the numbers are constructed, and
the expected watts are worked out here from them, by hand.
"""

from pathlib import Path
from typing import Any

import pytest
from agent_testing import Nodes, build_tree
from joulebox_agent.sources.battery_counter import BatteryCounter
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.choose import choose
from joulebox_agent.sources.sysfs import Sysfs

UNPLUGGED = {"type": "Mains", "online": 0}
BATTERY = {"type": "Battery", "present": 1, "status": "Discharging"}


def battery(**files: Any) -> dict[str, object]:
    return BATTERY | files


# name: (nodes, watts)
LAYOUTS: dict[str, tuple[Nodes, float]] = {
    "Chromebook (sbs-battery, cros-usbpd)": (
        {
            "sbs-0-000b": battery(
                scope="System", current_now=-1_310_000, current_avg=-1_295_000, voltage_now=7_612_000,
                charge_now=4_100_000, charge_full=6_100_000, capacity=67, energy_now=0, technology="Li-ion",
            ),
            "CROS_USBPD_CHARGER0": {"type": "USB", "usb_type": "[C] PD PD_PPS", "online": 0, "current_max": 0},
            "CROS_USBPD_CHARGER1": {"type": "USB", "online": 0},
        },
        1.31 * 7.612,
    ),
    "Apple silicon (macsmc-battery)": (
        {
            "macsmc-ac": UNPLUGGED,
            "macsmc-battery": battery(
                power_now=-6_350_000, current_now=-527_000, voltage_now=12_049_000, charge_now=5_000_000,
                charge_counter=5_000_000, charge_behaviour="[auto] inhibit-charge",
            ),
        },
        6.35,
    ),
    "Surface (surface_battery)": (
        {"ADP1": UNPLUGGED, "BAT1": battery(power_now=8_123_000, energy_now=30_000_000, voltage_now=7_700_000)},
        8.123,
    ),
    "ThinkPad, second pack works": (
        {
            "AC": UNPLUGGED,
            "BAT0": battery(status="Unknown", power_now=0, energy_now=5_000_000, voltage_now=11_800_000),
            "BAT1": battery(power_now=9_876_000, energy_now=40_000_000, voltage_now=11_900_000),
        },
        9.876,
    ),
    "ThinkPad, idle pack calls itself not charging": (
        {
            "AC": UNPLUGGED,
            "BAT0": battery(power_now=9_876_000, energy_now=40_000_000, voltage_now=11_900_000),
            "BAT1": battery(status="Not charging", power_now=0, energy_now=5_000_000, voltage_now=11_800_000),
        },
        9.876,
    ),
    "two packs at once, watts (Surface Book)": (
        {
            "BAT1": battery(power_now=6_000_000, current_now=779_000, voltage_now=7_700_000, capacity=80),
            "BAT2": battery(power_now=6_000_000, current_now=779_000, voltage_now=7_700_000, capacity=80),
        },
        12.0,
    ),
    "two packs at once, amperes, told apart by their charge": (
        {
            "BAT0": battery(current_now=700_000, voltage_now=12_000_000, capacity=80, charge_now=3_000_000),
            "BAT1": battery(current_now=700_000, voltage_now=12_000_000, capacity=60, charge_now=2_000_000),
        },
        2 * 0.7 * 12.0,
    ),
    "two packs at once, amperes, told apart by serial number": (
        {
            "BAT0": battery(current_now=700_000, voltage_now=12_000_000, capacity=80, serial_number="0041"),
            "BAT1": battery(current_now=690_000, voltage_now=12_000_000, capacity=80, serial_number="0042"),
        },
        0.7 * 12 + 0.69 * 12,
    ),
    "two packs in turn, amperes, alike in everything but the current": (
        {
            "BAT0": battery(current_now=0, voltage_now=12_000_000, capacity=80, charge_full=4_000_000),
            "BAT1": battery(current_now=700_000, voltage_now=11_950_000, capacity=80, charge_full=4_000_000),
        },
        0.7 * 11.95,
    ),
    "Steam Deck": (
        {"ACAD": UNPLUGGED, "BAT1": battery(current_now=1_450_000, voltage_now=7_900_000, charge_now=4_000_000)},
        1.45 * 7.9,
    ),
    "PinePhone (axp20x)": (
        {
            "axp20x-battery": battery(
                current_now=512_000, voltage_now=3_812_000, capacity=55, health="Good", voltage_ocv=3_900_000
            ),
            "axp20x-usb": {"type": "USB", "online": 0, "present": 1, "voltage_now": 0},
        },
        0.512 * 3.812,
    ),
    "PinePhone with the keyboard's battery": (
        {
            "axp20x-battery": battery(current_now=512_000, voltage_now=3_812_000, capacity=55),
            "ip5xxx-battery": battery(current_now=-250_000, voltage_now=4_010_000),
        },
        0.512 * 3.812 + 0.25 * 4.01,
    ),
    "Pixel (google_battery, maxfg, two wireless nodes)": (
        {
            "battery": battery(current_now=-412_500, voltage_now=4_011_000, capacity=62, charge_counter=2_480_000),
            "maxfg": battery(current_now=-409_800, voltage_now=4_009_000, capacity=62, charge_counter=2_470_000),
            "usb": {"type": "USB", "online": 0},
            "wireless": {"type": "Wireless", "online": 0},
            "dc": {"type": "Mains", "online": 0},
            "main-charger": {"type": "Unknown", "current_now": 400_000, "voltage_now": 4_011_000},
        },
        0.4125 * 4.011,
    ),
    "Qualcomm phone (battery, bms, parallel charger)": (
        {
            "battery": battery(current_now=380_500, voltage_now=3_955_000, capacity=48, charge_counter=1_800_000),
            "bms": {"type": "BMS", "current_now": -380_500, "voltage_now": 3_955_000, "capacity": 48},
            "main": {"type": "Main", "voltage_max": 4_400_000, "online": 1},
            "parallel": {"type": "Parallel", "online": 1},
            "usb": {"type": "Unknown", "online": 0},
            "pc_port": {"type": "USB", "online": 0},
        },
        0.3805 * 3.955,
    ),
    "phone with a fuel gauge that tells no current": (
        {
            "battery": battery(current_now=-412_500, voltage_now=4_011_000, capacity=62),
            "max170xx_battery": battery(voltage_now=4_013_000, capacity=61, charge_now=2_000_000),
        },
        0.4125 * 4.011,
    ),
    "laptop with a mouse and a headset that have no scope": (
        {
            "BAT0": battery(power_now=10_000_000, energy_now=30_000_000, voltage_now=11_900_000),
            "hidpp_battery_0": battery(voltage_now=4_013_000, capacity=61, model_name="MX Master"),
            "headset": battery(status="Unknown", capacity=80),
        },
        10.0,
    ),
    "board with cw2015": (
        {
            "cw2015-battery": battery(
                current_now=910_000, voltage_now=3_700_000, capacity=71, charge_full_design=9_800_000,
                time_to_empty_now=600,
            ),
            "dc-charger": {"type": "Mains", "online": 0},
        },
        0.91 * 3.7,
    ),
    "UPS HAT (max17040 and gpio-charger), current by its own": (
        {
            "max17040": battery(voltage_now=3_950_000, capacity=90, current_now=650_000),
            "gpio-charger": {"type": "Mains", "online": 0},
        },
        0.65 * 3.95,
    ),
    "gauge that tells an average only": (
        {"BAT0": battery(power_avg=7_250_000, energy_now=30_000_000, voltage_now=7_700_000)},
        7.25,
    ),
    "gauge that tells an average current only": (
        {"battery": battery(current_avg=-333_000, voltage_now=3_800_000)},
        0.333 * 3.8,
    ),
    "old ACPI: rate unknown, in milliwatts of 32 bits": (
        {"BAT0": battery(power_now=4_294_967_295_000, current_now=800_000, voltage_now=12_000_000)},
        9.6,
    ),
    "old ACPI: rate unknown, in milliwatts of 16 bits": (
        {"BAT0": battery(power_now=65_535_000, current_now=800_000, voltage_now=12_000_000)},
        9.6,
    ),
    "ACPI: power_now 0, current tells": (
        {"BAT0": battery(power_now=0, current_now=800_000, voltage_now=12_000_000)},
        9.6,
    ),
    "power_now in milliwatts, current right": (
        {"BAT0": battery(power_now=9_600, current_now=800_000, voltage_now=12_000_000)},
        9.6,
    ),
    "without present, scope and technology": (
        {"BATC": {"type": "Battery", "status": "Discharging", "power_now": 11_000_000}},
        11.0,
    ),
    "words in other letters": (
        {"BAT0": battery(type="battery", power_now=9_000_000), "pen": battery(scope="device", power_now=4_000_000)},
        9.0,
    ),
    "types of a phone in other letters": (
        {
            "battery": battery(current_now=380_500, voltage_now=3_955_000),
            "bms": {"type": "bms", "current_now": -380_500, "voltage_now": 3_955_000, "online": 1},
            "main": {"type": "MAIN", "online": 1},
            "ups": {"type": "Ups", "online": 1},
        },
        0.3805 * 3.955,
    ),
    "status in other letters": (
        {"battery": {"type": "Battery", "status": "DISCHARGING", "current_now": 500_000, "voltage_now": 3_900_000}},
        1.95,
    ),
    "desktop board with a UPS on USB (HID, scope Device) and a laptop's pack": (
        {
            "BAT0": battery(power_now=10_000_000),
            "hid-0764:0501-battery".replace(":", "_"): battery(scope="Device", power_now=99_000_000, capacity=100),
            "wacom_battery_0": battery(scope="Device", capacity=50),
        },
        10.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LAYOUTS)
def test_layout_gives_its_watts(tmp_path: Path, name: str) -> None:
    nodes, watts = LAYOUTS[name]
    sysfs = Sysfs(build_tree(tmp_path, nodes))
    gauge = BatteryGauge(sysfs)
    assert gauge.report().power_w == pytest.approx(watts, rel=1e-9)
    assert gauge.read().power_w == pytest.approx(watts, rel=1e-9)
    assert choose("auto", tmp_path).source.method == "battery_gauge"


# name: (nodes, part of the reason, what auto takes then)
REFUSED: dict[str, tuple[Nodes, str, str]] = {
    "docked laptop at its charge threshold": (
        {"AC": {"type": "Mains", "online": 1}, "BAT0": battery(status="Not charging", power_now=0)},
        "mains power online (AC)",
        "none",
    ),
    "power by USB-C, programmable supply": (
        {"ucsi-source-psy-USBC000_001": {"type": "USB", "online": 2}, "BAT0": battery(power_now=9_000_000)},
        "mains power online (ucsi-source-psy-USBC000_001)",
        "none",
    ),
    "phone whose cable renames its type": (
        {"usb": {"type": "USB_HVDCP_3", "online": 1}, "battery": battery(current_now=400_000, voltage_now=4_000_000)},
        "mains power online (usb)",
        "none",
    ),
    "phone on a wireless pad": (
        {"wireless": {"type": "Wireless", "online": 1}, "battery": battery(current_now=1, voltage_now=4_000_000)},
        "mains power online (wireless)",
        "none",
    ),
    "desktop with a UPS": (
        {"ups0": {"type": "UPS", "status": "Discharging", "power_now": 120_000_000, "present": 1}},
        "no system battery; ups0 is a UPS, which may feed more than this machine",
        "none",
    ),
    "empty bay": (
        {"AC": UNPLUGGED, "BAT0": {"type": "Battery", "present": 0, "status": "Unknown"}},
        "no system battery",
        "none",
    ),
    "battery full, cable unseen": ({"BAT0": battery(status="Full", power_now=0)}, "BAT0 is Full", "none"),
    "battery status unknown": ({"BAT0": battery(status="Unknown", power_now=9_000_000)}, "BAT0 is Unknown", "none"),
    "battery without a status": (
        {"BAT0": {"type": "Battery", "present": 1, "power_now": 9_000_000}},
        "BAT0 is without a status",
        "none",
    ),
    "one pack charges the other": (
        {"BAT0": battery(power_now=30_000_000), "BAT1": battery(status="Charging", power_now=15_000_000)},
        "BAT1 is charging",
        "none",
    ),
    "Samsung's milliamperes": (
        {"battery": battery(current_now=-412, voltage_now=4_011_000, charge_counter=2_480_000)},
        "its driver's units are wrong",
        "battery_counter",
    ),
    "voltage in millivolts": (
        {"BAT0": battery(current_now=800_000, voltage_now=12_000, charge_now=4_000_000)},
        "voltage_now says 0.012 V, which no pack has",
        "none",
    ),
    "design voltage only": (
        {"BAT0": battery(current_now=800_000, voltage_min_design=11_400_000, charge_now=4_000_000)},
        "tells no rate",
        "none",
    ),
    "max17040: voltage and percent only": (
        {"max17040": battery(voltage_now=3_950_000, capacity=90)},
        "tells no rate",
        "none",
    ),
    "ACPI: rate unknown as a current": (
        {"BAT0": battery(current_now=4_294_967_295, voltage_now=12_000_000, charge_now=4_000_000)},
        "current_now says 4294967295 stands for unknown",
        "battery_counter",
    ),
    "charge counter unknown as well": (
        {"BAT0": battery(charge_now=4_294_967_295_000, voltage_now=12_000_000)},
        "charge_now says 4294967295000 stands for unknown",
        "none",
    ),
    "second pack tells no rate": (
        {"BAT0": battery(power_now=9_000_000, energy_now=1), "BAT1": battery(energy_now=20_000_000)},
        "tells no rate",
        "battery_counter",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_layout_is_refused_with_its_reason(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("joulebox_agent.sources.choose.FIRST_REFRESH_S", 0.0)
    nodes, reason, then = REFUSED[name]
    sysfs = Sysfs(build_tree(tmp_path, nodes))
    report, reading = BatteryGauge(sysfs).report(), BatteryGauge(sysfs).read()
    assert report.power_w is None
    assert reason in report.reason
    assert report.remedy
    assert reading.power_w is None
    assert reason in (reading.refusal or reading.problem or "")
    assert choose("auto", tmp_path).source.method == then


def test_gauges_of_one_cell_are_named_and_stay_one(tmp_path: Path) -> None:
    """Once known for one cell they stay one when their readings part: the power must not double with it."""
    nodes, watts = LAYOUTS["Pixel (google_battery, maxfg, two wireless nodes)"]
    gauge = BatteryGauge(Sysfs(build_tree(tmp_path, nodes)))
    assert "maxfg is a second gauge of battery's cell, counted once" in gauge.report().reason
    (tmp_path / "class/power_supply/maxfg/current_now").write_text("-900000\n")
    assert gauge.read().power_w == pytest.approx(watts)


def test_packs_that_take_turns_never_become_one(tmp_path: Path) -> None:
    nodes, _ = LAYOUTS["two packs in turn, amperes, alike in everything but the current"]
    gauge = BatteryGauge(Sysfs(build_tree(tmp_path, nodes)))
    gauge.read()
    for name, current in (("BAT0", 710_000), ("BAT1", 0)):
        (tmp_path / f"class/power_supply/{name}/current_now").write_text(f"{current}\n")
    assert gauge.read().power_w == pytest.approx(0.71 * 12.0)


def test_a_zero_at_the_first_look_does_not_stay(tmp_path: Path) -> None:
    gauge = BatteryGauge(Sysfs(build_tree(tmp_path, {"BAT0": battery(power_now=0)})))
    assert gauge.read().problem == "the gauge says 0 W while discharging"
    (tmp_path / "class/power_supply/BAT0/power_now").write_text("8000000\n")
    assert gauge.read().power_w == pytest.approx(8.0)


def test_of_two_counts_of_one_charge_the_kernels_own_name_counts(tmp_path: Path) -> None:
    files = {"charge_now": 2_480_000, "charge_counter": 900_000, "voltage_now": 4_000_000}
    counter = BatteryCounter(Sysfs(build_tree(tmp_path, {"battery": battery(**files)})))
    counter.read()
    for name, micro_ah in (("charge_now", 2_479_000), ("charge_counter", 895_000)):
        (tmp_path / f"class/power_supply/battery/{name}").write_text(f"{micro_ah}\n")
    assert counter.read().counter_j == pytest.approx(14.4)


def test_androids_charge_counter_counts(tmp_path: Path) -> None:
    """1 mAh at 4 V is 14.4 J."""
    tree = build_tree(tmp_path, {"battery": battery(charge_counter=2_480_000, voltage_now=4_000_000)})
    counter = BatteryCounter(Sysfs(tree))
    counter.read()
    (tmp_path / "class/power_supply/battery/charge_counter").write_text("2479000\n")
    assert counter.read().counter_j == pytest.approx(14.4)
