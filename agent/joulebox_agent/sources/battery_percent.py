"""The battery's percentage times what a full charge holds: the last resort of every platform.

A step of 1 % is hundreds of joules (1,728 J of 48 Wh), so it says something only over windows of many steps.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import psutil

from joulebox_agent.errors import UsageError
from joulebox_agent.sources.packs import JOULES_PER_WH, Battery
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import remedy_for_error, sentence

NO_CAPACITY = "what a full charge holds is not known"


class Charge(NamedTuple):
    """percent 0..100; plugged None when nothing tells."""

    percent: float
    plugged: bool | None


def ask_psutil() -> Charge | None:
    """The percentage of the system's battery, None without one. Raises OSError."""
    tell = getattr(psutil, "sensors_battery", None)  # psutil has it where the platform has it
    try:
        battery = tell() if tell else None
    except (RuntimeError, ValueError, NotImplementedError) as error:  # a battery that psutil cannot make sense of
        raise OSError(None, f"psutil cannot read it: {error}", "sensors_battery") from error
    return None if battery is None else Charge(float(battery.percent), battery.power_plugged)


def refuse_other_tree() -> Charge | None:
    """Stands in for psutil where another tree plays /sys: psutil would tell of this machine."""
    raise OSError(None, "psutil tells of this machine, and --sysfs-root of another", "sensors_battery")


class BatteryPercent:
    """Energy from the battery's percentage.

    battery      tells what a full charge holds
    capacity_wh  replaces what the battery tells of it
    ask          gives the percentage; raises OSError
    """

    method = "battery_percent"
    scope = "whole machine"
    quality: Quality = "measured"
    primary: Primary = "counter"
    poll_s = 2.0

    def __init__(
        self, battery: Battery, capacity_wh: float | None = None, ask: Callable[[], Charge | None] = ask_psutil
    ) -> None:
        self._battery, self._ask = battery, ask
        self._given_wh = capacity_wh
        self._full_wh = capacity_wh
        self._used_j, self._epoch = 0.0, 0
        self._last_percent: float | None = None

    def report(self) -> SourceReport:
        try:
            charge, full_wh = self._look()
        except OSError as error:
            return self._report(None, sentence(error), remedy_for_error(error))
        refusal = _refusal(charge)
        if refusal:
            remedy = "pull the power cable out" if charge else "measure on a machine with a battery"
            return self._report(None, refusal, remedy)
        if full_wh is None:
            return self._report(None, NO_CAPACITY, "name the watt-hours: --source battery_percent:48")
        return self._report(full_wh, f"steps of 1 % of {full_wh:.3g} Wh: for windows of many steps only", "")

    def _report(self, full_wh: float | None, reason: str, remedy: str) -> SourceReport:
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=full_wh is not None,
            resolution_j=None if full_wh is None else full_wh * JOULES_PER_WH / 100,
            files=("psutil.sensors_battery()",),
            reason=reason,
            remedy=remedy,
        )

    def _look(self) -> tuple[Charge | None, float | None]:
        charge = self._ask()
        if self._full_wh is None and charge is not None:
            self._full_wh = self._battery.full_wh()
        return charge, self._full_wh

    def read(self) -> Reading:
        try:
            charge, full_wh = self._look()
        except OSError as error:
            return Reading(epoch=self._epoch, problem=sentence(error))
        refusal = _refusal(charge)
        if refusal or charge is None:
            return Reading(epoch=self._epoch, refusal=refusal)
        if full_wh is None:
            return Reading(epoch=self._epoch, problem=NO_CAPACITY)
        fell = 0.0 if self._last_percent is None else self._last_percent - charge.percent
        self._last_percent = charge.percent
        if fell < 0.0:
            self._epoch += 1
        else:
            self._used_j += fell / 100 * full_wh * JOULES_PER_WH
        return Reading(counter_j=self._used_j, epoch=self._epoch, raw=(charge.percent,))


def _refusal(charge: Charge | None) -> str | None:
    if charge is None:
        return "no system battery"
    if charge.plugged:
        return "mains power online"
    if charge.plugged is None:
        return "nothing tells whether mains power is online"
    if not 0.0 <= charge.percent <= 100.0:
        return f"the percentage is {charge.percent:g}"
    return None


def parse_percent(name: str, battery: Battery, ask: Callable[[], Charge | None] = ask_psutil) -> BatteryPercent:
    """`battery_percent`, or `battery_percent:WH` with what a full charge holds. Raises UsageError."""
    text = name.removeprefix("battery_percent").removeprefix(":")
    if not text:
        return BatteryPercent(battery, ask=ask)
    try:
        capacity_wh = float(text)
    except ValueError:
        capacity_wh = math.nan
    if not 0.1 <= capacity_wh <= 10_000:
        raise UsageError(f"The capacity in {name!r} must be watt-hours from 0.1 to 10000, as in battery_percent:48.")
    return BatteryPercent(battery, capacity_wh, ask)
