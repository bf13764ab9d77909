"""From the text of `--source` to a source, and the order in which `auto` tries them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from joulebox_agent.errors import SourceUnavailableError, UsageError
from joulebox_agent.sources.battery_counter import BatteryCounter
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.none import NoSource
from joulebox_agent.sources.power_supply import PowerSupplyClass
from joulebox_agent.sources.rapl import Rapl
from joulebox_agent.sources.reading import EnergySource, SourceReport
from joulebox_agent.sources.replay import Replay, bundled_trace, read_trace
from joulebox_agent.sources.sysfs import Sysfs

# Best first. Sources of other platforms join this table.
SOURCES: dict[str, Callable[[Sysfs], EnergySource]] = {
    "battery_gauge": BatteryGauge,
    "battery_counter": BatteryCounter,
    "rapl": Rapl,
}
KNOWN = ("auto", *SOURCES, "replay[:FILE][@REFRESH_S]", "none")


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


def choose(name: str, sysfs_root: Path = Path("/sys")) -> Choice:
    """The source called `name`, ready to read.

    auto is the best source that can be read at this moment, else none. A named source that cannot be
    read raises SourceUnavailableError with its remedy; an unknown name raises UsageError.
    """
    if name == "none":
        source: EnergySource = NoSource()
        return Choice(source, source.report(), name=name)
    if name == "replay" or name.startswith(("replay:", "replay@")):
        source = parse_replay(name)
        return Choice(source, source.report(), name=name)
    sysfs = Sysfs(sysfs_root)
    if name == "auto":
        return _best(sysfs)
    if name not in SOURCES:
        raise UsageError(f"There is no energy source {name!r}; known are {', '.join(KNOWN)}.")
    source = SOURCES[name](sysfs)
    report = source.report()
    if not report.available:
        raise SourceUnavailableError(_sentence(report))
    return Choice(source, report, name=name)


def _best(sysfs: Sysfs) -> Choice:
    declined: list[SourceReport] = []
    for name, make in SOURCES.items():
        source = make(sysfs)
        report = source.report()
        if report.available:
            return Choice(source, report, tuple(declined), name)
        declined.append(report)
    nothing = NoSource()
    return Choice(nothing, nothing.report(), tuple(declined), "none")


def unfit_reason(name: str, sysfs_root: Path = Path("/sys")) -> str | None:
    """Why measuring has to wait, or None.

    With auto, a machine that has a battery waits for a discharge instead of quietly measuring less.
    """
    if name in ("auto", "battery_gauge", "battery_counter"):
        try:
            supplies = PowerSupplyClass(Sysfs(sysfs_root)).read()
        except OSError as error:
            return f"{error.filename}: {error.strerror}"
        if name == "auto" and not supplies.packs:
            return None
        return supplies.refusal()
    return None


def parse_replay(name: str) -> Replay:
    """`replay`, `replay:FILE`, either with `@SECONDS` for a gauge that refreshes that often."""
    body, at, refresh = name.removeprefix("replay").rpartition("@")
    if not at:
        body, refresh = refresh, ""
    try:
        refresh_s = float(refresh) if refresh else None
    except ValueError:
        raise UsageError(f"The refresh in {name!r} must be seconds, as in replay@0.5.") from None
    file = body.removeprefix(":")
    return Replay(read_trace(Path(file)) if file else bundled_trace(), refresh_s)


def reports(sysfs_root: Path) -> list[SourceReport]:
    """What every source says about itself on this machine, best first, replay last."""
    sysfs = Sysfs(sysfs_root)
    return [*(make(sysfs).report() for make in SOURCES.values()), Replay(bundled_trace()).report()]


def _sentence(report: SourceReport) -> str:
    remedy = f"; {report.remedy}" if report.remedy else ""
    return f"The energy source {report.method} cannot be read: {report.reason}{remedy}."
