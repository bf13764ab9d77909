"""What can be measured on this machine, and if something cannot, why and what helps."""

from collections.abc import Callable
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from joulebox_agent.conditions import Conditions, read_conditions
from joulebox_agent.sampler import Sampler
from joulebox_agent.series import PowerSeries
from joulebox_agent.sources.choose import SOURCES, choose, parse_replay, reports
from joulebox_agent.sources.reading import EnergySource, SourceReport
from joulebox_agent.sources.replay import Replay, bundled_trace
from joulebox_agent.sources.sysfs import Sysfs


class Diagnosis(BaseModel):
    """The document of `doctor --json`.

    discharge_w  what leaves the system's batteries now [W]; None when that cannot be said, see reason
    chosen       the method `auto` (or the asked source) would measure with; None when there is none
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    discharge_w: float | None
    reason: str
    sources: tuple[SourceReport, ...]
    chosen: str | None
    conditions: Conditions


def diagnose(
    sysfs_root: Path,
    source: str = "auto",
    watch_s: float = 0.0,
    on_tick: Callable[[float], None] = lambda elapsed_s: None,
) -> Diagnosis:
    """Looks at every source once, and with `watch_s` for that long to learn refresh and rate.

    Raises UsageError for a root that is not a folder or an unknown source.
    """
    found = reports(sysfs_root)
    if source != "auto":
        named = parse_replay(source) if source.startswith("replay") else None
        if named is None and source not in SOURCES and source != "none":
            choose(source, sysfs_root)  # raises, naming the known ones
    if watch_s > 0:
        found = _watched(found, sysfs_root, watch_s, on_tick)
    by_method = {report.method: report for report in found}
    discharge_w, reason = _discharge(by_method)
    return Diagnosis(
        discharge_w=discharge_w,
        reason=reason,
        sources=tuple(found),
        chosen=_chosen(by_method, source),
        conditions=read_conditions(sysfs_root),
    )


def _chosen(by_method: dict[str, SourceReport], source: str) -> str | None:
    if source != "auto":
        method = source.split(":")[0].split("@")[0]
        return method if method in by_method and by_method[method].available else None
    return next((method for method in SOURCES if by_method[method].available), None)


def _discharge(by_method: dict[str, SourceReport]) -> tuple[float | None, str]:
    gauge, counter = by_method["battery_gauge"], by_method["battery_counter"]
    if gauge.available:
        return gauge.power_w, f"battery_gauge: {gauge.reason}"
    if counter.available and counter.power_w is not None:
        return counter.power_w, f"battery_counter, as the gauge is not usable: {gauge.reason}"
    if counter.available:
        return None, f"{gauge.reason}; the counter can tell it over time (doctor --watch 60)"
    return None, gauge.reason


def _watched(
    found: list[SourceReport], sysfs_root: Path, watch_s: float, on_tick: Callable[[float], None]
) -> list[SourceReport]:
    """Polls every available source for `watch_s` and fills in refresh_s and the mean power."""
    sysfs = Sysfs(sysfs_root)
    sources: list[EnergySource] = [make(sysfs) for make in SOURCES.values()]
    sources.append(Replay(bundled_trace()))
    available = {report.method for report in found if report.available}
    samplers = {source.method: Sampler(source) for source in sources if source.method in available}
    for sampler in samplers.values():
        sampler.start()
    try:
        _wait(next(iter(samplers.values())), watch_s, on_tick)
    finally:
        for sampler in samplers.values():
            sampler.stop()
    return [
        _filled(report, PowerSeries(samplers[report.method].samples()), samplers[report.method].source)
        if report.method in samplers
        else report
        for report in found
    ]


def _wait(sampler: Sampler, watch_s: float, on_tick: Callable[[float], None]) -> None:
    start_s = sampler.clock.now_s()
    while (elapsed_s := sampler.clock.now_s() - start_s) < watch_s:
        on_tick(elapsed_s)
        sampler.pause(min(0.5, watch_s - elapsed_s))
    on_tick(watch_s)


def _filled(report: SourceReport, series: PowerSeries, source: EnergySource) -> SourceReport:
    power_w, span_s = report.power_w, series.span_s()
    enough = 2 if source.primary == "counter" else 1  # one step of a counter is no rate
    if span_s and span_s[1] > span_s[0] and series.update_count(*span_s) >= enough:
        energy_j = series.energy_j(*span_s, source.primary)
        power_w = None if energy_j is None else energy_j / (span_s[1] - span_s[0])
    return report.model_copy(update={"refresh_s": series.refresh_s(), "power_w": power_w})
