"""`joulebox-agent measure`."""

import json
import os
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from joulebox_agent.document import MeasureDocument
from joulebox_agent.errors import AgentError, UsageError
from joulebox_agent.estimate import Interval
from joulebox_agent.loop import renderer_command
from joulebox_agent.measure import Measurement
from joulebox_agent.meter import Listener
from joulebox_agent.progress import shown_progress
from joulebox_agent.result import Result, build_result
from joulebox_agent.rule import make_rule
from joulebox_agent.sources.choose import Choice, choose
from joulebox_agent.visit import Job

SOURCE_HELP = "auto, battery_gauge, battery_counter, rapl, replay[:FILE][@REFRESH_S] or none."


class VoidMeasurementError(AgentError):
    """The measurement ended, but what it saw must not be used."""


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
    max_seconds: Annotated[float, typer.Option(help="Time limit from the first image.")] = 900.0,
    idle_s: Annotated[float, typer.Option(help="Idle seconds before and after, for net energy; 0 skips.")] = 0.0,
    silence_s: Annotated[float, typer.Option(help="Longest silence of the renderer.")] = 600.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the document.")] = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the document to a file.")] = None,
    keep: Annotated[Path | None, typer.Option(help="Folder to keep the picture and the samples in.")] = None,
) -> None:
    """Measure what a picture of SCENE costs here: time, CPU seconds and, where it can be read, energy."""
    rule = make_rule(
        window_s=window_s,
        min_windows=min_windows,
        max_windows=max_windows,
        half_width=half_width,
        max_seconds=max_seconds,
        idle_s=idle_s,
        silence_s=silence_s,
    )
    arguments = loop_arguments(scene, setting or [], settings, preset, define or [])
    command = renderer_command(renderer)
    for folder in (output.parent if output else None, keep):
        _make_folder(folder)
    choice = choose(source, sysfs_root)
    with tempfile.TemporaryDirectory(prefix="joulebox-") as scratch, shown_progress() as listener:
        _say_source(listener, choice)
        job = Job(command, arguments, Path(scratch) / "last.exr")
        record = Measurement(job, rule, choice, listener, sysfs_root=sysfs_root).run()
        result = build_result(record, rule, job.image_file)
        for note in result.notes:
            listener.note(f"note: {note}")
    _deliver(result, as_json, output, keep)


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


def _make_folder(folder: Path | None) -> None:
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"The folder {folder} cannot be made: {error.strerror}.") from error
    if not os.access(folder, os.W_OK):
        raise UsageError(f"The folder {folder} cannot be written to.")


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


def _deliver(result: Result, as_json: bool, output: Path | None, keep: Path | None) -> None:
    document = result.document
    text = json.dumps(document.to_json(), indent=1)
    try:
        if keep is not None:
            for digest, content in result.blobs.items():
                kind = "exr" if digest == document.image_blob else "ndjson"
                (keep / f"{digest}.{kind}").write_bytes(content)
        if output is not None:
            output.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise AgentError(f"{error.filename or output or keep} cannot be written: {error.strerror}.") from error
    if as_json:
        print(text)
    elif document.void is None:
        print(summary(document))
    if document.void is not None:
        raise VoidMeasurementError(f"The measurement is void: {document.void}.")


def summary(document: MeasureDocument) -> str:
    """A few lines for a person."""
    lines = [
        f"{document.scene}: {document.images} images in {document.windows} windows",
        f"  picture {document.pixel_sha256}",
        f"  time    {_words(document.time_s_per_image, 's')} an image",
        f"  CPU     {_words(document.cpu_s_per_image, 's')} an image",
    ]
    energy = document.energy_j_per_image
    if energy.gross is None:
        lines.append("  energy  unknown (null): no joules are made up")
    else:
        label = f"{document.quality.upper()}, {document.method}, {document.scope}"
        lines.append(f"  energy  {_words(energy.gross, 'J')} an image ({label})")
    if energy.net is not None:
        lines.append(f"  net     {_words(energy.net, 'J')} an image above idle")
    for name, stage in document.stages.items():
        joules = stage.energy_j.equation_2
        priced = "" if joules is None else f", {joules:.4g} J"
        lines.append(f"    {name}: {stage.time_s:.4g} s{priced}")
    return "\n".join(lines)


def _words(interval: Interval | None, unit: str) -> str:
    if interval is None:
        return "unknown"
    if interval.low == interval.high:
        return f"{interval.value:.4g} {unit}"
    return f"{interval.value:.4g} {unit} [{interval.low:.4g}, {interval.high:.4g}]"
