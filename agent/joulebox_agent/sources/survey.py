"""Every source there is, and what each says of itself on this machine: the rows of `doctor`."""

from pathlib import Path

from joulebox_agent.sources.choose import BATTERIES, GAUGE, auto_names, make_source, platform_here
from joulebox_agent.sources.reading import EnergySource, SourceReport

# What a user has to name before it can be read, and what the name looks like.
TO_BE_NAMED = {"exec": '--source \'exec:COMMAND\', a command that prints {"power_w": 12.3} or {"energy_j": 456.7}'}
TITLES = {"linux": "Linux", "windows": "Windows", "macos": "macOS", "android": "Android with Termux:API"}
Row = tuple[EnergySource | None, SourceReport]


def survey(sysfs_root: Path, asked: str = "auto") -> list[Row]:
    """Sources with their reports: this platform's first, best first; those of other platforms last.

    asked  a source by its full name (exec:COMMAND), which then stands in its kind's place
    No two reports have the same method: a gauge of another platform is called battery_gauge:PLATFORM.
    """
    kinds = (*auto_names(sysfs_root), "battery_percent", "hwmon", "exec", "estimate_cpu_time", "replay")
    names = {kind: kind for kind in kinds}
    if asked not in ("auto", "none"):
        kind = asked.partition(":")[0].partition("@")[0]
        names[asked if kind == GAUGE else kind] = asked
    rows = [_row(name, sysfs_root) for name in names.values()]
    here = {platform_here(sysfs_root), *(name.partition(":")[2] for name in names)}
    return rows + [(None, _elsewhere(platform)) for platform in BATTERIES if platform not in here]


def _row(name: str, sysfs_root: Path) -> Row:
    if name in TO_BE_NAMED:
        return None, SourceReport(
            method=name, scope="as stated", available=False, reason="nothing was named", remedy=TO_BE_NAMED[name]
        )
    source = make_source(name, sysfs_root)
    report = source.report()
    if name.startswith(f"{GAUGE}:"):
        report = report.model_copy(update={"method": name})
    return source, report


def _elsewhere(platform: str) -> SourceReport:
    return SourceReport(
        method=f"{GAUGE}:{platform}",
        scope="whole machine",
        available=False,
        reason=f"not this platform ({TITLES[platform]})",
        this_platform=False,
    )
