"""RAPL: which domains count, wraps, gaps, and the words for a counter only root may read."""

import errno
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from agent_testing import RENDERER, FaultySysfs, ScriptedClock
from joulebox_agent.doctor import diagnose
from joulebox_agent.sources.choose import choose
from joulebox_agent.sources.rapl import Rapl
from joulebox_agent.sources.sysfs import Sysfs

Agent = Callable[..., tuple[int, str, str]]
RANGE_UJ = 262_143_328_850


def zone(root: Path, folder: str, name: str, energy_uj: int, range_uj: int = RANGE_UJ) -> Path:
    path = root / "class" / "powercap" / folder
    path.mkdir(parents=True)
    (path / "name").write_text(name + "\n")
    (path / "energy_uj").write_text(f"{energy_uj}\n")
    (path / "max_energy_range_uj").write_text(f"{range_uj}\n")
    return path


@pytest.fixture
def two_packages(tmp_path: Path) -> list[Path]:
    first = zone(tmp_path, "intel-rapl:0", "package-0", 1_000_000)
    second = zone(tmp_path, "intel-rapl:1", "package-1", 5_000_000)
    zone(tmp_path, "intel-rapl:0:0", "core", 900_000)
    zone(tmp_path, "intel-rapl-mmio:0", "package-0", 1_000_000)
    return [first, second]


def test_packages_are_summed_and_cores_are_not(tmp_path: Path, two_packages: list[Path]) -> None:
    clock = ScriptedClock()
    rapl = Rapl(Sysfs(tmp_path), clock)
    assert rapl.scope == "CPU package"
    assert rapl.read().counter_j == 0.0
    (two_packages[0] / "energy_uj").write_text("3500000")
    (two_packages[1] / "energy_uj").write_text("6000000")
    clock.time_s += 0.5
    assert rapl.read().counter_j == pytest.approx(3.5)


def test_psys_stands_alone(tmp_path: Path, two_packages: list[Path]) -> None:
    zone(tmp_path, "intel-rapl:2", "psys", 7_000_000)
    rapl = Rapl(Sysfs(tmp_path), ScriptedClock())
    assert rapl.scope == "whole platform"
    assert [domain.name for domain in rapl.domains] == ["psys"]


def test_one_wrap_is_undone(tmp_path: Path) -> None:
    folder = zone(tmp_path, "intel-rapl:0", "package-0", RANGE_UJ - 2_000_000)
    clock = ScriptedClock()
    rapl = Rapl(Sysfs(tmp_path), clock)
    rapl.read()
    (folder / "energy_uj").write_text("3000000")
    clock.time_s += 0.5
    reading = rapl.read()
    assert reading.counter_j == pytest.approx(5.0)
    assert reading.epoch == 0


def test_a_gap_that_may_hold_two_wraps_is_dropped(tmp_path: Path) -> None:
    folder = zone(tmp_path, "intel-rapl:0", "package-0", 0, range_uj=65_000_000)
    clock = ScriptedClock()
    rapl = Rapl(Sysfs(tmp_path), clock)
    assert rapl.poll_s < 65 / 1000 / 2  # well under half a wrap
    rapl.read()
    (folder / "energy_uj").write_text("1000000")
    clock.time_s += 60.0
    reading = rapl.read()
    assert reading.counter_j == 0.0
    assert reading.epoch == 1


def test_root_only_counters_come_with_the_exact_remedy(tmp_path: Path, two_packages: list[Path]) -> None:
    sysfs = FaultySysfs(tmp_path, {"class/powercap/intel-rapl:0/energy_uj": errno.EACCES})
    report = Rapl(sysfs).report()
    assert not report.available
    assert report.remedy == f"sudo chmod a+r {two_packages[0]}/energy_uj {two_packages[1]}/energy_uj"
    assert "injected" in (Rapl(sysfs).read().problem or "")


def test_absent_powercap_is_said(tmp_path: Path) -> None:
    report = Rapl(Sysfs(tmp_path)).report()
    assert not report.available
    assert "no package domain" in report.reason
    assert Rapl(Sysfs(tmp_path)).read().problem


def test_the_mmio_twin_stands_in_where_it_is_alone(tmp_path: Path) -> None:
    zone(tmp_path, "intel-rapl-mmio:0", "package-0", 1_000_000)
    assert [domain.name for domain in Rapl(Sysfs(tmp_path)).domains] == ["package-0"]


@pytest.mark.parametrize(("code", "stands"), [(None, ["package-0", "package-1"]), (errno.EACCES, ["psys"])])
def test_psys_that_never_counts_is_left_for_the_packages(
    tmp_path: Path, two_packages: list[Path], code: int | None, stands: list[str]
) -> None:
    """Firmware that does not wire it up leaves it at 0; where it is closed, nobody can tell."""
    zone(tmp_path, "intel-rapl:2", "psys", 0)
    faults = {} if code is None else {"class/powercap/intel-rapl:2/energy_uj": code}
    assert [domain.name for domain in Rapl(FaultySysfs(tmp_path, faults)).domains] == stands


def test_a_package_that_cannot_be_identified_is_not_left_out(tmp_path: Path, two_packages: list[Path]) -> None:
    sysfs = FaultySysfs(tmp_path, {"class/powercap/intel-rapl:1/name": errno.EIO})
    report = Rapl(sysfs).report()
    assert not report.available
    assert "intel-rapl:1/name: injected" in report.reason


@pytest.mark.parametrize(
    ("energy_uj", "words"), [(4_000_000, "ran backwards, by 1 J"), (900_000_000, "ran faster than any machine")]
)
def test_a_counter_that_runs_backwards_or_away_is_dropped(tmp_path: Path, energy_uj: int, words: str) -> None:
    """A step back of 1 J would be a wrap of 262 kJ in half a second, and a step of 895 J is 1790 W."""
    folder = zone(tmp_path, "intel-rapl:0", "package-0", 5_000_000)
    clock = ScriptedClock()
    rapl = Rapl(Sysfs(tmp_path), clock)
    rapl.read()
    clock.time_s += 0.5
    (folder / "energy_uj").write_text(f"{energy_uj}")
    void = rapl.read()
    assert words in (void.problem or "")
    clock.time_s += 0.5
    (folder / "energy_uj").write_text(f"{energy_uj + 2_000_000}")
    after = rapl.read()
    assert (after.counter_j, after.epoch, after.problem) == (pytest.approx(2.0), 1, None)


def test_one_package_may_wrap_while_the_other_counts_on(tmp_path: Path) -> None:
    first = zone(tmp_path, "intel-rapl:0", "package-0", 65_532_000_000 - 1_000_000, 65_532_000_000)
    second = zone(tmp_path, "intel-rapl:1", "package-1", 7_000_000, 65_532_000_000)
    clock = ScriptedClock()
    rapl = Rapl(Sysfs(tmp_path), clock)
    rapl.read()
    clock.time_s += 0.5
    (first / "energy_uj").write_text("3000000")
    (second / "energy_uj").write_text("9000000")
    assert rapl.read().counter_j == pytest.approx(4.0 + 2.0)


@contextmanager
def drawing(folder: Path, power_w: float, range_uj: int) -> Iterator[None]:
    """Lets a zone's counter run at `power_w` and wrap, as often as the machine lets us write."""
    ended = threading.Event()
    start_s = time.perf_counter()

    def count() -> None:
        while not ended.wait(0.004):
            used_uj = int((time.perf_counter() - start_s) * power_w * 1e6)
            (folder / "new").write_text(f"{used_uj % range_uj}\n")
            (folder / "new").replace(folder / "energy_uj")

    thread = threading.Thread(target=count)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_doctor_tells_the_power_of_a_counter_that_runs(tmp_path: Path) -> None:
    """40 W within a quarter: the look lasts 0.2 s, and the last write may be late by some ms at either end."""
    folder = zone(tmp_path, "intel-rapl:0", "package-0", 0)
    with drawing(folder, 40.0, RANGE_UJ):
        diagnosis = diagnose(tmp_path)
    rapl = next(report for report in diagnosis.sources if report.method == "rapl")
    assert rapl.available
    assert rapl.power_w == pytest.approx(40.0, rel=0.25)
    assert rapl.cpu_share is not None and rapl.cpu_share > 0
    assert diagnosis.chosen == "rapl"
    assert diagnosis.discharge_w is None  # the CPU's power is not the battery's


def test_doctor_gives_the_one_line_that_opens_the_counters(
    agent: Agent, tmp_path: Path, two_packages: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    close(monkeypatch)
    code, out, _ = agent("doctor", "--json", "--sysfs-root", tmp_path)
    rapl = next(row for row in json.loads(out)["sources"] if row["method"] == "rapl")
    assert code == 0
    assert (rapl["available"], rapl["reason"]) == (False, "energy_uj is readable by root only")
    assert rapl["remedy"] == f"sudo chmod a+r {two_packages[0]}/energy_uj {two_packages[1]}/energy_uj"
    code, out, err = agent("measure", "cornell", "--renderer", RENDERER, "--source", "rapl", "--sysfs-root", tmp_path)
    assert code == 1
    assert out == ""
    assert err.strip().endswith(f"readable by root only; {rapl['remedy']}.")
    assert len(err.strip().splitlines()) == 1


def close(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes the counters answer as they do to everybody but root, whoever runs the tests."""
    open_text = Sysfs.text

    def text(self: Sysfs, path: Path) -> str:
        if path.name == "energy_uj":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return open_text(self, path)

    monkeypatch.setattr(Sysfs, "text", text)


def test_measure_adds_up_a_counter_that_wraps(agent: Agent, tmp_path: Path) -> None:
    """400 W over a range of 600 J: a wrap every 1.5 s, at least one in 1.8 s of windows.

    A quarter is allowed: at the two outer edges the last write may be late by some 10 ms of 1800, more on a
    busy machine. A wrap that is not undone would cost 600 J of 720, one undone twice would add them.
    """
    folder = zone(tmp_path, "intel-rapl:0", "package-0", 0, 600_000_000)
    assert choose("rapl", tmp_path).source.poll_s <= 0.15  # a quarter of the time that 1000 W take to wrap it
    with drawing(folder, 400.0, 600_000_000):
        code, out, err = agent("measure", "cornell", "--renderer", RENDERER, "--source", "rapl", "--window-s", "0.6",
                               "--min-windows", "3", "--max-windows", "3", "--json",
                               "--sysfs-root", tmp_path)  # fmt: skip
    document = json.loads(out)
    assert code == 0, err
    assert (document["method"], document["quality"], document["scope"]) == ("rapl", "measured", "CPU package")
    joules = [window["energy_j"] for window in document["window_data"]]
    seconds = [window["time_s"] for window in document["window_data"]]
    assert None not in joules
    assert sum(joules) / sum(seconds) == pytest.approx(400.0, rel=0.25)
