"""Packs and cables of class/power_supply: which are the machine's own, and does it run on its battery now.

Names tell nothing (BAT1 without BAT0, macsmc-battery, sbs-0-000b), so everything goes by type and scope.
Kernel units (uW, uA, uV, uWh, uAh) are converted here and nowhere else.
Source: Documentation/ABI/testing/sysfs-class-power.
"""

import math
from dataclasses import dataclass
from pathlib import Path

from joulebox_agent.sources.sysfs import Sysfs

MICRO = 1e-6
JOULES_PER_WH = 3600.0
CABLE_TYPES = ("Mains", "USB", "BrickID", "Wireless")


@dataclass(frozen=True)
class Pack:
    """One system battery as read at one moment; None where the kernel does not know.

    raw  the integers behind the values, in the kernel's units, to notice an update
    """

    name: str
    status: str
    power_w: float | None
    current_a: float | None
    voltage_v: float | None
    energy_wh: float | None
    charge_ah: float | None
    raw: tuple[int, ...]

    @property
    def discharging(self) -> bool:
        return self.status == "Discharging"

    def drawn_w(self) -> float | None:
        """Power leaving this pack [W]: `power_now`, else current x voltage, never both; magnitudes.

        Kernels disagree on the sign, so the direction comes from `status` alone. A pack that neither
        discharges nor hides its state (Unknown) gives nothing; an idle pack without a value counts as 0.
        """
        if self.status not in ("Discharging", "Unknown"):
            return 0.0
        if self.power_w is not None:
            return abs(self.power_w)
        if self.current_a is not None and self.voltage_v is not None:
            return abs(self.current_a * self.voltage_v)
        return None if self.discharging else 0.0


@dataclass(frozen=True)
class Supplies:
    """The machine's packs and the cables that are live."""

    packs: tuple[Pack, ...]
    cables_online: tuple[str, ...]

    def refusal(self) -> str | None:
        """Why the battery cannot be measured now, or None. Only a discharge without any cable counts."""
        if not self.packs:
            return "no system battery"
        if self.cables_online:
            return f"mains power online ({', '.join(self.cables_online)})"
        charging = [pack.name for pack in self.packs if pack.status == "Charging"]
        if charging:
            return f"{charging[0]} is charging"
        if not any(pack.discharging for pack in self.packs):
            states = ", ".join(f"{pack.name} is {pack.status or 'without a status'}" for pack in self.packs)
            return f"no pack is discharging ({states})"
        return None


class PowerSupplyClass:
    """Finds packs and cables, and reads their values as often as asked; a changed list is noticed."""

    def __init__(self, sysfs: Sysfs) -> None:
        self.sysfs = sysfs
        self.folder = sysfs.root / "class" / "power_supply"
        self._names: list[str] | None = None
        self._packs: list[Path] = []
        self._cables: list[Path] = []

    def pack_folders(self) -> list[Path]:
        """Folders of the system's packs: type Battery, not scope Device, present.

        Empty where a file fails that tells what is a pack; `read` says which.
        """
        try:
            self._find()
        except OSError:
            return []
        return self._packs

    def read(self) -> Supplies:
        """Packs and live cables now. Raises OSError (EIO) when a file fails twice."""
        self._find()
        packs = [self._pack(folder) for folder in self._packs]
        online = [cable.name for cable in self._cables if self.sysfs.integer(cable / "online")]
        return Supplies(tuple(_one_gauge_a_cell(packs)), tuple(online))

    def _find(self) -> None:
        names = [child.name for child in self.sysfs.children(self.folder)]
        if names == self._names:
            return
        packs, cables = [], []
        for folder in (self.folder / name for name in names):
            kind = self.sysfs.value(folder / "type") or ""
            if self.sysfs.value(folder / "scope") == "Device":
                continue
            if kind == "Battery" and self.sysfs.integer(folder / "present") != 0:
                packs.append(folder)
            elif kind.startswith(CABLE_TYPES):
                cables.append(folder)
        self._names, self._packs, self._cables = names, packs, cables  # all or nothing: a cable must not get lost

    def _pack(self, folder: Path) -> Pack:
        power_uw = self.sysfs.integer(folder / "power_now")
        current_ua = self.sysfs.integer(folder / "current_now")
        voltage_uv = self.sysfs.integer(folder / "voltage_now")
        energy_uwh = self.sysfs.integer(folder / "energy_now")
        charge_uah = self.sysfs.integer(folder / "charge_now")
        if charge_uah is None:  # Android's name for the same
            charge_uah = self.sysfs.integer(folder / "charge_counter")
        values = (power_uw, current_ua, voltage_uv, energy_uwh, charge_uah)
        return Pack(
            name=folder.name,
            status=self.sysfs.value(folder / "status") or "",
            power_w=_base_unit(power_uw),
            current_a=_base_unit(current_ua),
            voltage_v=_base_unit(voltage_uv),
            energy_wh=_base_unit(energy_uwh),
            charge_ah=_base_unit(charge_uah),
            raw=tuple(value for value in values if value is not None),
        )

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

    def _step_j(self, folder: Path) -> float | None:
        def common_step(quantity: str) -> int:
            names = (f"{quantity}_now", f"{quantity}_full", f"{quantity}_full_design")
            return math.gcd(*(abs(self.sysfs.integer(folder / name) or 0) for name in names))

        if self.sysfs.integer(folder / "energy_now") is not None:
            return common_step("energy") * MICRO * JOULES_PER_WH or None
        voltage_uv = self.sysfs.integer(folder / "voltage_now")
        if voltage_uv is None:
            return None
        return common_step("charge") * MICRO * voltage_uv * MICRO * JOULES_PER_WH or None


def _base_unit(micro: int | None) -> float | None:
    return None if micro is None else micro * MICRO


def _one_gauge_a_cell(packs: list[Pack]) -> list[Pack]:
    """Drops a second gauge of the same cell: equal voltage and equal non-zero current to the microvolt."""
    seen: set[tuple[float, float]] = set()
    kept = []
    for pack in packs:
        if pack.voltage_v and pack.current_a:
            key = (pack.voltage_v, abs(pack.current_a))
            if key in seen:
                continue
            seen.add(key)
        kept.append(pack)
    return kept
