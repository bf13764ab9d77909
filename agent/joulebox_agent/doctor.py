"""What can be measured on this machine, and if something cannot, why and what helps."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from joulebox_agent.conditions import Conditions, other_cpu_share, read_conditions
from joulebox_agent.errors import SourceUnavailableError
from joulebox_agent.estimates.resolution import window_s_for_share
from joulebox_agent.sampling.sampler import Sample, Sampler
from joulebox_agent.sampling.sampler_process import sampler_cost
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.choose import COUNTER, GAUGE, auto_names
from joulebox_agent.sources.reading import EnergySource, SourceReport
from joulebox_agent.sources.survey import Row, survey
from joulebox_agent.sources.sysfs import SYSTEM_ROOT

LOOK_S, LOOK_PAUSE_S = 0.2, 0.01  # how long a source is read again and again, to learn what a reading costs
COST_S = 5.0  # at most, to learn what the sampling process costs
FEWEST_STEPS = 5  # of a counter, below which its difference is no power
WANTED_SHARE = 0.05


class Diagnosis(BaseModel):
    """The document of `doctor --json`.

    discharge_w      what leaves the system's batteries now [W]; None when that cannot be said, see reason
    chosen           the method `auto` (or the asked source) would measure with; None when there is none
    conditions       state that changes the power draw, see `conditions`
    other_cpu_share  CPU that other processes used meanwhile, in cores; None where that is not known
    sampler_cpu_share  CPU of the process that samples the chosen source in a measurement, as a share of one core;
                     None unless it was watched
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    discharge_w: float | None
    reason: str
    sources: tuple[SourceReport, ...]
    chosen: str | None
    conditions: Conditions
    other_cpu_share: float | None
    sampler_cpu_share: float | None


def diagnose(
    sysfs_root: Path = SYSTEM_ROOT,
    source: str = "auto",
    watch_s: float = 0.0,
    on_tick: Callable[[float], None] = lambda elapsed_s: None,
) -> Diagnosis:
    """Looks at every source for a moment, and with `watch_s` for that long to learn refresh and rate.

    Raises UsageError for a root that is not a folder or an unknown source.
    """
    before = read_conditions(sysfs_root)
    rows = [_looked(*row) for row in survey(sysfs_root, source)]
    if watch_s > 0:
        rows = _watched(rows, watch_s, on_tick)
    discharge_w, reason = _discharge([report for _, report in rows])
    after = read_conditions(sysfs_root)
    chosen = _chosen(rows, source, sysfs_root)
    return Diagnosis(
        discharge_w=discharge_w,
        reason=reason,
        sources=tuple(_with_window(rows, discharge_w)),
        chosen=chosen,
        conditions=after,
        other_cpu_share=other_cpu_share(before, after),
        sampler_cpu_share=_sampler_share(source, sysfs_root, watch_s) if chosen else None,
    )


def _chosen(rows: list[Row], asked: str, sysfs_root: Path) -> str | None:
    usable = {report.method for _, report in rows if report.available}
    if asked != "auto":
        kind = asked if asked.startswith(GAUGE) else asked.partition(":")[0].partition("@")[0]
        return kind if kind in usable else None
    return next((name for name in auto_names(sysfs_root) if name in usable), None)


def _sampler_share(name: str, sysfs_root: Path, watch_s: float) -> float | None:
    """What sampling costs once it has begun; None without watching, or when the source went away meanwhile."""
    try:
        return sampler_cost(name, sysfs_root, min(watch_s, COST_S)) if watch_s > 0 else None
    except SourceUnavailableError:
        return None


def _discharge(reports: list[SourceReport]) -> tuple[float | None, str]:
    gauges = [report for report in reports if report.method.startswith(GAUGE)]
    gauge = next((report for report in gauges if report.available), gauges[0])
    counter = next(report for report in reports if report.method == COUNTER)
    if gauge.available:
        return gauge.power_w, f"{gauge.method}: {gauge.reason}"
    if counter.available and counter.power_w is not None:
        return counter.power_w, f"{COUNTER}, as the gauge is not usable: {gauge.reason}"
    if counter.available:
        return None, f"{gauge.reason}; the counter can tell it over time (doctor --watch 60)"
    return None, gauge.reason


def _looked(source: EnergySource | None, report: SourceReport) -> Row:
    """Reads the source for a moment: what that costs at its own pace, and the power of a fast counter."""
    if source is None or not report.available:
        return source, report
    start_s, start_cpu_s = time.perf_counter(), _cpu_s()
    first = last = source.read()
    first_s = last_s = time.perf_counter()
    reads = 1
    while last_s - start_s < LOOK_S:
        time.sleep(LOOK_PAUSE_S)
        last, last_s = source.read(), time.perf_counter()
        reads += 1
    found: dict[str, float] = {"cpu_share": (_cpu_s() - start_cpu_s) / reads / source.poll_s}
    used_j = (last.counter_j or 0.0) - (first.counter_j or 0.0)
    if source.primary == "counter" and report.resolution_j and used_j >= FEWEST_STEPS * report.resolution_j:
        found["power_w"] = used_j / (last_s - first_s)
    return source, report.model_copy(update=found)


def _cpu_s() -> float:
    """CPU seconds of this process and of the commands that it ran."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _watched(rows: list[Row], watch_s: float, on_tick: Callable[[float], None]) -> list[Row]:
    """Polls every available source for `watch_s` and fills in what only time tells."""
    samplers = {report.method: Sampler(source) for source, report in rows if source is not None and report.available}
    for sampler in samplers.values():
        sampler.start()
    try:
        _wait(next(iter(samplers.values())), watch_s, on_tick)
    finally:
        for sampler in samplers.values():
            sampler.stop()
    return [
        (source, filled(report, samplers[report.method].samples(), source))
        if source is not None and report.method in samplers
        else (source, report)
        for source, report in rows
    ]


def _wait(sampler: Sampler, watch_s: float, on_tick: Callable[[float], None]) -> None:
    start_s = sampler.clock.now_s()
    while (elapsed_s := sampler.clock.now_s() - start_s) < watch_s:
        on_tick(elapsed_s)
        sampler.pause(min(0.5, watch_s - elapsed_s))
    on_tick(watch_s)


def filled(report: SourceReport, samples: list[Sample], source: EnergySource) -> SourceReport:
    """The report with what watching told: refresh, mean power, the step of a gauge, the window for 5 %."""
    series = PowerSeries(samples)
    power_w, span_s, refresh_s = report.power_w, series.span_s(), series.refresh_s()
    enough = 2 if source.primary == "counter" else 1  # one step of a counter is no rate
    if span_s and span_s[1] > span_s[0] and series.update_count(*span_s) >= enough:
        energy_j = series.energy_j(*span_s, source.primary)
        power_w = None if energy_j is None else energy_j / (span_s[1] - span_s[0])
    powers_w = np.unique([s.reading.power_w for s in samples if s.reading.power_w is not None])
    resolution_j = report.resolution_j
    if source.primary == "power" and refresh_s is not None and powers_w.size > 1:
        resolution_j = float(np.diff(powers_w).min()) * refresh_s
    return report.model_copy(update={"refresh_s": refresh_s, "power_w": power_w, "resolution_j": resolution_j})


def _with_window(rows: list[Row], discharge_w: float | None) -> list[SourceReport]:
    """The reports with the window that 5 % needs; a counter of the whole machine without a power of its own goes
    by the battery's."""

    def with_window(source: EnergySource | None, report: SourceReport) -> SourceReport:
        if source is None or not report.available:
            return report
        power_w = discharge_w if report.power_w is None and report.scope == "whole machine" else report.power_w
        step_j = report.resolution_j if source.primary == "counter" else None
        window_s = window_s_for_share(WANTED_SHARE, power_w, report.refresh_s, step_j)
        return report.model_copy(update={"window_s_for_5_percent": window_s})

    return [with_window(*row) for row in rows]
