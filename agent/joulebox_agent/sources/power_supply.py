"""Linux' class/power_supply: which nodes are the machine's own packs and cables, and what they say now.

Names tell nothing (BAT1 without BAT0, macsmc-battery, sbs-0-000b), so everything goes by type and scope.
Source: Documentation/ABI/testing/sysfs-class-power.
"""

import errno
import math
import os
from pathlib import Path

from joulebox_agent.sources.one_cell import Label, may_be_one_cell, one_cell, rateless
from joulebox_agent.sources.packs import JOULES_PER_WH, Pack, Supplies, plausible
from joulebox_agent.sources.sysfs import PERMISSION_ERRNOS, UNUSABLE_ERRNOS, Sysfs, sentence

MICRO = 1e-6
# Neither a pack nor a cable: gauges and chargers beside a phone's battery, and a UPS, which may feed a monitor too.
GAUGE_TYPES = ("bms", "main", "parallel")
UPS = "ups"
RATES = ("power_now", "current_now", "power_avg", "current_avg", "voltage_now")
COUNTERS = ("energy_now", "charge_now")
ANDROIDS_CHARGE = "charge_counter"


class PowerSupplyClass:
    """Finds packs and cables, and reads their values as often as asked; a changed list is noticed."""

    platform = "linux"
    poll_s = 0.5

    def __init__(self, sysfs: Sysfs) -> None:
        self.sysfs = sysfs
        self.folder = sysfs.root / "class" / "power_supply"
        self._names: list[str] | None = None
        self._packs: list[Path] = []
        self._cables: list[Path] = []
        self._ups: list[str] = []
        self._silent: list[str] = []
        self._twins: dict[str, str] = {}
        self._origins: dict[str, None] = {}
        self._files: dict[tuple[Path, str], Path] = {}

    def pack_folders(self) -> list[Path]:
        """Folders of the system's packs: type Battery, not scope Device, present.

        Empty where a file fails that tells what is a pack; `read` says which.
        """
        try:
            self._find()
            return self._present()
        except OSError:
            return []

    def origins(self) -> tuple[str, ...]:
        """The files that gave a value so far."""
        return tuple(self._origins)

    def read(self) -> Supplies:
        """Packs and live cables now. Raises OSError (EIO) when a file that decides on them fails twice."""
        self._find()
        packs = [self._pack(folder) for folder in self._present()]
        online = [cable.name for cable in self._cables if self.sysfs.integer(self._file(cable, "online"))]
        notes = [f"{name} is a UPS, which may feed more than this machine" for name in self._ups]
        notes += [f"{name} has no file of power or energy: a peripheral or a second gauge" for name in self._silent]
        self._notice_twins(packs)
        notes += [f"{one} is a second gauge of {other}'s cell, counted once" for one, other in self._twins.items()]
        if not packs and self.sysfs.lacks_classes():
            notes.append(f"{self.sysfs.root} has no folder class/, as the root of a sysfs has")
        return Supplies(tuple(pack for pack in packs if pack.name not in self._twins), tuple(online), tuple(notes))

    def _find(self) -> None:
        names = [child.name for child in self.sysfs.children(self.folder)]
        if names == self._names:
            return
        packs, cables, ups = [], [], []
        for folder in (self.folder / name for name in names):
            kind = _word(self.sysfs.value(folder / "type"))
            if not kind or kind in GAUGE_TYPES or _word(self.sysfs.value(folder / "scope")) == "device":
                continue
            if kind == "battery":
                packs.append(folder)
            elif kind == UPS:
                ups.append(folder.name)
            else:  # whatever else feeds a machine; phones rename a cable's type as it is plugged in
                cables.append(folder)
        talking = [folder for folder in packs if _tells_energy(folder)]
        self._silent = [folder.name for folder in packs if talking and folder not in talking]
        packs = talking or packs
        self._packs, self._cables, self._ups = packs, cables, ups  # all or nothing: a cable must not get lost
        self._names, self._twins = names, {}

    def _present(self) -> list[Path]:
        """A bay keeps its folder when the pack is pulled out; only `present` tells."""
        return [folder for folder in self._packs if self.sysfs.integer(self._file(folder, "present")) != 0]

    def _pack(self, folder: Path) -> Pack:
        micro: dict[str, int] = {}
        faults: dict[str, str] = {}
        odd: dict[str, str] = {}
        closed: list[str] = []
        files = {name: name for name in (*RATES, *COUNTERS)}
        for file, name in (*files.items(), (ANDROIDS_CHARGE, "charge_now")):
            if name in micro:
                continue
            try:
                value = self.sysfs.integer(self._file(folder, file))
            except OSError as error:
                (odd if error.errno in UNUSABLE_ERRNOS else faults)[name] = sentence(error)
                closed += [str(self._file(folder, file))] if error.errno in PERMISSION_ERRNOS else []
                continue
            if value is None:
                continue
            if nonsense := plausible(file, value):
                odd[name] = f"{folder / file} says {nonsense}"
            else:
                micro[name] = value
                self._origins[str(self._file(folder, file))] = None
        status = self.sysfs.value(self._file(folder, "status"))
        if status is None and not folder.exists():
            raise OSError(errno.ENODEV, "the pack was pulled out while it was read", str(folder))
        self._origins[str(self._file(folder, "status"))] = None
        return Pack(folder.name, (status or "").capitalize(), micro, faults, odd, tuple(closed))

    def _file(self, folder: Path, name: str) -> Path:
        """A file of a node that is read at every poll: joining paths anew would take longer than reading them."""
        key = (folder, name)
        if key not in self._files:
            self._files[key] = folder / name
        return self._files[key]

    def _notice_twins(self, packs: list[Pack]) -> None:
        """Finds second gauges of one cell. Once found they stay found: the readings of two gauges part for
        moments, and the power must not double with it."""
        for i, one in enumerate(packs):
            for other in packs[i + 1 :]:
                if {one.name, other.name} & set(self._twins) or not may_be_one_cell(one, other):
                    continue
                if one_cell(one, self._label(one), other, self._label(other)):
                    less, more = (one, other) if rateless(one) and not rateless(other) else (other, one)
                    self._twins[less.name] = more.name

    def _label(self, pack: Pack) -> Label:
        def static(name: str) -> int | None:
            try:
                return self.sysfs.integer(self.folder / pack.name / name)
            except OSError:
                return None

        try:
            serial = self.sysfs.value(self.folder / pack.name / "serial_number")
        except OSError:
            serial = None
        return Label(static("capacity"), static("charge_full"), serial)

    def counter_step_j(self) -> float | None:
        """The step the packs' counters seem to move in [J]: what all their known values are multiples of.

        A guess from one look, good enough to say what cannot be resolved; None without a counter, or where
        a file fails.
        """
        try:
            steps = [self._step_j(folder) for folder in self.pack_folders()]
        except OSError:
            return None
        known = [step for step in steps if step]
        return max(known) if known else None

    def full_wh(self) -> float | None:
        """Energy of a full charge of the only pack [Wh]; None when it is not told, or of several packs."""
        folders = self.pack_folders()
        if len(folders) != 1:
            return None
        folder = folders[0]
        energy_uwh = self.sysfs.integer(folder / "energy_full")
        if energy_uwh:
            return energy_uwh * MICRO
        charge_uah, voltage_uv = (self.sysfs.integer(folder / name) for name in ("charge_full", "voltage_now"))
        return charge_uah * MICRO * voltage_uv * MICRO if charge_uah and voltage_uv else None

    def _step_j(self, folder: Path) -> float | None:
        def common_step(quantity: str) -> int:
            names = (f"{quantity}_now", f"{quantity}_counter", f"{quantity}_full", f"{quantity}_full_design")
            return math.gcd(*(abs(self.sysfs.integer(folder / name) or 0) for name in names))

        if self.sysfs.integer(folder / "energy_now") is not None:
            return common_step("energy") * MICRO * JOULES_PER_WH or None
        voltage_uv = self.sysfs.integer(folder / "voltage_now")
        if voltage_uv is None:
            return None
        return common_step("charge") * MICRO * voltage_uv * MICRO * JOULES_PER_WH or None


def _word(content: str | None) -> str:
    """A driver's word in small letters, as those outside the kernel write them in letters of their own."""
    return (content or "").casefold()


def _tells_energy(folder: Path) -> bool:
    """Whether the driver has any file of power or energy, readable now or not: a mouse without a scope has none."""
    names = ("power_now", "current_now", "power_avg", "current_avg", *COUNTERS, ANDROIDS_CHARGE)
    return any(os.path.lexists(folder / name) for name in names)
