"""State of the machine that changes its power draw: read before and after, stored with the result."""

import os
from pathlib import Path

import psutil

from joulebox_agent.sources.estimate_cpu_time import busy_cpu_s
from joulebox_agent.sources.packs import JOULES_PER_WH
from joulebox_agent.sources.power_supply import MICRO, PowerSupplyClass
from joulebox_agent.sources.sysfs import SYSTEM_ROOT, Sysfs

Conditions = dict[str, str | float | int | bool | list[str] | None]


def read_conditions(sysfs_root: Path = SYSTEM_ROOT) -> Conditions:
    """Mains, charge, wear, brightness, profile, governor, temperature, throttling, network, load; None: unknown."""
    if not sysfs_root.is_dir():  # not Linux: psutil tells what it can, and nothing is invented
        return {**_by_psutil(), **_load()}
    sysfs = Sysfs(sysfs_root)
    cpu = sysfs_root / "devices" / "system" / "cpu"
    return {
        "brightness_share": _brightness(sysfs),
        "power_profile": _text(sysfs, sysfs_root / "firmware" / "acpi" / "platform_profile"),
        "governor": _text(sysfs, cpu / "cpu0" / "cpufreq" / "scaling_governor"),
        "energy_preference": _text(sysfs, cpu / "cpu0" / "cpufreq" / "energy_performance_preference"),
        "temperature_c": _hottest(sysfs),
        "throttle_count": _throttles(sysfs, cpu),
        **_network(sysfs),
        **_battery(sysfs),
        **_load(),
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


def _folders(sysfs: Sysfs, folder: Path) -> list[Path]:
    try:
        return sysfs.children(folder)
    except OSError:
        return []


def _brightness(sysfs: Sysfs) -> float | None:
    """Share of full of the first panel that tells it; 0 where the panel is switched off."""
    for panel in _folders(sysfs, sysfs.root / "class" / "backlight"):
        now, full = _number(sysfs, panel / "brightness"), _number(sysfs, panel / "max_brightness")
        if now is not None and full:
            return 0.0 if _number(sysfs, panel / "bl_power") else now / full
    return None


def _hottest(sysfs: Sysfs) -> float | None:
    zones = [_number(sysfs, zone / "temp") for zone in _folders(sysfs, sysfs.root / "class" / "thermal")]
    known = [milli_c / 1000 for milli_c in zones if milli_c is not None]
    return max(known) if known else None


def _throttles(sysfs: Sysfs, cpu: Path) -> int | None:
    counts = [
        _number(sysfs, core / "thermal_throttle" / name)
        for core in _folders(sysfs, cpu)
        if core.name[3:].isdigit()
        for name in ("core_throttle_count", "package_throttle_count")
    ]
    known = [count for count in counts if count is not None]
    return sum(known) if known else None


def _network(sysfs: Sysfs) -> Conditions:
    """Devices that are connected, and what all of them carried since the start: two looks tell what a radio did."""
    devices = [
        device for device in _folders(sysfs, sysfs.root / "class" / "net") if os.path.lexists(device / "device")
    ]  # bridges and the loopback have none, and would count twice
    carried = [_number(sysfs, device / "statistics" / f"{way}_bytes") for device in devices for way in ("rx", "tx")]
    known = [count for count in carried if count is not None]
    return {
        "network_up": [d.name for d in devices if _text(sysfs, d / "operstate") == "up"] if devices else None,
        "network_bytes": sum(known) if known else None,
    }


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
    percent = total("capacity")
    cycles = [_number(sysfs, folder / "cycle_count") for folder in folders]
    try:
        supplies = packs.read()
        cables, status = list(supplies.cables_online), [pack.status or "no status" for pack in supplies.packs]
    except OSError:
        cables, status = None, []
    charge_share = now / full if now is not None and full else None
    if charge_share is None and percent is not None:
        charge_share = percent / 100 / len(folders)
    return {
        "mains_online": None if cables is None or not (cables or status) else bool(cables),
        "cables_online": cables,
        "battery_status": status,
        "battery_charge_share": charge_share,
        "battery_health_share": full / design if full is not None and design else None,
        "battery_full_j": capacity_j,
        "battery_cycle_count": max((count for count in cycles if count is not None), default=None),
    }


def _by_psutil() -> Conditions:
    """Charge, plug and network where the system has no files for them."""
    tell = getattr(psutil, "sensors_battery", None)
    try:
        battery = tell() if tell else None
    except (OSError, RuntimeError, ValueError, NotImplementedError):
        battery = None
    try:
        carried = psutil.net_io_counters()
    except (OSError, RuntimeError, ValueError):
        carried = None
    return {
        "mains_online": None if battery is None else battery.power_plugged,
        "battery_charge_share": None if battery is None else battery.percent / 100,
        "network_bytes": None if carried is None else carried.bytes_sent + carried.bytes_recv,
    }


def _load() -> Conditions:
    """The run queue, and CPU seconds since the machine started: all there were, used ones, used ones of the agent
    and the programs that it ran to their end. Two looks tell how busy others were in between."""
    try:
        load = os.getloadavg()[0]
    except (AttributeError, OSError):
        load = None
    own = os.times()
    try:
        machine_s, busy_s = float(sum(psutil.cpu_times())), busy_cpu_s()
    except (OSError, RuntimeError, ValueError):  # /proc may be closed to us, as on phones
        machine_s, busy_s = None, None
    return {
        "load_1_min": load,
        "cpu_machine_s": machine_s,
        "cpu_busy_s": busy_s,
        "cpu_own_s": own.user + own.system + own.children_user + own.children_system,
    }


def other_cpu_share(before: Conditions, after: Conditions, rendering_cpu_s: float = 0.0) -> float | None:
    """CPU that processes other than ours used between two looks, in cores (0.5: half of one); None if unknown.

    rendering_cpu_s  CPU seconds of our programs that have not ended yet [s]
    """

    def spent(name: str) -> float | None:
        first, last = before.get(name), after.get(name)
        return last - first if isinstance(first, int | float) and isinstance(last, int | float) else None

    machine_s, busy_s, own_s = (spent(name) for name in ("cpu_machine_s", "cpu_busy_s", "cpu_own_s"))
    if machine_s is None or busy_s is None or own_s is None or machine_s <= 0:
        return None
    return max(0.0, busy_s - own_s - rendering_cpu_s) / machine_s * (os.cpu_count() or 1)


def throttled(before: Conditions, after: Conditions) -> str | None:
    """A reason to void when the CPU was throttled between the two, else None."""
    first, last = before.get("throttle_count"), after.get("throttle_count")
    if isinstance(first, int) and isinstance(last, int) and last > first:
        return f"the CPU was throttled {last - first} times by its temperature"
    return None
