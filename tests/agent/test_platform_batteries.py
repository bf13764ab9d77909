"""The batteries of Windows, macOS and Android from what their systems were recorded to say, and from nonsense."""

import json
import plistlib
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from agent_testing import DATA
from hypothesis import given
from hypothesis import strategies as st
from joulebox_agent.sources.battery_counter import PackCounter
from joulebox_agent.sources.battery_gauge import PackGauge
from joulebox_agent.sources.mac_battery import MacBattery, decode_smart_battery
from joulebox_agent.sources.packs import Battery, Supplies
from joulebox_agent.sources.termux_battery import TermuxBattery, decode_battery_status
from joulebox_agent.sources.windows_battery import WindowsBattery, call_windows, decode_battery_state

WINDOWS = DATA.parent / "windows_system_battery_state"
MACOS = DATA.parent / "macos_ioreg"
BATTERIES = {"windows": WindowsBattery, "macos": MacBattery, "android": TermuxBattery}
# What BatteryStatusAPI of Termux:API 0.53 writes; the numbers are those of the recorded phone's sysfs tree.
PHONE = {"present": True, "technology": "Li-ion", "health": "GOOD", "plugged": "UNPLUGGED", "status": "DISCHARGING",
         "temperature": 30.1, "voltage": 4011, "current": -412500, "current_average": -398000, "percentage": 62,
         "level": 62, "scale": 100, "charge_counter": 2480000, "cycle": 210}  # fmt: skip


def windows_state(rate_mw: int = -16834, **flags: bool) -> bytes:
    on = {"on_line": False, "present": True, "charging": False, "discharging": True} | flags
    return struct.pack("<4?3xB6I", *on.values(), 0, 47000, 40000, rate_mw & 0xFFFFFFFF, 8553, 2500, 1000)


def mac_state(**changes: Any) -> bytes:
    node = plistlib.loads((MACOS / "ioreg.plist").read_bytes())[0] | changes
    return plistlib.dumps([{key: value for key, value in node.items() if value is not None}])


def phone_state(**changes: Any) -> bytes:
    return json.dumps({key: value for key, value in (PHONE | changes).items() if value is not None}).encode()


def gauge_of(battery: Battery) -> PackGauge:
    return PackGauge(battery)


@pytest.mark.parametrize("name", ["discharging.bin", "unknown_rate.bin"])
def test_recorded_structs_of_windows(name: str) -> None:
    watts = json.loads((WINDOWS / "expected.json").read_text())[name]["watts"]
    gauge = gauge_of(WindowsBattery((WINDOWS / name).read_bytes))
    reading, report = gauge.read(), gauge.report()
    assert report.power_w == reading.power_w == (None if watts is None else pytest.approx(watts, abs=1e-9))
    assert (reading.problem is None) == (watts is not None)
    assert report.method == "battery_gauge"
    assert "CallNtPowerInformation" in report.files[0]


def test_the_counter_of_windows_stands_in_for_an_unknown_rate() -> None:
    states = iter([windows_state(-0x80000000), windows_state(-0x80000000)])
    counter = PackCounter(WindowsBattery(lambda: next(states)))
    assert counter.read().counter_j == 0.0
    assert counter.read().counter_j == 0.0
    report = PackCounter(WindowsBattery(lambda: windows_state(-0x80000000))).report()
    assert report.available
    assert report.resolution_j == pytest.approx(3.6)


def test_recorded_property_list_of_macos() -> None:
    expected = json.loads((MACOS / "expected.json").read_text())
    assert gauge_of(MacBattery((MACOS / "ioreg.plist").read_bytes)).read().power_w == pytest.approx(
        expected["instant_watts"], abs=1e-6
    )
    without = MacBattery(lambda: mac_state(InstantAmperage=None))
    assert gauge_of(without).read().power_w == pytest.approx(expected["average_watts"], abs=1e-6)


def test_macos_negative_amperes_may_come_signed_too() -> None:
    """-1438 mA as 2^64 - 1438 and as -1438."""
    assert gauge_of(MacBattery(lambda: mac_state(InstantAmperage=-1438))).read().power_w == pytest.approx(17.136646)


def test_a_refresh_of_macos_shows_even_where_the_current_is_the_same() -> None:
    states = iter([mac_state(UpdateTime=1000), mac_state(UpdateTime=1000), mac_state(UpdateTime=1060)])
    gauge = gauge_of(MacBattery(lambda: next(states)))
    first, second, third = gauge.read(), gauge.read(), gauge.read()
    assert first.raw == second.raw != third.raw


def test_apples_percent_is_no_charge() -> None:
    """Apple's own chips call 100 the full capacity: taken for mAh the counter would be 50 times off."""
    shares = MacBattery(lambda: mac_state(MaxCapacity=100, CurrentCapacity=85))
    assert gauge_of(shares).read().counter_j is None
    assert shares.full_wh() is None
    raw = MacBattery(
        lambda: mac_state(
            MaxCapacity=100, CurrentCapacity=85, AppleRawCurrentCapacity=4000, AppleRawMaxCapacity=5000, Voltage=12000
        )
    )
    assert gauge_of(raw).read().counter_j == 0.0
    assert raw.full_wh() == pytest.approx(60.0)


def test_what_termux_tells() -> None:
    gauge = gauge_of(TermuxBattery(phone_state))
    reading = gauge.read()
    assert reading.power_w == pytest.approx(0.4125 * 4.011)
    assert reading.counter_j == 0.0
    averaged = gauge_of(TermuxBattery(lambda: phone_state(current=None))).read()
    assert averaged.power_w == pytest.approx(0.398 * 4.011)
    assert "no power_now" in (gauge_of(TermuxBattery(lambda: phone_state(voltage=None))).read().problem or "")


@pytest.mark.parametrize(
    ("platform", "data", "words"),
    [
        ("windows", windows_state(on_line=True), "mains power online (AC)"),
        ("windows", windows_state(present=False), "no system battery"),
        ("windows", windows_state(charging=True, discharging=False), "battery is charging"),
        ("windows", windows_state(discharging=False), "battery is Not charging"),
        ("macos", mac_state(ExternalConnected=True), "mains power online (AC)"),
        ("macos", mac_state(ExternalConnected=True, FullyCharged=True), "mains power online (AC)"),
        ("macos", mac_state(BatteryInstalled=False), "no system battery"),
        ("macos", plistlib.dumps([]), "no system battery"),
        ("macos", b"", "no system battery"),
        ("android", phone_state(plugged="PLUGGED_USB"), "mains power online (PLUGGED_USB)"),
        ("android", phone_state(status="NOT_CHARGING"), "battery is Not charging"),
        ("android", phone_state(status="FULL"), "battery is Full"),
        ("android", phone_state(status="UNKNOWN"), "battery is Unknown"),
        ("android", phone_state(present=False), "no system battery"),
    ],
)
def test_only_a_discharge_without_a_cable_counts(platform: str, data: bytes, words: str) -> None:
    gauge = gauge_of(BATTERIES[platform](lambda: data))
    assert words in (gauge.read().refusal or "")
    assert gauge.read().power_w is None
    report = gauge.report()
    assert not report.available
    assert words in report.reason
    assert report.remedy


@pytest.mark.parametrize(
    ("platform", "data", "words"),
    [
        ("windows", b"", "gave 0 bytes, not 32"),
        ("windows", windows_state()[:31], "gave 31 bytes, not 32"),
        ("windows", struct.pack("<4?3xB6I", False, True, False, True, 0, 100, 85, 0x80000000, 1, 5, 5), "in shares"),
        ("windows", windows_state(0), "0 W while discharging"),
        ("windows", windows_state(-2_000_000), "no machine draws"),
        ("macos", b"bplist00\xff\xff", "no property list"),
        ("macos", b"<plist><array><dict>", "no property list"),
        ("macos", plistlib.dumps({"a": 1}), "no list of nodes"),
        ("macos", mac_state(InstantAmperage="fast", Amperage=None), "tells no rate"),
        ("macos", mac_state(Voltage=11), "no pack has"),
        ("android", b"", "printed no JSON"),
        ("android", b"[1]", "printed list, not an object"),
        ("android", b'{"error": "Termux:API is not installed"}', "Termux:API is not installed"),
        ("android", phone_state(current="-412500", current_average=None), "no whole number"),
        ("android", phone_state(current=0, current_average=None), "0 W while discharging"),
        ("android", phone_state(voltage=-1000), "no pack has"),
    ],
)
def test_nonsense_is_one_sentence(platform: str, data: bytes, words: str) -> None:
    gauge = gauge_of(BATTERIES[platform](lambda: data))
    reading = gauge.read()
    assert reading.power_w is None
    assert words in (reading.problem or "")
    assert words in gauge.report().reason


def words_of(decode: Callable[[bytes], Supplies], data: bytes) -> str:
    try:
        return decode(data).refusal() or "discharging"
    except OSError as error:
        return f"{error.filename} {error.strerror}"


@given(st.binary(max_size=64))
def test_any_bytes_are_a_supply_or_an_error_with_words(data: bytes) -> None:
    for decode in (decode_battery_state, decode_smart_battery, decode_battery_status):
        assert "None" not in words_of(decode, data)


def test_another_system_says_that_it_is_another(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delattr("ctypes.windll", raising=False)
    with pytest.raises(OSError, match="not this platform"):
        call_windows()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "cannot be started" in (gauge_of(TermuxBattery()).read().problem or "")
