"""From the text of `--source` to a source, and the order in which `auto` tries them.

`choose(name, sysfs_root)` is the one way to a source; another process rebuilds the same one from `Choice.name`.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from joulebox_agent.errors import SourceUnavailableError, UsageError
from joulebox_agent.sources.battery_counter import PackCounter
from joulebox_agent.sources.battery_gauge import ZERO_RATE, PackGauge
from joulebox_agent.sources.battery_percent import ask_psutil, parse_percent, refuse_other_tree
from joulebox_agent.sources.estimate_cpu_time import parse_estimate
from joulebox_agent.sources.exec_command import PREFIX as EXEC
from joulebox_agent.sources.exec_command import ExecCommand
from joulebox_agent.sources.hwmon import parse_hwmon
from joulebox_agent.sources.mac_battery import MacBattery
from joulebox_agent.sources.none import NoSource
from joulebox_agent.sources.packs import Battery
from joulebox_agent.sources.power_supply import PowerSupplyClass
from joulebox_agent.sources.rapl import Rapl
from joulebox_agent.sources.reading import EnergySource, SourceReport
from joulebox_agent.sources.replay import Replay, bundled_trace, read_trace
from joulebox_agent.sources.sysfs import SYSTEM_ROOT, Sysfs, sentence
from joulebox_agent.sources.termux_battery import TermuxBattery, on_android
from joulebox_agent.sources.windows_battery import WindowsBattery

BATTERIES: dict[str, Callable[[Sysfs], Battery]] = {
    "linux": PowerSupplyClass,
    "windows": lambda sysfs: WindowsBattery(),
    "macos": lambda sysfs: MacBattery(),
    "android": lambda sysfs: TermuxBattery(),
}
GAUGE, COUNTER, PERCENT = "battery_gauge", "battery_counter", "battery_percent"
KNOWN = ("auto", GAUGE, "battery_gauge:android", COUNTER, "rapl", "exec:COMMAND", "hwmon:CHIP/SENSOR=WHAT IT COVERS",
         "battery_percent[:WH]", "estimate_cpu_time:LOW,VALUE,HIGH", "replay[:FILE][@REFRESH_S]", "none")  # fmt: skip
FIRST_REFRESH_S = 3.0  # how long a gauge that says 0 W is waited for: it may not have refreshed since the plug was out


@dataclass(frozen=True)
class Choice:
    """A source and what it says about itself.

    name      what makes the same source again: choose(name, sysfs_root)
    declined  why better ones were passed over
    """

    source: EnergySource
    report: SourceReport
    declined: tuple[SourceReport, ...] = ()
    name: str = ""


def platform_here(sysfs_root: Path) -> str:
    """The platform whose battery is read; a tree that plays /sys is Linux wherever it lies."""
    if sysfs_root != SYSTEM_ROOT:
        return "linux"
    return {"win32": "windows", "cygwin": "windows", "darwin": "macos"}.get(sys.platform, "linux")


def own_battery(sysfs_root: Path) -> Battery:
    """What tells of this platform's packs."""
    return BATTERIES[platform_here(sysfs_root)](Sysfs(sysfs_root))


def auto_names(sysfs_root: Path) -> tuple[str, ...]:
    """What auto tries, best first."""
    if sysfs_root != SYSTEM_ROOT:
        return (GAUGE, COUNTER, "rapl")
    phone = (f"{GAUGE}:android",) if on_android() else ()
    return (GAUGE, *phone, COUNTER, "rapl", PERCENT)


def make_source(name: str, sysfs_root: Path) -> EnergySource:
    """The source called `name`, whether it can be read or not. Raises UsageError for an unknown name."""
    sysfs = Sysfs(sysfs_root)
    kind, _, rest = name.partition(":")
    if kind == GAUGE and (not rest or rest in BATTERIES):
        return PackGauge(BATTERIES[rest](sysfs) if rest else own_battery(sysfs_root))
    if name == COUNTER:
        return PackCounter(own_battery(sysfs_root))
    if name == "rapl":
        return Rapl(sysfs)
    if kind == "hwmon":
        return parse_hwmon(name, sysfs)
    if kind == PERCENT:
        ask = ask_psutil if sysfs_root == SYSTEM_ROOT else refuse_other_tree
        return parse_percent(name, own_battery(sysfs_root), ask)
    if name.startswith(EXEC):
        return ExecCommand(name.removeprefix(EXEC))
    if kind == "estimate_cpu_time":
        return parse_estimate(name)
    if name == "replay" or name.startswith(("replay:", "replay@")):
        return parse_replay(name)
    if name == "none":
        return NoSource()
    raise UsageError(f"There is no energy source {name!r}; known are {', '.join(KNOWN)}.")


def choose(name: str, sysfs_root: Path = SYSTEM_ROOT) -> Choice:
    """The source called `name`, ready to read.

    auto is the best source that can be read at this moment, else none. A named source that cannot be
    read raises SourceUnavailableError with its remedy; an unknown name raises UsageError.
    """
    if name == "auto":
        return _best(sysfs_root)
    source = make_source(name, sysfs_root)
    report = _settled(source)
    if not report.available:
        raise SourceUnavailableError(_sentence(report))
    return Choice(source, report, name=name)


def _best(sysfs_root: Path) -> Choice:
    declined: list[SourceReport] = []
    for name in auto_names(sysfs_root):
        source = make_source(name, sysfs_root)
        report = _settled(source)
        if report.available:
            return Choice(source, report, tuple(declined), name)
        declined.append(report)
    nothing = NoSource()
    return Choice(nothing, nothing.report(), tuple(declined), "none")


def _settled(source: EnergySource) -> SourceReport:
    """The source's report, when a gauge has had the time for its first refresh."""
    waited_s = 0.0
    while (report := source.report()).reason == ZERO_RATE and waited_s < FIRST_REFRESH_S:
        time.sleep(source.poll_s)
        waited_s += source.poll_s
    return report


def unfit_reason(name: str, sysfs_root: Path = SYSTEM_ROOT) -> str | None:
    """Why measuring has to wait, or None.

    With auto, a machine that has a battery waits for a discharge instead of quietly measuring less.
    """
    if name != "auto" and name.partition(":")[0] not in (GAUGE, COUNTER):
        return None
    battery = own_battery(sysfs_root) if ":" not in name else BATTERIES[name.partition(":")[2]](Sysfs(sysfs_root))
    try:
        supplies = battery.read()
    except OSError as error:
        return sentence(error)
    if name == "auto" and not supplies.packs:
        return None
    return supplies.refusal()


def parse_replay(name: str) -> Replay:
    """`replay`, `replay:FILE`, either with `@SECONDS` for a gauge that refreshes that often."""
    whole = name.removeprefix("replay")
    body, at, refresh = whole.rpartition("@")
    if not at or Path(whole.removeprefix(":")).is_file():  # a folder or a file may have an @ in its name
        body, refresh = whole, ""
    try:
        refresh_s = float(refresh) if refresh else None
    except ValueError:
        raise UsageError(f"The refresh in {name!r} must be seconds, as in replay@0.5.") from None
    file = body.removeprefix(":")
    return Replay(read_trace(Path(file)) if file else bundled_trace(), refresh_s)


def _sentence(report: SourceReport) -> str:
    remedy = f"; {report.remedy}" if report.remedy else ""
    return f"The energy source {report.method} cannot be read: {report.reason}{remedy}."
