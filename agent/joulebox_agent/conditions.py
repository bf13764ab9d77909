"""State of the machine that changes its power draw: read before and after, stored with the result."""

import os
from pathlib import Path

from joulebox_agent.sources.power_supply import JOULES_PER_WH, MICRO, PowerSupplyClass
from joulebox_agent.sources.sysfs import Sysfs

Conditions = dict[str, str | float | int | bool | list[str] | None]


def read_conditions(sysfs_root: Path = Path("/sys")) -> Conditions:
    """Brightness, profile, governor, temperature, throttling, charge, wear, load; None where unknown."""
    if not sysfs_root.is_dir():  # not Linux: nothing is known, and nothing is invented
        return {"load_1_min": _load()}
    sysfs = Sysfs(sysfs_root)
    cpu = sysfs_root / "devices" / "system" / "cpu"
    return {
        "brightness_share": _brightness(sysfs),
        "power_profile": _text(sysfs, sysfs_root / "firmware" / "acpi" / "platform_profile"),
        "governor": _text(sysfs, cpu / "cpu0" / "cpufreq" / "scaling_governor"),
        "energy_preference": _text(sysfs, cpu / "cpu0" / "cpufreq" / "energy_performance_preference"),
        "temperature_c": _hottest(sysfs),
        "throttle_count": _throttles(sysfs, cpu),
        **_battery(sysfs),
        "load_1_min": _load(),
    }


def _text(sysfs: Sysfs, path: Path) -> str | None:
    try:
        return sysfs.value(path)
    except OSError:
        return None


def _number(sysfs: Sysfs, path: Path) -> int | None:
    try:
        return sysfs.integer(path)
    except OSError:
        return None


def _brightness(sysfs: Sysfs) -> float | None:
    for panel in sysfs.children(sysfs.root / "class" / "backlight"):
        now, full = _number(sysfs, panel / "brightness"), _number(sysfs, panel / "max_brightness")
        if now is not None and full:
            return now / full
    return None


def _hottest(sysfs: Sysfs) -> float | None:
    zones = [_number(sysfs, zone / "temp") for zone in sysfs.children(sysfs.root / "class" / "thermal")]
    known = [milli_c / 1000 for milli_c in zones if milli_c is not None]
    return max(known) if known else None


def _throttles(sysfs: Sysfs, cpu: Path) -> int | None:
    counts = [
        _number(sysfs, core / "thermal_throttle" / name)
        for core in sysfs.children(cpu)
        if core.name[3:].isdigit()
        for name in ("core_throttle_count", "package_throttle_count")
    ]
    known = [count for count in counts if count is not None]
    return sum(known) if known else None


def _battery(sysfs: Sysfs) -> Conditions:
    packs = PowerSupplyClass(sysfs)
    folders = packs.pack_folders()

    def total(name: str) -> float | None:
        values = [_number(sysfs, folder / name) for folder in folders]
        return sum(v for v in values if v is not None) if folders and None not in values else None

    now, full, design = (total(f"energy_{part}") for part in ("now", "full", "full_design"))
    capacity_j = None if full is None else full * MICRO * JOULES_PER_WH
    if now is None:
        now, full, design = (total(f"charge_{part}") for part in ("now", "full", "full_design"))
    cycles = [_number(sysfs, folder / "cycle_count") for folder in folders]
    try:
        cables = list(packs.read().cables_online)
    except OSError:
        cables = []
    return {
        "battery_charge_share": now / full if now is not None and full else None,
        "battery_health_share": full / design if full is not None and design else None,
        "battery_full_j": capacity_j,
        "battery_cycle_count": max((count for count in cycles if count is not None), default=None),
        "cables_online": cables,
    }


def _load() -> float | None:
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return None


def throttled(before: Conditions, after: Conditions) -> str | None:
    """A reason to void when the CPU was throttled between the two, else None."""
    first, last = before.get("throttle_count"), after.get("throttle_count")
    if isinstance(first, int) and isinstance(last, int) and last > first:
        return f"the CPU was throttled {last - first} times by its temperature"
    return None
