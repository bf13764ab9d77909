"""`joulebox-agent measure`."""

import importlib.util
import math
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import platformdirs
import typer

from joulebox_agent.cli.report import VoidMeasurementError, deliver, summary
from joulebox_agent.errors import AgentError, UsageError
from joulebox_agent.loop import renderer_command
from joulebox_agent.measuring.blocks import Order
from joulebox_agent.measuring.calibrating import calibration_for, companion_of
from joulebox_agent.measuring.charging import Band, Charging, Forecast
from joulebox_agent.measuring.configurations import Entry, read_configurations
from joulebox_agent.measuring.journal import Journal
from joulebox_agent.measuring.measure import make_meter
from joulebox_agent.measuring.meter import Listener
from joulebox_agent.measuring.progress import shown_progress
from joulebox_agent.measuring.result import build_result
from joulebox_agent.measuring.rule import MeasureRule, make_rule
from joulebox_agent.measuring.session import Configuration, Course, Session
from joulebox_agent.measuring.several import build_results, void_everywhere
from joulebox_agent.measuring.visit import Job
from joulebox_agent.sources.choose import KNOWN, Choice, choose

SOURCE_HELP = ", ".join(KNOWN) + "."
BLOCK_IDLE_S = 60.0
A_VISIT_S = 8.0  # to start a renderer and warm it up, for the forecast


def measure(
    scene: Annotated[str, typer.Argument(help="Scene folder or name, as the renderer takes it.")],
    setting: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A setting; repeatable.")
    ] = None,
    settings: Annotated[Path | None, typer.Option(help="File of settings (JSON or TOML).")] = None,
    preset: Annotated[str | None, typer.Option(help="Preset of the renderer.")] = None,
    define: Annotated[
        list[str] | None, typer.Option("-D", "--define", metavar="NAME=VALUE", help="A scene's value.")
    ] = None,
    renderer: Annotated[str | None, typer.Option(help="Command that speaks the loop protocol.")] = None,
    source: Annotated[str, typer.Option(help=SOURCE_HELP)] = "auto",
    sysfs_root: Annotated[Path, typer.Option(help="Folder that plays /sys.")] = Path("/sys"),
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
    state_dir: Annotated[Path | None, typer.Option(help="Folder of this device's calibration.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the document.")] = False,
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
    arguments = loop_arguments(scene, setting or [], settings, preset, define or [])
    entries = _entries(configurations, timed_only, meter)
    course = _course(order, order_seed, control, cool_to, entries)
    command = renderer_command(renderer)
    for folder in (output.parent if output else None, keep, plot.parent if plot else None):
        _make_folder(folder)
    if plot is not None:
        _check_plot(plot)
    if output is not None and output.is_dir():
        raise UsageError(f"-o {output} is a folder; name a file in it.")
    choice = choose(source, sysfs_root)
    charging = _charging(choice, sysfs_root, several, charge_band, charge_hook)
    plan = {"arguments": arguments, "entries": [[*e.arguments(), e.timed_only] for e in entries], "command": command,
            "rule": rule.model_dump(), "source": choice.name, "order": [course.order, course.seed]}  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="joulebox-") as scratch, shown_progress() as listener:
        _say_source(listener, choice)
        if charging is not None:
            listener.note(_forecast(charging, rule, entries, choice).words())
        jobs = [
            Configuration(
                Job(command, [*arguments, *entry.arguments()], Path(scratch) / f"{i}.exr"),
                entry.label,
                entry.timed_only,
            )
            for i, entry in enumerate(entries)
        ]
        rig = make_meter(choice, sysfs_root, listener, companion=companion_of(choice, sysfs_root))
        session = Session(jobs, rule, rig, course, charging, Journal(resume, plan) if resume else None)
        records = session.run()
        folder = state_dir or Path(platformdirs.user_state_dir("joulebox-agent"))
        calibration, said = calibration_for(records, folder)
        for note in said:
            listener.note(note)
        document: dict[str, Any]
        if several:
            found = build_results(session, jobs, rule, course, calibration)
            results, document, void = [r for r in found.results if r], found.to_json(), void_everywhere(found)
        else:
            results = [build_result(records[0], rule, jobs[0].job.image_file, calibration=calibration)]
            document, void = results[0].document.to_json(), results[0].document.void
        for note in dict.fromkeys(note for result in results for note in result.notes):
            listener.note(f"note: {note}")
    words = "\n".join(summary(result.document) for result in results if result.document.void is None)
    if not as_json and void is not None:
        words = ""
    deliver(results, document, words, as_json, output, keep)
    if resume is not None:
        Journal(resume, plan).finish()
    if plot is not None:
        _draw(plot, session, entries)
    if void is not None:
        raise VoidMeasurementError(f"The measurement is void: {void}.")


def loop_arguments(
    scene: str, settings: list[str], file: Path | None, preset: str | None, defines: list[str]
) -> list[str]:
    """The loop command's arguments. Raises UsageError for what is not key=value, or a missing file."""
    for option, pairs in (("--set", settings), ("-D", defines)):
        for pair in pairs:
            if "=" not in pair or pair.startswith("="):
                raise UsageError(f"{option} {pair!r} must be key=value.")
    if file is not None and not file.is_file():
        raise UsageError(f"The settings file {file} does not exist.")
    arguments = [scene]
    if file is not None:
        arguments += ["--settings", str(file)]
    if preset is not None:
        arguments += ["--set", f"preset={preset}"]
    for pair in settings:
        arguments += ["--set", pair]
    for pair in defines:
        arguments += ["-D", pair]
    return arguments


def _entries(configurations: Path | None, timed_only: Path | None, meter: int | None) -> list[Entry]:
    """What is measured: one configuration without a file. Raises UsageError."""
    if configurations is None:
        if timed_only is not None or meter is not None:
            raise UsageError("--timed-only and --meter go with --configurations: joules come from metered ones.")
        return [Entry({}, "")]
    entries = read_configurations(configurations)
    if meter is not None:
        entries = [replace(e, timed_only=e.timed_only or i >= meter) for i, e in enumerate(entries)]
    if timed_only is not None:
        entries += [replace(entry, timed_only=True) for entry in read_configurations(timed_only)]
    if all(entry.timed_only for entry in entries):
        raise UsageError("Every configuration is timed only; meter at least one.")
    return entries


def _course(order: str, seed: int, control: int, cool_to_c: float | None, entries: list[Entry]) -> Course:
    chosen: dict[str, Order] = {"blocks": "blocks", "sequence": "sequence"}
    if order not in chosen:
        raise UsageError(f"--order {order!r} must be blocks or sequence.")
    if cool_to_c is not None and not math.isfinite(cool_to_c):
        raise UsageError(f"--cool-to {cool_to_c} must be a temperature in °C.")
    if control > len(entries) or entries[control - 1].timed_only:
        raise UsageError(f"--control {control} must be the number of a metered configuration.")
    return Course(chosen[order] if len(entries) > 1 else "sequence", seed, control - 1, cool_to_c)


def _charging(choice: Choice, root: Path, several: bool, band: str | None, hook: str | None) -> Charging | None:
    """Whether the battery is planned for: when asked, and for several configurations on a battery."""
    if not choice.source.method.startswith("battery"):
        if band or hook:
            raise UsageError(f"A charge band is for a battery; the source here is {choice.source.method}.")
        return None
    if not (several or band or hook):
        return None
    return Charging(Band.parse(band) if band else Band(), root, choice.name, hook)


def _forecast(charging: Charging, rule: MeasureRule, entries: list[Entry], choice: Choice) -> Forecast:
    """The pilot's blocks: what every plan takes at the least."""
    metered = sum(not entry.timed_only for entry in entries)
    visits_s = metered * rule.min_windows * (rule.window_s + A_VISIT_S) + rule.idle_s * (rule.min_windows + 1)
    return charging.forecast(visits_s + (len(entries) - metered) * (30.0 + A_VISIT_S), choice.report.power_w)


def _make_folder(folder: Path | None) -> None:
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"The folder {folder} cannot be made: {error.strerror}.") from error
    if not os.access(folder, os.W_OK):
        raise UsageError(f"The folder {folder} cannot be written to.")


def _check_plot(path: Path) -> None:
    """Before hours of measuring rather than after them."""
    if importlib.util.find_spec("altair") is None or importlib.util.find_spec("vl_convert") is None:
        raise UsageError("--plot needs what `pip install joulebox-agent[plot]` installs.")
    from joulebox_agent.measuring.plot import plot_format

    plot_format(path)


def _draw(path: Path, session: Session, entries: list[Entry]) -> None:
    from joulebox_agent.measuring.plot import power_chart, save_chart

    try:
        save_chart(power_chart(session.records, [entry.label for entry in entries]), path)
    except OSError as error:
        raise AgentError(f"The plot {path} cannot be written: {error.strerror}.") from error


def _say_source(listener: Listener, choice: Choice) -> None:
    for report in choice.declined:
        listener.note(
            f"{report.method} cannot be used: {report.reason}" + (f" ({report.remedy})" if report.remedy else "")
        )
    quality, method = choice.source.quality, choice.source.method
    if quality == "none":
        listener.note("No energy source: time and CPU seconds only, energy stays null.")
    elif quality == "replayed":
        listener.note(f"Energy is REPLAYED from {', '.join(choice.report.files)}: not a measurement of this machine.")
    else:
        listener.note(f"Energy from {method} ({choice.source.scope}): {choice.report.reason}")
