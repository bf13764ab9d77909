"""`joulebox-agent doctor`."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from joulebox_agent.doctor import Diagnosis, diagnose


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print the document instead of a table.")] = False,
    sysfs_root: Annotated[Path, typer.Option(help="Folder that plays /sys (holds class/power_supply).")] = Path("/sys"),
    watch: Annotated[
        float, typer.Option(min=0, max=3600, help="Watch values for S seconds to learn refresh and rate.")
    ] = 0.0,
    source: Annotated[str, typer.Option(help="Energy source to check; auto takes the best.")] = "auto",
) -> None:
    """Say what can be measured here, and what is missing for the rest."""
    console = Console(stderr=True)
    if watch > 0 and console.is_terminal:
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task("watching the gauges", total=watch)
            diagnosis = diagnose(sysfs_root, source, watch, lambda done_s: bar.update(task, completed=done_s))
    else:
        diagnosis = diagnose(sysfs_root, source, watch)
    if as_json:
        print(json.dumps(diagnosis.model_dump(mode="json"), indent=1))
    else:
        _print_table(diagnosis)


def _print_table(diagnosis: Diagnosis) -> None:
    console = Console()
    table = Table("source", "scope", "usable", "power", "refresh", "reason", "remedy")
    for report in diagnosis.sources:
        table.add_row(
            report.method,
            report.scope,
            "yes" if report.available else "no",
            "" if report.power_w is None else f"{report.power_w:.3g} W",
            "" if report.refresh_s is None else f"{report.refresh_s:.2g} s",
            report.reason,
            report.remedy,
        )
    console.print(table)
    if diagnosis.discharge_w is None:
        console.print(f"Discharge unknown: {diagnosis.reason}.", highlight=False)
    else:
        console.print(f"Discharging at {diagnosis.discharge_w:.3f} W ({diagnosis.reason}).", highlight=False)
    chosen = diagnosis.chosen or "nothing: time and CPU seconds only, no joules"
    console.print(f"A measurement here would use {chosen}.", highlight=False)
