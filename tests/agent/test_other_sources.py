"""Percent, exec, hwmon and the estimate; and how a name becomes a source."""

import json
import shlex
import subprocess
import sys
import time
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import pytest
from agent_testing import DATA, EIO, RENDERER, FaultySysfs, build_tree
from joulebox_agent.errors import SourceUnavailableError, UsageError
from joulebox_agent.sources.battery_percent import BatteryPercent, Charge
from joulebox_agent.sources.choose import choose, make_source
from joulebox_agent.sources.command import run_command
from joulebox_agent.sources.estimate_cpu_time import EstimateCpuTime, busy_cpu_s
from joulebox_agent.sources.exec_command import ExecCommand
from joulebox_agent.sources.hwmon import Hwmon
from joulebox_agent.sources.power_supply import PowerSupplyClass
from joulebox_agent.sources.survey import survey
from joulebox_agent.sources.sysfs import Sysfs

Agent = Callable[..., tuple[int, str, str]]
Tree = Callable[[str], Path]


def python(program: str) -> str:
    return shlex.join([sys.executable, "-S", "-E", "-c", program])


# --- percent -----------------------------------------------------------------------------------------------


def percents(
    *charges: Charge | None, capacity_wh: float | None = None, tree: str = "thinkpad_power_now"
) -> BatteryPercent:
    told = iter(charges)
    return BatteryPercent(PowerSupplyClass(Sysfs(DATA / tree / "sys")), capacity_wh, lambda: next(told))


def test_a_percent_is_a_hundredth_of_a_full_charge() -> None:
    source = percents(Charge(80, False), Charge(80, False), Charge(78, False))
    assert [source.read().counter_j for _ in range(3)] == [0.0, 0.0, pytest.approx(0.02 * 47.39 * 3600)]
    report = percents(Charge(80, False)).report()
    assert report.available
    assert report.resolution_j == pytest.approx(47.39 * 36)


def test_a_percentage_that_rises_starts_another_epoch() -> None:
    source = percents(Charge(80, False), Charge(81, False), Charge(80, False))
    readings = [source.read() for _ in range(3)]
    assert [reading.epoch for reading in readings] == [0, 1, 1]
    assert readings[-1].counter_j == pytest.approx(0.01 * 47.39 * 3600)


@pytest.mark.parametrize(
    ("charge", "words"),
    [
        (None, "no system battery"),
        (Charge(80, True), "mains power online"),
        (Charge(80, None), "nothing tells whether mains power is online"),
        (Charge(255, False), "the percentage is 255"),
    ],
)
def test_percent_refuses_what_the_gauges_refuse(charge: Charge | None, words: str) -> None:
    assert percents(charge).report().reason == words
    assert percents(charge).read().refusal == words


def test_a_capacity_that_nobody_tells_can_be_named() -> None:
    """psutil sees the first of two packs only, so two packs have no capacity that fits its percentage."""
    report = percents(Charge(80, False), tree="thinkpad_dual").report()
    assert not report.available
    assert report.remedy == "name the watt-hours: --source battery_percent:48"
    source = percents(Charge(80, False), Charge(79, False), capacity_wh=48, tree="thinkpad_dual")
    assert source.read().counter_j == 0.0
    assert source.read().counter_j == pytest.approx(1728)
    for wrong in ("battery_percent:0", "battery_percent:nan", "battery_percent:big"):
        with pytest.raises(UsageError, match="must be watt-hours"):
            make_source(wrong, DATA / "thinkpad_dual" / "sys")


def test_percent_of_this_machine_is_not_told_for_another_tree() -> None:
    with pytest.raises(SourceUnavailableError, match="of this machine, and --sysfs-root of another"):
        choose("battery_percent:48", DATA / "thinkpad_power_now" / "sys")


# --- exec --------------------------------------------------------------------------------------------------


def test_a_command_tells_watts_or_joules() -> None:
    watts = ExecCommand(python('print(\'{"power_w": 12.5, "scope": "wall plug"}\')'))
    report = watts.report()
    assert (report.available, report.power_w, report.scope) == (True, 12.5, "wall plug")
    assert (watts.primary, watts.read().power_w, watts.read().problem) == ("power", 12.5, None)
    told = iter([b'{"energy_j": 100}', b'{"energy_j": 107.5}', b'{"energy_j": 3}', b'{"energy_j": 4}'])
    joules = ExecCommand("meter", lambda: next(told))
    readings = [joules.read() for _ in range(4)]
    assert joules.primary == "counter"
    assert [reading.counter_j for reading in readings] == [0.0, 7.5, 0.0, 1.0]
    assert [reading.epoch for reading in readings] == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("printed", "words"),
    [
        (b"", "printed nothing"),
        (b"12.5", "not an object with power_w or energy_j"),
        (b"12.5 W", "printed '12.5 W', not JSON"),
        (b"\xff\x00", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b'{"watts": 3}', "not an object with power_w or energy_j"),
        (b'{"power_w": null}', "no reading"),
        (b'{"power_w": "12"}', "power_w is '12', which is no number"),
        (b'{"power_w": true}', "which is no number"),
        (b'{"power_w": NaN}', "which is no number"),
        (b'{"power_w": -1}', "power_w is -1; from 0 to 10000 is right"),
        (b'{"power_w": 1e9}', "from 0 to 10000 is right"),
        (b'{"power_w": 1' + b"0" * 400 + b"}", "which is no number"),
        (b'{"power_w": ' + b"9" * 5000 + b"}", "which is no number"),
        (b'{"energy_j": -1}', "energy_j is -1"),
    ],
)
def test_bad_output_is_named(printed: bytes, words: str) -> None:
    source = ExecCommand("meter --json", lambda: printed)
    assert words in (source.read().problem or "")
    report = source.report()
    assert not report.available
    assert report.reason.startswith("meter: ")
    assert words in report.reason


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("import sys; sys.exit('no such meter')", "left with code 1: no such meter"),
        ("import sys\nwhile True: sys.stdout.write('x' * 65536)", "printed more than 1048576 bytes"),
        ("import time; time.sleep(60)", "did not answer within 0.3 s"),
        (
            "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(60)'])",
            "within 0.3 s",
        ),
    ],
)
def test_a_command_that_fails_floods_or_hangs_is_ended(program: str, words: str) -> None:
    started_s = time.monotonic()
    with pytest.raises(OSError, match=words):
        run_command([sys.executable, "-S", "-E", "-c", program], 0.3 if "sleep" in program else 20.0)
    assert time.monotonic() - started_s < 20.0


def test_a_command_that_is_not_there() -> None:
    with pytest.raises(SourceUnavailableError, match="no-such-meter: cannot be started: No such file"):
        choose("exec:no-such-meter --json")
    for wrong in ("exec:", "exec:'unclosed"):
        with pytest.raises(UsageError, match="exec"):
            choose(wrong)


def test_exec_in_doctor_takes_the_place_of_its_kind(agent: Agent) -> None:
    name = "exec:" + python("print('{\"power_w\": 12.5}')")
    code, out, _ = agent("doctor", "--json", "--source", name, "--sysfs-root", DATA / "no_battery_pi" / "sys")
    document = json.loads(out)
    assert code == 0
    rows = [row for row in document["sources"] if row["method"] == "exec"]
    assert len(rows) == 1
    assert rows[0]["power_w"] == 12.5
    assert document["chosen"] == "exec"


# --- hwmon -------------------------------------------------------------------------------------------------


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """A Jetson-like board: two rails on one monitor, a graphics card that tells an average, an energy counter."""
    chips = {
        "hwmon0": {"name": "ina3221", "power1_input": 4_200_000, "power1_label": "VDD_IN", "power2_input": 900_000},
        "hwmon1": {"name": "amdgpu", "power1_average": 7_000_000, "power1_cap": 15_000_000},
        "hwmon2": {"name": "board_energy", "energy1_input": 5_000_000},
        "hwmon3": {"name": "acpitz", "temp1_input": 40_000},
    }
    for chip, files in chips.items():
        folder = tmp_path / "class" / "hwmon" / chip
        folder.mkdir(parents=True)
        for name, value in files.items():
            (folder / name).write_text(f"{value}\n")
    return tmp_path


def test_a_sensor_is_named_with_what_it_covers(board: Path) -> None:
    choice = choose("hwmon:ina3221/VDD_IN=whole board", board)
    assert (choice.report.power_w, choice.source.scope, choice.source.primary) == (4.2, "whole board", "power")
    assert choice.source.read().power_w == pytest.approx(4.2)
    assert choose("hwmon:amdgpu", board).source.read().power_w == pytest.approx(7.0)
    assert choose("hwmon:ina3221/power2", board).source.scope == "sensor ina3221/power2"


def test_an_energy_sensor_counts(board: Path) -> None:
    source = choose("hwmon:board_energy/energy1", board).source
    file = board / "class/hwmon/hwmon2/energy1_input"
    readings = [source.read()]
    for value in (6_500_000, 1_000_000, 1_500_000):
        file.write_text(str(value))
        readings.append(source.read())
    assert source.primary == "counter"
    assert [reading.counter_j for reading in readings] == [0.0, 1.5, 0.0, 0.5]
    assert [reading.epoch for reading in readings] == [0, 0, 1, 1]


def test_no_sensor_is_taken_without_being_named(board: Path) -> None:
    report = Hwmon(Sysfs(board)).report()
    assert not report.available
    assert "ina3221/power1 (VDD_IN)" in report.reason
    assert report.remedy.startswith("say which and what it covers: --source 'hwmon:ina3221/power1=")
    assert choose("auto", board).source.method == "none"
    for name in ("hwmon:ina3221", "hwmon:nothing/power1"):
        with pytest.raises(SourceUnavailableError, match="is not one sensor; there are ina3221/power1"):
            choose(name, board)
    for name in ("hwmon:", "hwmon:=board", "hwmon:ina3221/power1="):
        with pytest.raises(UsageError, match="must be like"):
            choose(name, board)


@pytest.mark.parametrize(("content", "words"), [("", "is empty"), ("-5\n", "says -5e-06 W"), ("warm\n", "no number")])
def test_a_sensor_that_says_nonsense(board: Path, content: str, words: str) -> None:
    source = choose("hwmon:ina3221/power1", board).source
    (board / "class/hwmon/hwmon0/power1_input").write_text(content)
    assert words in (source.read().problem or "")


def test_a_sensor_that_fails_and_comes_back(board: Path) -> None:
    sysfs = FaultySysfs(board, {"class/hwmon/hwmon0/power1_input": EIO}, times=2)
    source = Hwmon(sysfs, "ina3221/power1")
    assert "injected" in (source.read().problem or "")
    assert source.read().power_w == pytest.approx(4.2)


# --- the estimate ------------------------------------------------------------------------------------------


def test_an_estimate_is_opt_in_and_says_what_it_is(tmp_path: Path) -> None:
    told_s = iter([100.0, 101.5])
    source = EstimateCpuTime((6.0, 10.0, 15.0), lambda: next(told_s))
    assert source.quality == "estimated"
    assert [source.read().counter_j, source.read().counter_j] == [0.0, 15.0]
    report = source.report()
    assert report.scale_range == (0.6, 1.5)
    assert "an estimate: 10 W per CPU second as stated, 6 to 15" in report.reason
    with pytest.raises(SourceUnavailableError, match="low,value,high"):
        choose("estimate_cpu_time", build_tree(tmp_path, {}))


@pytest.mark.parametrize("text", ["10", "10,6,15", "0,1,2", "6,10,inf", "nan,nan,nan", "a,b,c", "6,10,15,20"])
def test_an_estimate_needs_its_range(text: str) -> None:
    with pytest.raises(UsageError, match="low,value,high"):
        choose(f"estimate_cpu_time:{text}")


def test_an_estimates_interval_spans_its_stated_range(agent: Agent) -> None:
    """The statistical interval around the value, stretched by 6/10 below and 15/10 above."""
    # Something has to use the processor: an idle machine's estimate is below what its clock resolves.
    spin = "import time; end = time.monotonic() + 60\nwhile time.monotonic() < end: pass"
    with subprocess.Popen([sys.executable, "-c", spin]) as busy:
        try:
            code, out, err = agent("measure", "cornell", "--renderer", RENDERER, "--window-s", "0.3", "--min-windows",
                                   "3", "--max-windows", "3", "--source", "estimate_cpu_time:6,10,15",
                                   "--json")  # fmt: skip
        finally:
            busy.kill()
    document = json.loads(out)
    assert code == 0, err
    assert (document["method"], document["quality"]) == ("estimate_cpu_time", "estimated")
    gross = document["energy_j_per_image"]["gross"]
    assert gross["low"] <= 0.6 * gross["value"]
    assert gross["high"] >= 1.5 * gross["value"]
    assert "estimate" in err


def test_busy_seconds_are_those_that_this_process_uses() -> None:
    """Half a second of spinning shows, up to the 10 ms that the system counts in; idle time does not."""
    before_s, own_s = busy_cpu_s(), time.process_time()
    while time.process_time() - own_s < 0.5:
        pass
    assert busy_cpu_s() - before_s >= 0.4


def test_idle_waiting_and_guests_are_not_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    """12 + 1 + 5 + 0.5 + 0.5 s; a guest's 2 s are among user's 12, stolen ones were another machine's."""
    fields = {"user": 12.0, "nice": 1.0, "system": 5.0, "idle": 100.0, "iowait": 7.0, "irq": 0.5, "softirq": 0.5,
              "steal": 3.0, "guest": 2.0, "guest_nice": 0.0}  # fmt: skip
    times = namedtuple("scputimes", fields)(**fields)
    monkeypatch.setattr("psutil.cpu_times", lambda: times)
    assert busy_cpu_s() == pytest.approx(19.0)


# --- names -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["battery_gauge", "battery_gauge:linux", "battery_counter", "estimate_cpu_time:6,10,15", "replay@0.5", "none"],
)
def test_a_choice_can_be_made_again_from_its_name(name: str) -> None:
    root = DATA / "thinkpad_power_now" / "sys"
    choice = choose(name, root)
    again = choose(choice.name, root)
    assert choice.name == name
    assert (type(again.source), again.report) == (type(choice.source), choice.report)


def test_auto_names_what_it_chose() -> None:
    assert choose("auto", DATA / "acpi_unknown_rate" / "sys").name == "battery_counter"
    assert choose("auto", DATA / "no_battery_pi" / "sys").name == "none"


@pytest.mark.parametrize("name", ["solar", "battery_gauge:amiga", "battery_counter:windows", "rapl:0", "", "exec"])
def test_unknown_names_are_wrong_use(name: str) -> None:
    with pytest.raises(UsageError, match="known are auto, battery_gauge"):
        choose(name)


def test_sources_of_other_platforms_are_listed_as_such() -> None:
    rows = {report.method: report for _, report in survey(DATA / "thinkpad_power_now" / "sys")}
    for platform in ("windows", "macos", "android"):
        assert rows[f"battery_gauge:{platform}"].reason.startswith("not this platform")
        assert rows[f"battery_gauge:{platform}"].remedy == ""
    assert list(rows)[:3] == ["battery_gauge", "battery_counter", "rapl"]
    assert not rows["battery_gauge:windows"].this_platform


def test_a_gauge_that_has_not_refreshed_since_the_plug_was_out_is_waited_for(
    tree: Tree, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tree("thinkpad_power_now")
    rate = root / "class/power_supply/BAT0/power_now"
    told = rate.read_text()
    rate.write_text("0\n")
    waited: list[float] = []

    def sleep(seconds: float) -> None:
        waited.append(seconds)
        if len(waited) == 2:
            rate.write_text(told)

    monkeypatch.setattr("joulebox_agent.sources.choose.time.sleep", sleep)
    assert choose("auto", root).source.method == "battery_gauge"
    rate.write_text("0\n")
    waited[:] = [0.0] * 10
    assert choose("auto", root).source.method == "battery_counter"
