"""`joulebox-agent measure`."""

import importlib.util
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from joulebox_agent.cli import plan
from joulebox_agent.cli.report import VoidMeasurementError, deliver, summary
from joulebox_agent.errors import AgentError, UsageError
from joulebox_agent.estimates.calibration import Calibration
from joulebox_agent.loop import renderer_command
from joulebox_agent.measuring.calibrating import calibration_for
from joulebox_agent.measuring.journal import Journal
from joulebox_agent.measuring.meter import Listener
from joulebox_agent.measuring.progress import shown_progress
from joulebox_agent.measuring.result import Result, build_result
from joulebox_agent.measuring.rule import make_rule
from joulebox_agent.measuring.session import Configuration, Session
from joulebox_agent.measuring.several import build_results, void_everywhere
from joulebox_agent.sources.choose import choose
from joulebox_agent.sources.sysfs import SYSTEM_ROOT

BLOCK_IDLE_S = 60.0


def measure(
    scene: plan.Scene,
    setting: plan.Setting = None,
    settings: plan.SettingsFile = None,
    preset: plan.Preset = None,
    define: plan.Define = None,
    renderer: plan.Renderer = None,
    source: plan.Source = "auto",
    sysfs_root: plan.SysfsRoot = SYSTEM_ROOT,
    window_s: Annotated[float, typer.Option(help="Shortest window in seconds.")] = 60.0,
    min_windows: Annotated[int, typer.Option(help="Windows of the pilot.")] = 5,
    max_windows: Annotated[int, typer.Option(help="Most windows.")] = 20,
    half_width: Annotated[float, typer.Option(help="Wanted half-width of the 95 % interval, as a share.")] = 0.05,
    max_seconds: Annotated[float, typer.Option(help="Time limit of a configuration from its first image.")] = 900.0,
    idle_s: Annotated[
        float | None, typer.Option(help="Idle seconds before and after, for net energy; 0 skips. Several: 60.")
    ] = None,
    silence_s: Annotated[float, typer.Option(help="Longest silence of the renderer.")] = 600.0,
    configurations: Annotated[
        Path | None, typer.Option(help="File of configurations to compare: settings over --set's (TOML or JSON).")
    ] = None,
    timed_only: Annotated[
        Path | None, typer.Option(help="File of configurations to time; stage powers tell their joules.")
    ] = None,
    meter: Annotated[int | None, typer.Option(min=1, help="Meter the first N configurations, time the others.")] = None,
    order: Annotated[str, typer.Option(help="blocks (randomised, one window of each a block) or sequence.")] = "blocks",
    order_seed: Annotated[int, typer.Option(help="Seed of the blocks' order.")] = 0,
    control: Annotated[int, typer.Option(min=1, help="Number of the configuration that is in every block.")] = 1,
    cool_to: Annotated[float | None, typer.Option(help="Wait for this temperature [°C] between windows.")] = None,
    charge_band: Annotated[
        str | None, typer.Option(metavar="HIGH-LOW", help="Measure between these charges, as 90-30 (percent).")
    ] = None,
    charge_hook: Annotated[
        str | None, typer.Option(metavar="COMMAND", help="Called with on or off to charge (a smart plug).")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(help="Keep progress in this file, and go on where it left off.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw power over time into this .png or .svg.")] = None,
    state_dir: plan.StateFolder = None,
    as_json: plan.AsJson = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the document to a file.")] = None,
    keep: Annotated[Path | None, typer.Option(help="Folder to keep the pictures and the samples in.")] = None,
) -> None:
    """Measure what a picture of SCENE costs here: time, CPU seconds and, where it can be read, energy."""
    several = configurations is not None
    rule = make_rule(
        window_s=window_s,
        min_windows=min_windows,
        max_windows=max_windows,
        half_width=half_width,
        max_seconds=max_seconds,
        idle_s=(BLOCK_IDLE_S if several else 0.0) if idle_s is None else idle_s,
        silence_s=silence_s,
    )
    arguments = plan.loop_arguments(scene, setting, settings, preset, define)
    entries = plan.entries_of(configurations, timed_only, meter)
    course = plan.course_of(order, order_seed, control, cool_to, entries)
    command = renderer_command(renderer)
    _check_places(output, keep, plot)
    choice = choose(source, sysfs_root)
    charging = plan.charging_of(choice, sysfs_root, several, charge_band, charge_hook)
    planned = plan.Plan(command, arguments, rule, choice, sysfs_root, entries, course, charging, resume)
    journal = planned.journal()
    with tempfile.TemporaryDirectory(prefix="joulebox-") as scratch, shown_progress() as listener:
        found = _carried_out(planned, journal, Path(scratch), plan.state_folder(state_dir), several, listener)
    deliver(found.results, found.document, found.words(as_json), as_json, output, keep)
    if journal is not None:
        journal.finish()
    if plot is not None:
        _draw(plot, found.session, [entry.label for entry in entries])
    if found.void is not None:
        raise VoidMeasurementError(f"The measurement is void: {found.void}.")


@dataclass(frozen=True)
class _Found:
    """What a session left: a result a configuration that began, the document of all; void: nothing may be used."""

    session: Session
    results: list[Result]
    document: dict[str, Any]
    void: str | None

    def words(self, as_json: bool) -> str:
        """For a person; nothing of a measurement that is void."""
        if self.void is not None and not as_json:
            return ""
        return "\n".join(summary(result.document) for result in self.results if result.document.void is None)


def _carried_out(
    planned: plan.Plan, journal: Journal | None, scratch: Path, state: Path, several: bool, listener: Listener
) -> _Found:
    plan.say_source(listener, planned.choice)
    forecast = planned.forecast()
    if forecast is not None:
        listener.note(forecast.words())
    configurations = planned.configurations(scratch)
    session = planned.session(configurations, listener, journal)
    records = session.run()
    calibration, said = calibration_for(records, state)
    for note in said:
        listener.note(note)
    if several:
        all_of_them = build_results(session, configurations, planned.rule, planned.course, calibration)
        results = [result for result in all_of_them.results if result]
        for sentence in all_of_them.lacking():
            listener.note(sentence)
        found = _Found(session, results, all_of_them.to_json(), void_everywhere(all_of_them))
    else:
        found = _only(session, configurations[0], planned, calibration)
    for note in dict.fromkeys(note for result in found.results for note in result.notes):
        listener.note(f"note: {note}")
    return found


def _only(
    session: Session, configuration: Configuration, planned: plan.Plan, calibration: Calibration | None
) -> _Found:
    result = build_result(session.records[0], planned.rule, configuration.job.image_file, calibration=calibration)
    return _Found(session, [result], result.document.to_json(), result.document.void)


def _check_places(output: Path | None, keep: Path | None, plot: Path | None) -> None:
    """Before hours of measuring rather than after them. Raises UsageError."""
    for folder in (output.parent if output else None, keep, plot.parent if plot else None):
        plan.make_folder(folder)
    if plot is not None:
        _check_plot(plot)
    if output is not None and output.is_dir():
        raise UsageError(f"-o {output} is a folder; name a file in it.")


def _check_plot(path: Path) -> None:
    if importlib.util.find_spec("altair") is None or importlib.util.find_spec("vl_convert") is None:
        raise UsageError("--plot needs what `pip install joulebox-agent[plot]` installs.")
    from joulebox_agent.measuring.plot import plot_format

    plot_format(path)


def _draw(path: Path, session: Session, labels: list[str]) -> None:
    from joulebox_agent.measuring.plot import power_chart, save_chart

    try:
        save_chart(power_chart(session.records, labels), path)
    except OSError as error:
        raise AgentError(f"The plot {path} cannot be written: {error.strerror}.") from error
