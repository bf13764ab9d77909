"""A machine's battery packs at one moment, whoever told of them: pure rules, no files, no calls.

What counts as a measurement is decided here and nowhere else: a discharge, without any cable.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

JOULES_PER_WH = 3600.0
LOWEST_W, HIGHEST_W = 0.05, 1000.0  # no machine that renders draws less or more from its packs
LOWEST_V, HIGHEST_V = 1.0, 100.0
# What firmware says for "unknown" and a driver hands on, in a reader's micro units: all bits of 16 or 32 set, as
# they are or taken for milli units (Linux' ACPI battery multiplies by 1000).
UNKNOWN_MICRO = {bits * unit for bits in (0xFFFFFFFF, 0x80000000, 0x7FFFFFFF) for unit in (1, 1000)}
UNKNOWN_RATE_MICRO = {*UNKNOWN_MICRO, 0xFFFF * 1000}  # a counter may well stand at 65.535 Wh, a rate hardly ever

Micro = Mapping[str, int]


@dataclass(frozen=True)
class Pack:
    """One system battery as read at one moment.

    status  Discharging, Charging, Full, Not charging, Unknown; "" when nothing tells
    micro   what was told, by the kernel's names in its micro units: power_now, current_now, power_avg,
            current_avg, voltage_now, energy_now, charge_now
    faults  names that answered with a fault (EIO) and what the fault was: they void what needs them
    odd     names that hold nonsense, and what: they count as not told
    closed  files that only another user may read; they count as not told
    """

    name: str
    status: str
    micro: Micro = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)
    odd: Mapping[str, str] = field(default_factory=dict)
    closed: tuple[str, ...] = ()

    @property
    def discharging(self) -> bool:
        return self.status == "Discharging"

    @property
    def raw(self) -> tuple[int, ...]:
        """The numbers behind the values: a changed tuple is an update."""
        return tuple(self.micro.values())

    @property
    def voltage_v(self) -> float | None:
        return self._base("voltage_now")

    @property
    def energy_wh(self) -> float | None:
        return self._base("energy_now")

    @property
    def charge_ah(self) -> float | None:
        return self._base("charge_now")

    def _base(self, name: str) -> float | None:
        return self.micro[name] * 1e-6 if name in self.micro else None

    def drawn_w(self) -> float | None:
        """Power leaving this pack [W], or None. Raises PackFaultError when a file that tells it failed.

        `power_now`, else current x voltage, else the averages that some gauges give instead; never two of
        them added. Magnitudes: kernels disagree on the sign, so the direction comes from `status` alone. A
        value below what a machine draws (0 before the first refresh, milliwatts in place of microwatts)
        stands only where no other way tells more. A pack that neither discharges nor hides its state
        (Unknown, none) gives nothing; an idle one without a value counts as 0.
        """
        if self.status not in ("Discharging", "Unknown", ""):
            return 0.0
        lowest_w = None if self.discharging else 0.0
        for names in (("power_now",), ("current_now", "voltage_now"), ("power_avg",), ("current_avg", "voltage_now")):
            failed = [self.faults[name] for name in names if name in self.faults]
            if failed:
                raise PackFaultError(failed[0])
            if not all(name in self.micro for name in names):
                continue
            power_w = 1.0
            for name in names:
                power_w *= abs(self.micro[name]) * 1e-6
            if LOWEST_W <= power_w <= HIGHEST_W:
                return power_w
            if power_w < LOWEST_W:
                lowest_w = lowest_w or power_w
        return lowest_w

    def count(self) -> tuple[str, float] | None:
        """("energy", Wh) or ("charge", Ah, only where a voltage turns it into energy), or None."""
        if self.energy_wh is not None:
            return ("energy", self.energy_wh)
        if self.charge_ah is not None and self.voltage_v is not None:
            return ("charge", self.charge_ah)
        return None


class PackFaultError(Exception):
    """A value was there and could not be read this time; the text names file and fault."""


@dataclass(frozen=True)
class Supplies:
    """The machine's packs and the cables that are live. `notes`: what a reader should know of the list."""

    packs: tuple[Pack, ...]
    cables_online: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def refusal(self) -> str | None:
        """Why the battery cannot be measured now, or None. Only a discharge without any cable counts."""
        if not self.packs:
            return "; ".join(["no system battery", *self.notes])
        if self.cables_online:
            return f"mains power online ({', '.join(self.cables_online)})"
        charging = [pack.name for pack in self.packs if pack.status == "Charging"]
        if charging:
            return f"{charging[0]} is charging"
        if not any(pack.discharging for pack in self.packs):
            states = ", ".join(f"{pack.name} is {pack.status or 'without a status'}" for pack in self.packs)
            return f"no pack is discharging ({states})"
        return None

    def remedy(self) -> str:
        """What the user can do about a refusal."""
        if not self.packs:
            return "measure on a machine with a battery, or use --source exec:COMMAND, hwmon, rapl, replay or none"
        if self.cables_online:
            return "pull the power cable out"
        return "let the battery discharge (unplug; lift the charge threshold)"

    def remedy_for_values(self, otherwise: str) -> str:
        """What the user can do where the packs discharge and do not tell enough."""
        closed = [file for pack in self.packs for file in pack.closed]
        return f"sudo chmod a+r {' '.join(closed)}" if closed else otherwise

    def total_w(self) -> float | None:
        """Power of all packs [W]; None when a discharging pack does not tell its own. Raises PackFaultError."""
        drawn = [pack.drawn_w() for pack in self.packs]
        known = [power_w for power_w in drawn if power_w is not None]
        return sum(known) if len(known) == len(drawn) else None

    def oddities(self) -> str:
        """What the packs' values hold that is no value, in words, or ""."""
        return "; ".join(words for pack in self.packs for words in pack.odd.values())


class Battery(Protocol):
    """What tells of a machine's packs: one for each platform.

    platform  linux, windows, macos, android
    poll_s    a modest polling interval [s], well under the refresh of its gauge
    """

    platform: str
    poll_s: float

    def read(self) -> Supplies:
        """Packs and live cables now. Raises OSError, whose text says what failed."""

    def origins(self) -> tuple[str, ...]:
        """Files or calls that the values come from."""

    def counter_step_j(self) -> float | None:
        """The step that the energy counter seems to move in [J]; None without a counter. Raises OSError."""

    def full_wh(self) -> float | None:
        """Energy of a full charge of the one pack there is [Wh]; None when it is not told, or of several packs.
        Raises OSError."""


def plausible(name: str, micro: int) -> str | None:
    """Why a value in micro units is none, or None.

    Only what no machine can mean is refused here: a driver's words for unknown, and other units than it
    should have. (A voltage in millivolts would make a charge counter 1000 times too cheap.)
    """
    counter = name.startswith(("energy", "charge"))
    if abs(micro) in (UNKNOWN_MICRO if counter else UNKNOWN_RATE_MICRO):
        return f"{micro} stands for unknown"
    if name.startswith("power") and abs(micro) > HIGHEST_W * 1e6:
        return f"{micro * 1e-6:.3g} W, which no machine draws"
    if name.startswith("voltage") and not LOWEST_V <= micro * 1e-6 <= HIGHEST_V:
        return f"{micro * 1e-6:.3g} V, which no pack has"
    if counter and micro < 0 and name != "charge_counter":
        return f"{micro}, and a counter is not negative"
    return None
