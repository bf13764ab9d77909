"""RAPL: which domains count, wraps, gaps, and the words for a counter only root may read."""

import errno
from pathlib import Path

import pytest
from agent_testing import FaultySysfs, ScriptedClock
from joulebox_agent.sources.rapl import Rapl
from joulebox_agent.sources.sysfs import Sysfs

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
