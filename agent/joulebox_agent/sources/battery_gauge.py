"""A battery's gauge: power leaving all system packs, whole machine.

The rate that the packs tell, summed; the energy counter of the same packs is read along to cross-check it.
"""

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.sources.discharge import Discharge, counter_fault
from joulebox_agent.sources.packs import HIGHEST_W, LOWEST_W, Battery, PackFaultError, Supplies
from joulebox_agent.sources.power_supply import PowerSupplyClass
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import Sysfs, remedy_for_error, sentence

NO_RATE = "the discharging pack tells no rate: no power_now, and not both of current_now and voltage_now"
ZERO_RATE = "the gauge says 0 W while discharging"


class PackGauge:
    """Rate of discharge as a battery's fuel gauge gives it; refreshed by the hardware every 1 to 30 s."""

    method = "battery_gauge"
    scope = "whole machine"
    quality: Quality = "measured"
    primary: Primary = "power"

    def __init__(self, battery: Battery, clock: Clock | None = None) -> None:
        self.battery = battery
        self.poll_s = battery.poll_s
        self._clock = clock or SystemClock()
        self._discharge = Discharge()
        self._names: tuple[str, ...] | None = None

    def report(self) -> SourceReport:
        try:
            supplies = self.battery.read()
            refusal = supplies.refusal()
            if refusal:
                return self._report(None, refusal, supplies.remedy())
            power_w = supplies.total_w()
        except OSError as error:
            return self._report(None, sentence(error), remedy_for_error(error))
        except PackFaultError as fault:
            return self._report(None, str(fault), "check the battery's driver (sudo dmesg)")
        problem = rate_problem(power_w, supplies)
        if problem:
            wait = "wait for the gauge's first refresh"
            remedy = wait if power_w == 0.0 else supplies.remedy_for_values("use --source battery_counter")
            return self._report(None, problem, remedy)
        names = ", ".join(pack.name for pack in supplies.packs if pack.discharging)
        words = [f"{names} discharging, no cable online", *supplies.notes]
        return self._report(power_w, "; ".join([*words, *filter(None, [supplies.oddities()])]), "")

    def _report(self, power_w: float | None, reason: str, remedy: str) -> SourceReport:
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=power_w is not None,
            power_w=power_w,
            files=self.battery.origins(),
            reason=reason,
            remedy=remedy,
        )

    def read(self) -> Reading:
        epoch = self._discharge.epoch
        try:
            supplies = self.battery.read()
            refusal = supplies.refusal()
            if refusal:
                return Reading(epoch=epoch, refusal=refusal)
            power_w = supplies.total_w()
        except OSError as error:
            return Reading(epoch=epoch, problem=sentence(error))
        except PackFaultError as fault:
            return Reading(epoch=epoch, problem=str(fault))
        counted = counter_fault(supplies.packs) is None
        if counted:
            self._discharge.update(supplies.packs, self._clock.now_s())
        problem = self._changed(supplies) or rate_problem(power_w, supplies)
        return Reading(
            power_w=None if problem else power_w,
            counter_j=self._discharge.used_j if counted else None,
            epoch=self._discharge.epoch,
            raw=tuple(value for pack in supplies.packs for value in pack.raw),
            problem=problem,
        )

    def _changed(self, supplies: Supplies) -> str | None:
        """A pack that came or went voids the one sample in which it is noticed: half of it may be old."""
        before, self._names = self._names, tuple(pack.name for pack in supplies.packs)
        if before is None or before == self._names:
            return None
        return f"the packs changed from {', '.join(before)} to {', '.join(self._names)}"


class BatteryGauge(PackGauge):
    """The gauges of Linux' class/power_supply."""

    def __init__(self, sysfs: Sysfs, clock: Clock | None = None) -> None:
        super().__init__(PowerSupplyClass(sysfs), clock)


def rate_problem(power_w: float | None, supplies: Supplies) -> str | None:
    """Why a sum of packs [W] is no reading, or None."""
    if power_w is None:
        return "; ".join([NO_RATE, *filter(None, [supplies.oddities()])])
    if power_w == 0.0:
        return ZERO_RATE
    if not LOWEST_W <= power_w <= HIGHEST_W:
        return f"the gauge says {power_w:.3g} W, which no machine draws; its driver's units are wrong"
    return None
