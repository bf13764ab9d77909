"""`joulebox-agent doctor`."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from joulebox_agent.cli.plan import StateFolder, state_folder
from joulebox_agent.doctor import Diagnosis, diagnose
from joulebox_agent.measuring.calibrating import Stored, stored
from joulebox_agent.sampling.sampler import HIGHEST_CPU_SHARE
from joulebox_agent.sources.choose import KNOWN

SHOWN_CONDITIONS = {"mains_online": "mains", "battery_charge_share": "charge", "temperature_c": "hottest (C)",
                    "governor": "governor", "energy_preference": "energy preference", "power_profile": "power profile",
                    "brightness_share": "brightness", "network_up": "network",
                    "load_1_min": "load (1 min)"}  # fmt: skip


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print the document instead of a table.")] = False,
    sysfs_root: Annotated[Path, typer.Option(help="Folder that plays /sys (holds class/power_supply).")] = Path("/sys"),
    watch: Annotated[
        float, typer.Option(min=0, max=3600, help="Watch values for S seconds to learn refresh and rate.")
    ] = 0.0,
    source: Annotated[str, typer.Option(help=f"Energy source to check: {', '.join(KNOWN)}.")] = "auto",
    state_dir: StateFolder = None,
) -> None:
    """Say what can be measured here, and what is missing for the rest."""
    console = Console(stderr=True)
    if watch > 0 and console.is_terminal:
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task("watching the gauges", total=watch)
            diagnosis = diagnose(sysfs_root, source, watch, lambda done_s: bar.update(task, completed=done_s))
    else:
        diagnosis = diagnose(sysfs_root, source, watch)
    kept = stored(state_folder(state_dir), diagnosis.conditions)
    if as_json:
        line = None if kept.calibration is None else kept.calibration.to_json()
        document = diagnosis.model_dump(mode="json") | {"calibration": line, "calibration_unused": kept.unused}
        print(json.dumps(document, indent=1))
    else:
        _print_words(diagnosis, kept)


def _print_words(diagnosis: Diagnosis, kept: Stored) -> None:
    console = Console(highlight=False)
    console.print(_sources(diagnosis))
    if any(report.available and report.refresh_s is None for report in diagnosis.sources):
        console.print("(refresh, and with it the window that 5 % needs: joulebox-agent doctor --watch 60)\n")
    for report in diagnosis.sources:
        remedy = f" Remedy: {report.remedy}" if report.remedy else ""
        console.print(f"{report.method}: {report.reason}.{remedy}", markup=False, soft_wrap=True)
    console.print()
    for name, title in SHOWN_CONDITIONS.items():
        value = diagnosis.conditions.get(name)
        if value is not None:
            console.print(f"{title}: {_words(name, value)}", markup=False)
    if diagnosis.other_cpu_share is not None:
        console.print(f"other processes: {diagnosis.other_cpu_share:.2f} cores busy")
    if diagnosis.sampler_cpu_share is not None:
        console.print(f"sampling: {diagnosis.sampler_cpu_share:.3%} of a core ({HIGHEST_CPU_SHARE:.1%} allowed)")
    console.print()
    if diagnosis.discharge_w is None:
        console.print(f"Discharge unknown: {diagnosis.reason}.", markup=False, soft_wrap=True)
    else:
        console.print(
            f"Discharging at {diagnosis.discharge_w:.3f} W ({diagnosis.reason}).", markup=False, soft_wrap=True
        )
    _print_calibration(console, kept)
    chosen = diagnosis.chosen or "nothing: time and CPU seconds only, no joules"
    console.print(f"A measurement here would use {chosen}.")


def _print_calibration(console: Console, kept: Stored) -> None:
    if kept.calibration is None:
        hint = "joulebox-agent calibrate SCENE learns it where battery and RAPL can both be read"
        console.print(f"RAPL against the battery: {kept.unused}; {hint}.", markup=False, soft_wrap=True)
        return
    made = f"{kept.calibration.words()}, made {kept.calibration.made_at:%Y-%m-%d %H:%M}"
    use = "in use" if kept.unused is None else f"not used now: {kept.unused}"
    console.print(f"RAPL against the battery: {made}; {use}.", markup=False, soft_wrap=True)


def _sources(diagnosis: Diagnosis) -> Table:
    table = Table(Column("source", no_wrap=True), "usable", "power", "step", "refresh", "5 % needs", "CPU")
    for report in diagnosis.sources:
        if not report.this_platform:
            continue
        table.add_row(
            report.method,
            "yes" if report.available else "no",
            _unit(report.power_w, "W"),
            _unit(report.resolution_j, "J"),
            _unit(report.refresh_s, "s"),
            _unit(report.window_s_for_5_percent, "s"),
            "" if report.cpu_share is None else f"{report.cpu_share:.3%}",
        )
    return table


def _unit(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.3g} {unit}"


def _words(name: str, value: object) -> str:
    if isinstance(value, bool):
        return "plugged in" if value else "unplugged"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "not connected"
    if isinstance(value, float):
        return f"{value:.0%}" if name.endswith("_share") else f"{value:.3g}"
    return str(value)
