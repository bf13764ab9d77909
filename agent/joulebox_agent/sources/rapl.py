"""RAPL through powercap: energy of the CPU packages, or of the platform where `psys` exists.

Only package domains are summed (core lies inside package); psys covers them all and stands alone.
Counters wrap at `max_energy_range_uj`: one wrap is undone, an interval that may hold two is dropped.
Source: Documentation/power/powercap/powercap.rst.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import PERMISSION_ERRNOS, Sysfs, remedy_for_error, sentence

MICRO = 1e-6
ZONE = re.compile(r"intel-rapl(-mmio)?:\d+")  # two ways to one counter; AMD's comes under the first as well
HIGHEST_POWER_W = 1000.0  # no package draws more; bounds how soon a counter can wrap
READ_LATE_J = 1.0  # what may have been used between the counter's own update and our look at the clock


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
        self._unlisted: OSError | None = None
        try:
            self.domains = find_domains(sysfs)
        except OSError as error:
            self.domains, self._unlisted = [], error
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
        if self._unlisted is not None:
            return self._report(False, files, sentence(self._unlisted), remedy_for_error(self._unlisted))
        if not files:
            reason = "no package domain in class/powercap (absent in most virtual machines)"
            return self._report(False, files, reason, "load the driver: sudo modprobe intel_rapl_msr")
        try:
            values = [self._sysfs.integer(domain.counter_file) for domain in self.domains]
        except OSError as error:
            if error.errno in PERMISSION_ERRNOS:
                remedy = f"sudo chmod a+r {' '.join(files)}"
                return self._report(False, files, "energy_uj is readable by root only", remedy)
            return self._report(False, files, sentence(error), "")
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
            return Reading(epoch=self._epoch, problem=sentence(error))
        now_s = self._clock.now_s()
        counts_j = [value * MICRO for value in values if value is not None]
        if len(counts_j) < len(self.domains) or not counts_j:
            return Reading(epoch=self._epoch, problem="energy_uj holds no number")
        problem = self._advance(now_s, counts_j)
        self._last = (now_s, counts_j)
        if problem:
            self._epoch += 1  # dropped, not guessed
        return Reading(counter_j=self._used_j, epoch=self._epoch, raw=tuple(counts_j), problem=problem)

    def _advance(self, now_s: float, counts_j: list[float]) -> str | None:
        """Adds the interval since the last look; says why it cannot be told what was used in it, or None.

        A step back is a wrap where the rest of the range could have been used in the time, else nonsense.
        """
        if self._last is None:
            return None
        last_s, last_j = self._last
        most_j = (now_s - last_s) * HIGHEST_POWER_W + READ_LATE_J
        if most_j >= min(domain.range_j for domain in self.domains):
            return f"no look for {now_s - last_s:.1f} s: the counter may have wrapped twice"
        steps_j = [after - before for before, after in zip(last_j, counts_j, strict=True)]
        used_j = [s if s >= 0 else s + domain.range_j for s, domain in zip(steps_j, self.domains, strict=True)]
        for step_j, amount_j, domain in zip(steps_j, used_j, self.domains, strict=True):
            if amount_j > most_j:
                how = "ran backwards" if step_j < 0 else "ran faster than any machine"
                return f"{domain.counter_file} {how}, by {abs(step_j):.3g} J in {now_s - last_s:.2f} s"
        self._used_j += sum(used_j)
        return None


def find_domains(sysfs: Sysfs) -> list[Domain]:
    """psys if it exists and counts, else every package-N. The mmio twin of a package is not counted again.

    Raises OSError where a package may hide behind a file that cannot be read.
    """
    found: dict[str, Domain] = {}
    folders = sysfs.children(sysfs.root / "class" / "powercap")
    for folder in sorted(folders, key=lambda folder: ("mmio" in folder.name, folder.name)):
        if not ZONE.fullmatch(folder.name):
            continue
        name = sysfs.value(folder / "name") or ""
        range_uj = sysfs.integer(folder / "max_energy_range_uj")
        if range_uj and (name == "psys" or name.startswith("package-")):
            found.setdefault(name, Domain(folder, name, range_uj * MICRO))
    psys = found.pop("psys", None)
    return [psys] if psys is not None and _counts(psys, sysfs) else list(found.values())


def _counts(psys: Domain, sysfs: Sysfs) -> bool:
    """Firmware that does not wire psys up leaves it at 0; whether it counts cannot be told without permission."""
    try:
        return bool(sysfs.integer(psys.counter_file))
    except OSError as error:
        return error.errno in PERMISSION_ERRNOS
