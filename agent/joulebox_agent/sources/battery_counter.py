"""Energy counted by the battery: differences of `energy_now`, or charge steps times their voltage.

Never the difference of charge x voltage: 50 mV of sag would add 850 J to a true 571 J.
"""

from joulebox_agent.sources.power_supply import JOULES_PER_WH, Pack, PowerSupplyClass, Supplies
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import Sysfs


class Discharge:
    """Turns successive looks at the packs into joules used since the first look.

    used_j  None until a counter was seen
    epoch   grows when the set of counting packs changes, or a counter rises (a charge, or nonsense)
    """

    def __init__(self) -> None:
        self.used_j: float | None = None
        self.epoch = 0
        self._last: dict[str, tuple[str, float]] = {}
        self._voltages: dict[str, list[float]] = {}

    def update(self, packs: tuple[Pack, ...]) -> None:
        """Adds what was used since the previous look."""
        counts = {pack.name: count for pack in packs if (count := _count(pack)) is not None}
        if not counts:
            self.used_j, self._last = None, {}
            return
        if {name: kind for name, (kind, _) in counts.items()} != {n: k for n, (k, _) in self._last.items()}:
            self.epoch += 1 if self._last else 0
            self._last, self._voltages = counts, {}
        self.used_j = self.used_j or 0.0
        for pack in packs:
            if pack.name in counts:
                self._add(pack, counts[pack.name])
        self._last = counts

    def _add(self, pack: Pack, count: tuple[str, float]) -> None:
        kind, now = count
        step = self._last[pack.name][1] - now
        voltages = self._voltages.setdefault(pack.name, [])
        if pack.voltage_v is not None:
            voltages.append(pack.voltage_v)
        if step == 0.0:
            return
        if step < 0.0:
            self.epoch += 1
        else:
            wh = step if kind == "energy" else step * sum(voltages) / len(voltages)
            self.used_j = (self.used_j or 0.0) + wh * JOULES_PER_WH
        self._voltages[pack.name] = voltages[-1:]


def _count(pack: Pack) -> tuple[str, float] | None:
    """("energy", Wh) or ("charge", Ah, only where a voltage turns it into energy), or None."""
    if pack.energy_wh is not None:
        return ("energy", pack.energy_wh)
    if pack.charge_ah is not None and pack.voltage_v is not None:
        return ("charge", pack.charge_ah)
    return None


class BatteryCounter:
    """The battery's own energy counter, for machines whose gauge does not tell a rate."""

    method = "battery_counter"
    scope = "whole machine"
    quality: Quality = "measured"
    primary: Primary = "counter"
    poll_s = 0.5

    def __init__(self, sysfs: Sysfs) -> None:
        self._class = PowerSupplyClass(sysfs)
        self._discharge = Discharge()

    def report(self) -> SourceReport:
        try:
            supplies = self._class.read()
        except OSError as error:
            return self._report(False, f"{error.filename}: {error.strerror}", "check the battery's driver (dmesg)")
        refusal = supplies.refusal()
        if refusal:
            return self._report(False, refusal, remedy_for(supplies))
        if any(pack.discharging and _count(pack) is None for pack in supplies.packs):
            return self._report(False, "a discharging pack has no energy_now, and no charge with a voltage", "")
        return self._report(True, "energy over time only: a rate needs two looks (doctor --watch 60)", "")

    def _report(self, available: bool, reason: str, remedy: str) -> SourceReport:
        files = [
            str(folder / name)
            for folder in self._class.pack_folders()
            for name in ("energy_now", "charge_now", "charge_counter", "voltage_now", "status")
            if (folder / name).exists()
        ]
        step_j = self._class.counter_step_j() if available else None
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=available,
            resolution_j=step_j,
            files=tuple(files),
            reason=reason,
            remedy=remedy,
        )

    def read(self) -> Reading:
        try:
            supplies = self._class.read()
        except OSError as error:
            return Reading(epoch=self._discharge.epoch, problem=f"{error.filename}: {error.strerror}")
        refusal = supplies.refusal()
        if refusal:
            return Reading(epoch=self._discharge.epoch, refusal=refusal)
        self._discharge.update(supplies.packs)
        used_j = self._discharge.used_j
        # The voltage moves without the counter: only the counter's own steps are updates here.
        raw = tuple(count[1] for pack in supplies.packs if (count := _count(pack)) is not None)
        problem = "no pack tells its energy" if used_j is None else None
        return Reading(counter_j=used_j, epoch=self._discharge.epoch, raw=raw, problem=problem)


def remedy_for(supplies: Supplies) -> str:
    """What the user can do about a refusal."""
    if not supplies.packs:
        return "measure on a machine with a battery, or use --source rapl, replay or none"
    if supplies.cables_online:
        return "pull the power cable out"
    return "let the battery discharge (unplug; lift the charge threshold)"
