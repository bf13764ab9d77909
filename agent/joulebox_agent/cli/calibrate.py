"""`joulebox-agent calibrate`."""

import json
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from joulebox_agent.cli import plan
from joulebox_agent.cli.report import VoidMeasurementError
from joulebox_agent.errors import SourceUnavailableError
from joulebox_agent.loop import renderer_command
from joulebox_agent.measuring.calibrating import calibrate as calibrated
from joulebox_agent.measuring.calibrating import keep, why_no_companion
from joulebox_agent.measuring.progress import shown_progress
from joulebox_agent.measuring.rule import make_rule
from joulebox_agent.sources.choose import choose
from joulebox_agent.sources.sysfs import SYSTEM_ROOT


def calibrate(
    scene: plan.Scene,
    setting: plan.Setting = None,
    settings: plan.SettingsFile = None,
    preset: plan.Preset = None,
    define: plan.Define = None,
    renderer: plan.Renderer = None,
    source: plan.Source = "auto",
    sysfs_root: plan.SysfsRoot = SYSTEM_ROOT,
    window_s: Annotated[float, typer.Option(help="Shortest window in seconds.")] = 60.0,
    windows: Annotated[int, typer.Option(min=3, max=1000, help="Windows that are rendered.")] = 5,
    idle_s: Annotated[float, typer.Option(min=0.1, help="Idle seconds before and after.")] = 60.0,
    silence_s: Annotated[float, typer.Option(help="Longest silence of the renderer.")] = 600.0,
    state_dir: plan.StateFolder = None,
    as_json: plan.AsJson = False,
) -> None:
    """Learn what RAPL's watts are worth at the battery, P_battery = a + b P_rapl: idle, then rendering SCENE."""
    rule = make_rule(window_s=window_s, min_windows=windows, max_windows=windows, idle_s=idle_s, silence_s=silence_s,
                     max_seconds=86_400)  # fmt: skip
    arguments = plan.loop_arguments(scene, setting, settings, preset, define)
    command, folder = renderer_command(renderer), plan.state_folder(state_dir)
    plan.make_folder(folder)
    choice = choose(source, sysfs_root)
    reason = why_no_companion(choice, sysfs_root)
    if reason is not None:
        raise SourceUnavailableError(f"A calibration reads battery and RAPL side by side, on battery power: {reason}.")
    planned = plan.Plan(command, arguments, rule, choice, sysfs_root)
    with tempfile.TemporaryDirectory(prefix="joulebox-") as scratch, shown_progress() as listener:
        plan.say_source(listener, choice)
        records = planned.session(planned.configurations(Path(scratch)), listener, None).run()
    if records[0].void is not None:
        raise VoidMeasurementError(f"The calibration is void: {records[0].void}.")
    found = calibrated(records, records[0].after)
    keep(found, folder)
    print(json.dumps(found.to_json(), indent=1) if as_json else f"{found.words()}; kept in {folder}")
