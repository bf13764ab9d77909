"""Whether two gauges look at one cell: phones register a fuel gauge and a charger's view of it side by side.

Names and types tell nothing, so their readings decide, with the tolerance that two converters need which look at
different moments. Whoever tells watts or watt-hours (ACPI) is a pack of its own; fuel gauges tell amperes.
"""

from dataclasses import dataclass

from joulebox_agent.sources.packs import Pack

SAME_VOLTAGE, SAME_CURRENT, SAME_FULL_CHARGE = 0.01, 0.10, 0.15  # shares
SAME_CAPACITY_PERCENT = 5


@dataclass(frozen=True)
class Label:
    """What tells two packs apart: percent of charge, full charge [uAh], serial number; None where not told."""

    capacity_percent: int | None
    charge_full_uah: int | None
    serial: str | None


def may_be_one_cell(one: Pack, other: Pack) -> bool:
    """By voltage and current alone: equal voltage, and equal currents or a gauge that tells none.

    A current of 0 is a pack that waits for its turn, not a second look at the one that works.
    """
    if {"power_now", "energy_now"} & {*one.micro, *other.micro}:
        return False
    voltages = [pack.micro.get("voltage_now", 0) for pack in (one, other)]
    if 0 in voltages or not _near(voltages[0], voltages[1], SAME_VOLTAGE):
        return False
    if rateless(one) or rateless(other):
        return True
    currents = [pack.micro["current_now"] for pack in (one, other)]
    return 0 not in currents and _near(currents[0], currents[1], SAME_CURRENT)


def one_cell(one: Pack, label: Label, other: Pack, other_label: Label) -> bool:
    """Whether two packs that may be one cell are: nothing on their labels says otherwise.

    Where one tells no current, their percentages have to agree: the voltage alone is too little.
    """
    percents = [p for p in (label.capacity_percent, other_label.capacity_percent) if p is not None]
    if len(percents) == 2 and abs(percents[0] - percents[1]) > SAME_CAPACITY_PERCENT:
        return False
    if len(percents) < 2 and (rateless(one) or rateless(other)):
        return False
    full = (label.charge_full_uah, other_label.charge_full_uah)
    if full[0] and full[1] and not _near(full[0], full[1], SAME_FULL_CHARGE):
        return False
    return len({label.serial, other_label.serial} - {None, "", "0"}) < 2


def rateless(pack: Pack) -> bool:
    """Tells no current."""
    return "current_now" not in pack.micro


def _near(one: int, other: int, share: float) -> bool:
    return abs(abs(one) - abs(other)) <= share * max(abs(one), abs(other))
