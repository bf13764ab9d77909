"""The battery gauge of Linux: power leaving all system packs, whole machine.

`power_now`, else `current_now` x `voltage_now` (never the design voltage), summed over packs. The counter
of the same packs is read along to cross-check it.
"""

from joulebox_agent.sources.battery_counter import Discharge, remedy_for
from joulebox_agent.sources.power_supply import PowerSupplyClass, Supplies
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import Sysfs

NO_RATE = "the discharging pack tells no rate: no power_now, and not both of current_now and voltage_now"
ZERO_RATE = "the gauge says 0 W while discharging"
PLAUSIBLE_W = (0.01, 1000.0)  # no machine that renders draws less or more from its packs


class BatteryGauge:
    """Rate of discharge as the fuel gauge gives it; refreshed by the hardware every 1 to 30 s."""

    method = "battery_gauge"
    scope = "whole machine"
    quality: Quality = "measured"
    primary: Primary = "power"
    poll_s = 0.5

    def __init__(self, sysfs: Sysfs) -> None:
        self._class = PowerSupplyClass(sysfs)
        self._discharge = Discharge()

    def report(self) -> SourceReport:
        try:
            supplies = self._class.read()
        except OSError as error:
            return self._report(None, f"{error.filename}: {error.strerror}", "check the battery's driver (dmesg)")
        refusal = supplies.refusal()
        if refusal:
            return self._report(None, refusal, remedy_for(supplies))
        power_w = total_w(supplies)
        problem = rate_problem(power_w)
        if problem:
            remedy = "wait for the gauge's first refresh" if problem == ZERO_RATE else "use --source battery_counter"
            return self._report(None, problem, remedy)
        names = ", ".join(pack.name for pack in supplies.packs if pack.discharging)
        return self._report(power_w, f"{names} discharging, no cable online", "")

    def _report(self, power_w: float | None, reason: str, remedy: str) -> SourceReport:
        files = [
            str(folder / name)
            for folder in self._class.pack_folders()
            for name in ("power_now", "current_now", "voltage_now", "status")
            if (folder / name).exists()
        ]
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=power_w is not None,
            power_w=power_w,
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
        power_w = total_w(supplies)
        problem = rate_problem(power_w)
        return Reading(
            power_w=None if problem else power_w,
            counter_j=self._discharge.used_j,
            epoch=self._discharge.epoch,
            raw=tuple(value for pack in supplies.packs for value in pack.raw),
            problem=problem,
        )


def rate_problem(power_w: float | None) -> str | None:
    """Why a sum of packs [W] is no reading, or None."""
    if power_w is None:
        return NO_RATE
    if power_w == 0.0:
        return ZERO_RATE
    lowest_w, highest_w = PLAUSIBLE_W
    if not lowest_w <= power_w <= highest_w:
        return f"the gauge says {power_w:.3g} W, which no machine draws; its driver's units are wrong"
    return None


def total_w(supplies: Supplies) -> float | None:
    """Power of all packs [W]; None when a discharging pack does not tell its own."""
    drawn = [pack.drawn_w() for pack in supplies.packs]
    known = [power_w for power_w in drawn if power_w is not None]
    return sum(known) if len(known) == len(drawn) else None
