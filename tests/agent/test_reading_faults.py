"""What kernel files answer when they should not: retried, voided, passed over or refused, and always in words."""

import errno
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from agent_testing import EIO, ENODATA, ENODEV, FaultySysfs, ScriptedClock, build_tree
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from joulebox_agent.conditions import other_cpu_share, read_conditions
from joulebox_agent.sources.battery_counter import BatteryCounter
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.choose import choose, unfit_reason
from joulebox_agent.sources.packs import UNKNOWN_MICRO
from joulebox_agent.sources.sysfs import Sysfs

Tree = Callable[[str], Path]
SUPPLIES = "class/power_supply"
BAT0 = f"{SUPPLIES}/BAT0"
BOTH = {"power_now": 9_500_000, "current_now": 800_000, "voltage_now": 12_000_000, "energy_now": 30_000_000}


@pytest.fixture
def laptop(tmp_path: Path) -> Path:
    """A pack that tells its power (9.5 W), current x voltage (9.6 W) and energy."""
    pack: dict[str, object] = {"type": "Battery", "present": 1, "status": "Discharging", **BOTH}
    return build_tree(tmp_path / "sys", {"AC": {"type": "Mains", "online": 0}, "BAT0": pack})


# --- errors of a file --------------------------------------------------------------------------------------


@pytest.mark.parametrize("code", [ENODEV, ENODATA, errno.ENXIO, errno.EINVAL, errno.ENOENT])
@pytest.mark.parametrize(
    ("files", "watts"),
    [
        (("power_now",), 9.6),
        (("power_now", "current_now"), None),
        (("power_now", "voltage_now"), None),
        (("current_now", "voltage_now"), 9.5),
    ],
)
def test_unknown_falls_back_from_power_to_current_to_counter(
    laptop: Path, code: int, files: tuple[str, ...], watts: float | None
) -> None:
    sysfs = FaultySysfs(laptop, {f"{BAT0}/{name}": code for name in files})
    assert BatteryGauge(sysfs).report().power_w == (None if watts is None else pytest.approx(watts))
    assert BatteryCounter(sysfs).report().available


@pytest.mark.parametrize("code", [EIO, errno.ETIMEDOUT, errno.EREMOTEIO, errno.EBUSY, errno.EAGAIN])
def test_a_fault_is_tried_once_more_then_voids_the_sample(laptop: Path, code: int) -> None:
    """It does not fall back: 9.5 W and 9.6 W of one pack must not take turns."""
    once = BatteryGauge(FaultySysfs(laptop, {f"{BAT0}/power_now": code}, times=1)).read()
    assert (once.power_w, once.problem) == (pytest.approx(9.5), None)
    gauge = BatteryGauge(FaultySysfs(laptop, {f"{BAT0}/power_now": code}, times=2))
    void, after = gauge.read(), gauge.read()
    assert (void.power_w, void.refusal) == (None, None)
    assert "BAT0/power_now: injected" in (void.problem or "")
    assert (after.power_w, after.problem) == (pytest.approx(9.5), None)


@pytest.mark.parametrize("name", ["energy_now", "voltage_now", "current_now"])
def test_a_fault_of_what_is_not_needed_costs_no_sample(laptop: Path, name: str) -> None:
    gauge = BatteryGauge(FaultySysfs(laptop, {f"{BAT0}/{name}": EIO}))
    reading = gauge.read()
    assert (reading.power_w, reading.problem) == (pytest.approx(9.5), None)
    assert gauge.report().available


def test_a_fault_of_the_counter_is_a_gap_not_a_new_count(laptop: Path) -> None:
    sysfs = FaultySysfs(laptop, {f"{BAT0}/energy_now": EIO}, times=0)
    for source in (BatteryCounter(sysfs), BatteryGauge(sysfs)):
        (laptop / BAT0 / "energy_now").write_text("30000000\n")
        first = source.read()
        sysfs.left = 2
        gap = source.read()
        (laptop / BAT0 / "energy_now").write_text("29990000\n")
        after = source.read()
        assert gap.counter_j is None
        assert after.counter_j == pytest.approx(36.0)
        assert first.epoch == gap.epoch == after.epoch


@pytest.mark.parametrize("name", ["status", "present"])
def test_a_fault_of_the_state_voids_the_sample_only(laptop: Path, name: str) -> None:
    gauge = BatteryGauge(FaultySysfs(laptop, {f"{BAT0}/{name}": EIO}, times=2))
    assert f"BAT0/{name}" in (gauge.read().problem or "")
    assert gauge.read().power_w == pytest.approx(9.5)


@pytest.mark.parametrize("content", ["", "yes\n", "0x1\n"])
def test_a_cable_that_says_nonsense_is_not_taken_for_unplugged(laptop: Path, content: str) -> None:
    (laptop / SUPPLIES / "AC/online").write_text(content)
    gauge = BatteryGauge(Sysfs(laptop))
    assert "AC/online" in (gauge.read().problem or "")
    assert not gauge.report().available
    assert "AC/online" in (unfit_reason("auto", laptop) or "")


# --- content of a file -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\n", "is empty"),
        (b"\x00\x00\x00\x00", "no number"),
        (b"9500000\x00\x00", "no number"),
        (b"\xff\xfe\x8f\x01 junk", "no number"),
        (b"9" * 5000, "holds more than 4096 bytes"),
        (b"9" * 400, "no number"),
        (b"0x90f560", "no number"),
        (b"9500000.0", "no number"),
        (b"9.5e6", "no number"),
        (b"9_500_000", "no number"),
        ("９５０００００".encode(), "no number"),
        (b"9500000 uW", "no number"),
        (b"nan", "no number"),
        (b"-1", ""),
        (b"4294967295", "stands for unknown"),
        (b"99999999999999", "no machine draws"),
    ],
)
def test_content_that_is_no_power_falls_back_and_is_named_when_nothing_else_tells(
    laptop: Path, content: bytes, words: str
) -> None:
    (laptop / BAT0 / "power_now").write_bytes(content)
    assert BatteryGauge(Sysfs(laptop)).report().power_w == pytest.approx(9.6)
    (laptop / BAT0 / "current_now").unlink()
    report = BatteryGauge(Sysfs(laptop)).report()
    assert report.power_w is None
    assert words in report.reason
    assert choose("auto", laptop).source.method == "battery_counter"


@pytest.mark.parametrize("content", [b"+9500000", b"-9500000\n", b"  9500000  \n", b"009500000"])
def test_numbers_however_they_are_written(laptop: Path, content: bytes) -> None:
    (laptop / BAT0 / "power_now").write_bytes(content)
    assert BatteryGauge(Sysfs(laptop)).report().power_w == pytest.approx(9.5)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    st.sampled_from(["power_now", "current_now", "voltage_now", "energy_now", "status", "type", "present"]),
    st.binary(max_size=40),
)
def test_no_content_gives_a_traceback_or_watts_that_no_machine_draws(laptop: Path, name: str, content: bytes) -> None:
    file = laptop / BAT0 / name
    kept = file.read_bytes()
    try:
        file.write_bytes(content)
        report, reading = BatteryGauge(Sysfs(laptop)).report(), BatteryGauge(Sysfs(laptop)).read()
        assert report.reason
        assert report.power_w is None or 0.05 <= report.power_w <= 1000
        assert (reading.power_w is None) == bool(reading.problem or reading.refusal)
        assert read_conditions(laptop)
    finally:
        file.write_bytes(kept)


# --- what stands where a file should be --------------------------------------------------------------------


def put_folder(path: Path) -> None:
    path.mkdir()


def put_loop(path: Path) -> None:
    path.symlink_to(path.name)


def put_broken_link(path: Path) -> None:
    path.symlink_to("/no/such/device")


def put_pipe(path: Path) -> None:
    os.mkfifo(path)


def put_endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
@pytest.mark.parametrize("put", [put_folder, put_loop, put_broken_link, put_pipe, put_endless])
def test_what_is_no_file_is_passed_over_without_waiting(laptop: Path, put: Callable[[Path], None]) -> None:
    (laptop / BAT0 / "power_now").unlink()
    put(laptop / BAT0 / "power_now")
    assert BatteryGauge(Sysfs(laptop)).report().power_w == pytest.approx(9.6)
    put(laptop / SUPPLIES / "odd")
    assert BatteryGauge(Sysfs(laptop)).report().power_w == pytest.approx(9.6)


def test_a_pipe_that_somebody_holds_open_does_not_hang(laptop: Path) -> None:
    (laptop / BAT0 / "power_now").unlink()
    os.mkfifo(laptop / BAT0 / "power_now")
    writer = os.open(laptop / BAT0 / "power_now", os.O_RDWR)
    try:
        assert "power_now" in (BatteryGauge(Sysfs(laptop)).read().problem or "")
    finally:
        os.close(writer)


# --- permission --------------------------------------------------------------------------------------------


@contextmanager
def as_anybody() -> Iterator[None]:
    """Gives up root for a moment, so that modes count."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def open_laptop(laptop: Path) -> Path:
    """The laptop's tree where another user can reach it."""
    for folder in [laptop, *laptop.parents]:
        if not folder.stat().st_mode & 0o001 and os.geteuid() == 0:
            folder.chmod(folder.stat().st_mode | 0o011)
    return laptop


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no modes on this system")
@pytest.mark.parametrize("closed", [SUPPLIES, "class"])
def test_a_closed_folder_is_a_matter_of_permission_not_of_batteries(open_laptop: Path, closed: str) -> None:
    folder = open_laptop / closed
    folder.chmod(0)
    try:
        with as_anybody():
            gauge = BatteryGauge(Sysfs(open_laptop))
            report, reading, unfit = gauge.report(), gauge.read(), unfit_reason("auto", open_laptop)
            conditions = read_conditions(open_laptop)
    finally:
        folder.chmod(0o755)
    assert not report.available
    assert "Permission denied" in report.reason
    assert report.remedy.startswith("sudo chmod ")
    assert "\n" not in report.remedy
    assert "Permission denied" in (reading.problem or "")
    assert "Permission denied" in (unfit or "")
    assert conditions["mains_online"] is None


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no modes on this system")
@pytest.mark.parametrize(
    ("files", "watts"), [(("power_now",), 9.6), (("power_now", "current_now"), None), (("energy_now",), 9.5)]
)
def test_a_closed_file_is_passed_over_and_named(open_laptop: Path, files: tuple[str, ...], watts: float | None) -> None:
    for name in files:
        (open_laptop / BAT0 / name).chmod(0)
    with as_anybody():
        report = BatteryGauge(Sysfs(open_laptop)).report()
    assert report.power_w == (None if watts is None else pytest.approx(watts))
    assert "Permission denied" in report.reason
    if watts is None:
        assert report.remedy.startswith("sudo chmod a+r ")


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no modes on this system")
def test_a_closed_node_may_hide_a_cable(open_laptop: Path) -> None:
    (open_laptop / SUPPLIES / "AC").chmod(0)
    try:
        with as_anybody():
            report = BatteryGauge(Sysfs(open_laptop)).report()
    finally:
        (open_laptop / SUPPLIES / "AC").chmod(0o755)
    assert not report.available
    assert "AC/type: Permission denied" in report.reason


# --- packs that come and go --------------------------------------------------------------------------------


@pytest.fixture
def two_packs(tmp_path: Path) -> Path:
    def pack(power_uw: int) -> dict[str, object]:
        return {
            "type": "Battery",
            "present": 1,
            "status": "Discharging",
            "power_now": power_uw,
            "energy_now": 9_000_000,
        }

    return build_tree(tmp_path / "sys", {"BAT0": pack(4_000_000), "BAT1": pack(5_000_000)})


def remove_folder(folder: Path) -> None:
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()


def empty_bay(folder: Path) -> None:
    (folder / "present").write_text("0\n")
    (folder / "status").write_text("Unknown\n")


@pytest.mark.parametrize("pull", [remove_folder, empty_bay])
def test_a_pulled_pack_voids_one_sample_and_starts_another_count(two_packs: Path, pull: Callable[[Path], None]) -> None:
    gauge = BatteryGauge(Sysfs(two_packs))
    before = gauge.read()
    pull(two_packs / SUPPLIES / "BAT1")
    pulled, after = gauge.read(), gauge.read()
    assert before.power_w == pytest.approx(9.0)
    assert pulled.power_w is None
    assert pulled.problem == "the packs changed from BAT0, BAT1 to BAT0"
    assert pulled.refusal is None
    assert after.power_w == pytest.approx(4.0)
    assert before.epoch < pulled.epoch == after.epoch


@pytest.mark.parametrize("pull", [remove_folder, empty_bay])
def test_the_last_pack_gone_ends_it(two_packs: Path, pull: Callable[[Path], None]) -> None:
    gauge, counter = BatteryGauge(Sysfs(two_packs)), BatteryCounter(Sysfs(two_packs))
    gauge.read()
    counter.read()
    for name in ("BAT0", "BAT1"):
        pull(two_packs / SUPPLIES / name)
    assert gauge.read().refusal == counter.read().refusal == "no system battery"


def test_a_pack_that_vanishes_while_it_is_read_is_not_half_a_power(two_packs: Path) -> None:
    class Pulled(Sysfs):
        """BAT1 disappears right after its power was read."""

        def text(self, path: Path) -> str:
            content = super().text(path)
            if path.match("BAT1/power_now"):
                remove_folder(path.parent)
            return content

    gauge = BatteryGauge(Pulled(two_packs))
    reading = gauge.read()
    assert reading.power_w is None
    assert "pulled out while it was read" in (reading.problem or "")
    assert gauge.read().power_w == pytest.approx(4.0)


def test_a_tree_that_changes_all_the_time_gives_known_watts_or_none(two_packs: Path) -> None:
    """A pack is plugged in and pulled out by another thread: 4 W or 9 W, never a sum of halves."""
    ended = threading.Event()
    bay = two_packs / SUPPLIES / "BAT1"
    elsewhere = two_packs / "pulled"

    def juggle() -> None:
        while not ended.is_set():
            bay.rename(elsewhere)
            elsewhere.rename(bay)

    thread = threading.Thread(target=juggle)
    thread.start()
    try:
        gauge = BatteryGauge(Sysfs(two_packs))
        seen = {reading.power_w for reading in (gauge.read() for _ in range(300))}
    finally:
        ended.set()
        thread.join()
    assert {round(power_w, 9) for power_w in seen if power_w is not None} <= {4.0, 9.0}


# --- counters ----------------------------------------------------------------------------------------------


def test_a_counter_that_jumps_is_not_believed(laptop: Path) -> None:
    """A glitch to a tenth and back: neither the fall nor the rise is energy."""
    clock = ScriptedClock()
    counter = BatteryCounter(Sysfs(laptop), clock)
    readings = [counter.read()]
    for micro_wh in (29_990_000, 3_000_000, 29_980_000, 29_970_000):
        clock.time_s += 4.0
        (laptop / BAT0 / "energy_now").write_text(f"{micro_wh}\n")
        readings.append(counter.read())
    assert [reading.counter_j for reading in readings] == pytest.approx([0, 36, 36, 36, 72])
    assert [reading.epoch for reading in readings] == [0, 0, 1, 2, 2]


def test_a_coarse_counter_may_take_its_time(laptop: Path) -> None:
    """A step of 2 % of 50 Wh after 200 s is 18 W, though more than 1 % of a large pack at once."""
    clock = ScriptedClock()
    counter = BatteryCounter(Sysfs(laptop), clock)
    counter.read()
    clock.time_s += 200.0
    (laptop / BAT0 / "energy_now").write_text("29000000\n")
    reading = counter.read()
    assert (reading.counter_j, reading.epoch) == (pytest.approx(3600.0), 0)


@pytest.mark.parametrize("micro", sorted(UNKNOWN_MICRO))
def test_a_counter_never_starts_from_unknown(laptop: Path, micro: int) -> None:
    (laptop / BAT0 / "energy_now").write_text(f"{micro}\n")
    assert BatteryCounter(Sysfs(laptop)).read().counter_j is None


# --- conditions --------------------------------------------------------------------------------------------


def test_load_of_others_leaves_ours_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two cores, 10 s: 20 s of machine, 9 s busy, of which we used 4 and our renderer, still running, 3."""
    monkeypatch.setattr("joulebox_agent.conditions.os.cpu_count", lambda: 2)
    before = {"cpu_machine_s": 100.0, "cpu_busy_s": 10.0, "cpu_own_s": 1.0}
    after = {"cpu_machine_s": 120.0, "cpu_busy_s": 19.0, "cpu_own_s": 5.0}
    assert other_cpu_share(before, after, rendering_cpu_s=3.0) == pytest.approx(0.2)
    assert other_cpu_share(before, {}) is None
    assert other_cpu_share(before, before) is None


def test_a_panel_that_is_switched_off_is_dark(tmp_path: Path) -> None:
    panel = tmp_path / "class" / "backlight" / "intel_backlight"
    panel.mkdir(parents=True)
    for name, value in {"brightness": 300, "max_brightness": 400, "bl_power": 0}.items():
        (panel / name).write_text(str(value))
    assert read_conditions(tmp_path)["brightness_share"] == 0.75
    (panel / "bl_power").write_text("4")
    assert read_conditions(tmp_path)["brightness_share"] == 0.0
