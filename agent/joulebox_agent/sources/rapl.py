"""RAPL through powercap: energy of the CPU packages, or of the platform where `psys` exists.

Only package domains are summed (core lies inside package); psys covers them all and stands alone.
Counters wrap at `max_energy_range_uj`: one wrap is undone, an interval that may hold two is dropped.
Source: Documentation/power/powercap/powercap.rst.
"""

from dataclasses import dataclass
from pathlib import Path

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import Sysfs

MICRO = 1e-6
HIGHEST_POWER_W = 1000.0  # no package draws more; bounds how soon a counter can wrap


@dataclass(frozen=True)
class Domain:
    """One powercap zone: its folder, its name (package-0, psys) and the range of its counter [J]."""

    folder: Path
    name: str
    range_j: float

    @property
    def counter_file(self) -> Path:
        return self.folder / "energy_uj"


class Rapl:
    """The CPU's own energy counter."""

    method = "rapl"
    quality: Quality = "measured"
    primary: Primary = "counter"

    def __init__(self, sysfs: Sysfs, clock: Clock | None = None) -> None:
        self._sysfs = sysfs
        self._clock = clock or SystemClock()
        self.domains = find_domains(sysfs)
        shortest_j = min((domain.range_j for domain in self.domains), default=1e5)
        # well under half a wrap at the highest power, and fine enough to place window edges
        self.poll_s = min(0.5, shortest_j / HIGHEST_POWER_W / 4)
        self._last: tuple[float, list[float]] | None = None
        self._used_j, self._epoch = 0.0, 0

    @property
    def scope(self) -> str:
        return "whole platform" if any(domain.name == "psys" for domain in self.domains) else "CPU package"

    def report(self) -> SourceReport:
        files = [str(domain.counter_file) for domain in self.domains]
        if not files:
            reason = "no package domain in class/powercap (absent in most virtual machines)"
            return self._report(False, files, reason, "load the driver: sudo modprobe intel_rapl_msr")
        try:
            values = [self._sysfs.integer(domain.counter_file) for domain in self.domains]
        except PermissionError:
            remedy = f"sudo chmod a+r {' '.join(files)}"
            return self._report(False, files, "energy_uj is readable by root only", remedy)
        except OSError as error:
            return self._report(False, files, f"{error.filename}: {error.strerror}", "")
        if None in values:
            return self._report(False, files, "energy_uj holds no number", "")
        names = ", ".join(domain.name for domain in self.domains)
        return self._report(True, files, f"counter of {names}; not the whole machine", "")

    def _report(self, available: bool, files: list[str], reason: str, remedy: str) -> SourceReport:
        # the unit of the hardware counter is 2^-14 J on most CPUs; the file counts microjoules
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=available,
            files=tuple(files),
            resolution_j=2.0**-14 if available else None,
            reason=reason,
            remedy=remedy,
        )

    def read(self) -> Reading:
        try:
            values = [self._sysfs.integer(domain.counter_file) for domain in self.domains]
        except OSError as error:
            return Reading(epoch=self._epoch, problem=f"{error.filename}: {error.strerror}")
        now_s = self._clock.now_s()
        counts_j = [value * MICRO for value in values if value is not None]
        if len(counts_j) < len(self.domains) or not counts_j:
            return Reading(epoch=self._epoch, problem="energy_uj holds no number")
        self._advance(now_s, counts_j)
        self._last = (now_s, counts_j)
        return Reading(counter_j=self._used_j, epoch=self._epoch, raw=tuple(counts_j))

    def _advance(self, now_s: float, counts_j: list[float]) -> None:
        if self._last is None:
            return
        last_s, last_j = self._last
        shortest_j = min(domain.range_j for domain in self.domains)
        if (now_s - last_s) * HIGHEST_POWER_W >= shortest_j:
            self._epoch += 1  # may hold two wraps: dropped, not guessed
            return
        for domain, before_j, after_j in zip(self.domains, last_j, counts_j, strict=True):
            step_j = after_j - before_j
            self._used_j += step_j if step_j >= 0 else step_j + domain.range_j


def find_domains(sysfs: Sysfs) -> list[Domain]:
    """psys if it exists and counts, else every package-N. The mmio twin of a package is not counted again."""
    found: dict[str, Domain] = {}
    for folder in sysfs.children(sysfs.root / "class" / "powercap"):
        if not folder.name.startswith("intel-rapl:"):
            continue
        try:
            name = sysfs.value(folder / "name") or ""
            range_uj = sysfs.integer(folder / "max_energy_range_uj")
        except OSError:
            continue
        if range_uj and (name == "psys" or name.startswith("package-")):
            found.setdefault(name, Domain(folder, name, range_uj * MICRO))
    if "psys" in found:
        return [found["psys"]]
    return list(found.values())
