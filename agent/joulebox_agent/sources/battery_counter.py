"""Energy counted by the battery: differences of its energy, or charge steps times their voltage."""

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.sources.discharge import Discharge, counter_fault
from joulebox_agent.sources.packs import Battery
from joulebox_agent.sources.power_supply import PowerSupplyClass
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import Sysfs, remedy_for_error, sentence


class PackCounter:
    """The battery's own energy counter, for machines whose gauge does not tell a rate."""

    method = "battery_counter"
    scope = "whole machine"
    quality: Quality = "measured"
    primary: Primary = "counter"

    def __init__(self, battery: Battery, clock: Clock | None = None) -> None:
        self.battery = battery
        self.poll_s = battery.poll_s
        self._clock = clock or SystemClock()
        self._discharge = Discharge()

    def report(self) -> SourceReport:
        try:
            supplies = self.battery.read()
        except OSError as error:
            return self._report(False, sentence(error), remedy_for_error(error))
        refusal = supplies.refusal()
        if refusal:
            return self._report(False, refusal, supplies.remedy())
        fault = counter_fault(supplies.packs)
        if fault:
            return self._report(False, fault, "check the battery's driver (sudo dmesg)")
        if any(pack.discharging and pack.count() is None for pack in supplies.packs):
            reason = "a discharging pack has no energy_now, and no charge with a voltage"
            words = "; ".join([reason, *filter(None, [supplies.oddities()])])
            return self._report(False, words, supplies.remedy_for_values("use --source battery_percent"))
        return self._report(True, "energy over time only: a rate needs two looks (doctor --watch 60)", "")

    def _report(self, available: bool, reason: str, remedy: str) -> SourceReport:
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=available,
            resolution_j=self.battery.counter_step_j() if available else None,
            files=self.battery.origins(),
            reason=reason,
            remedy=remedy,
        )

    def read(self) -> Reading:
        epoch = self._discharge.epoch
        try:
            supplies = self.battery.read()
        except OSError as error:
            return Reading(epoch=epoch, problem=sentence(error))
        refusal = supplies.refusal()
        if refusal:
            return Reading(epoch=epoch, refusal=refusal)
        fault = counter_fault(supplies.packs)
        if fault:
            return Reading(epoch=epoch, problem=fault)
        self._discharge.update(supplies.packs, self._clock.now_s())
        used_j = self._discharge.used_j
        # The voltage moves without the counter: only the counter's own steps are updates here.
        raw = tuple(count[1] for pack in supplies.packs if (count := pack.count()) is not None)
        problem = "no pack tells its energy" if used_j is None else None
        return Reading(counter_j=used_j, epoch=self._discharge.epoch, raw=raw, problem=problem)


class BatteryCounter(PackCounter):
    """The counters of Linux' class/power_supply."""

    def __init__(self, sysfs: Sysfs, clock: Clock | None = None) -> None:
        super().__init__(PowerSupplyClass(sysfs), clock)
