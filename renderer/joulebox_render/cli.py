"""The command `joulebox-render`."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from joulebox_render import __version__
from joulebox_render.cli_scenes import DefineOption, JsonOption, SceneArgument, read_defines, scenes_app
from joulebox_render.errors import RenderError, SettingsError, TargetError
from joulebox_render.settings import (
    Settings,
    make_settings,
    parse_assignments,
    read_settings_file,
    settings_schema,
)

app = typer.Typer(
    no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
    help="Photon mapping renderer of joulebox: what a picture costs, stage by stage.",
)  # fmt: skip
app.add_typer(scenes_app, name="scenes")
messages = Console(stderr=True)

SetOption = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A setting; may repeat.")]
FileOption = Annotated[Path | None, typer.Option("--settings", help="JSON or TOML file of settings.")]
PresetOption = Annotated[str | None, typer.Option("--preset", help="draft, balanced, fine or reference.")]


@app.command()
def render(
    scene: SceneArgument,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Float EXR picture to write.")] = None,
    png: Annotated[Path | None, typer.Option("--png", help="8-bit sRGB picture to write.")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="JSON report to write.")] = None,
    set_: SetOption = None,
    settings: FileOption = None,
    preset: PresetOption = None,
    define: DefineOption = None,
    json_: JsonOption = False,
) -> None:
    """Render one picture and say where its time went."""
    from joulebox_render.images import write_exr, write_png

    chosen = _settings(set_, settings, preset)
    if not (output or png or report or json_):
        raise SettingsError("nothing would be kept of this render: give -o picture.exr, --png, --report or --json")
    for path, suffix in ((output, ".exr"), (png, ".png"), (report, "")):
        _check_target(path, suffix)
    with _session(scene, chosen, define) as session:
        for note in session.scene.notes:
            messages.print(f"note: {note}", style="dim", highlight=False)
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
        with Progress(*columns, TimeRemainingColumn(), console=messages, transient=True) as bar:
            task = bar.add_task(f"rendering {session.scene.name}", total=1.0)
            image = session.render(progress=lambda share: bar.update(task, completed=share))
        document = session.report(image)
        if output:
            write_exr(output, image.pixels, {"joulebox:pixel_sha256": image.pixel_sha256})
        if png:
            write_png(png, image.pixels, session.settings.exposure)
    if report:
        write_text(report, json.dumps(document, indent=1) + "\n")
    for note in image.notes:
        messages.print(f"note: {note}", style="yellow", highlight=False)
    if json_:
        print(json.dumps(document, indent=1))
    else:
        _print_report(document)


@app.command()
def loop(
    scene: SceneArgument,
    max_images: Annotated[int | None, typer.Option("--max-images", min=1, help="End after so many images.")] = None,
    max_seconds: Annotated[
        float | None, typer.Option("--max-seconds", min=0.0, help="Start no image later than this [s].")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="EXR for the last image.")] = None,
    set_: SetOption = None,
    settings: FileOption = None,
    preset: PresetOption = None,
    define: DefineOption = None,
) -> bool:
    """Render again and again, writing JSON lines (ready, stage, image, done) for an energy meter."""
    from joulebox_render.loop import StopSignals, run_loop

    _check_target(output, ".exr")
    with StopSignals() as stop, _session(scene, _settings(set_, settings, preset), define) as session:
        stop.ends(session)
        run_loop(session, sys.stdout, max_images, max_seconds, output, lambda: stop.asked)
    return not stop.asked


@app.command()
def jobs() -> None:
    """Do one `loop` after the other in one process: a job a line of standard input, a JSON array of its arguments.

    A line `waiting` says that the next job can be told. A job that fails or is stopped ends the process, as it ends
    `loop`; so do the end of standard input and a job that leaves a great deal of memory behind.
    """
    from joulebox_render.loop import run_jobs

    command = typer.main.get_command(app)

    def one(words: list[str]) -> bool:
        return bool(command.main(["loop", *words], "joulebox-render", standalone_mode=False))

    run_jobs(sys.stdin, sys.stdout, one)


@app.command()
def plan(
    scene: SceneArgument,
    set_: SetOption = None,
    settings: FileOption = None,
    preset: PresetOption = None,
    define: DefineOption = None,
    json_: JsonOption = False,
) -> None:
    """Which stages and maps a scene needs, and why the others are left out."""
    from joulebox_render.plan import make_plan
    from joulebox_render.scene import load_scene

    needed = make_plan(load_scene(scene, read_defines(define)), _settings(set_, settings, preset))
    if json_:
        print(json.dumps({"run": needed.run, "left_out": needed.left_out}, indent=1))
        return
    table = Table("stage or map", "runs", "why not")
    for name in needed.run:
        table.add_row(name, "yes", "")
    for name, why in needed.left_out.items():
        table.add_row(name, "no", why)
    Console().print(table)


@app.command()
def schema(json_: JsonOption = True) -> None:
    """Print the JSON Schema of the settings."""
    print(json.dumps(settings_schema(), indent=1))


@app.command()
def bench(
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Markdown file to write as well.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="64x64 pixels: seconds instead of minutes.")] = False,
    json_: JsonOption = False,
) -> None:
    """Time against error of presets and path tracing, and what stages make of their rays against bare Embree."""
    from joulebox_render.bench import markdown, run_bench

    _check_target(output)
    measured = run_bench(lambda text: messages.print(text, style="dim", highlight=False), quick)
    report = markdown(measured)
    print(json.dumps(measured, indent=1) if json_ else report)
    if output:
        write_text(output, report)


@app.command("warm-up")
def warm_up() -> None:
    """Compile every kernel once; later commands start at once."""
    from joulebox_render.kernels import compilation

    if compilation.is_compiled():
        messages.print("kernels are compiled")
        return
    _compile_all()


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        print(f"joulebox-render {__version__}")
        raise typer.Exit


def _settings(assignments: list[str] | None, file: Path | None, preset: str | None) -> Settings:
    """Settings from the command line: the file over the preset, --set over both."""
    layers: list[dict[str, Any]] = [{"preset": preset}] if preset else []
    if file:
        layers.append(read_settings_file(file))
    return make_settings(*layers, parse_assignments(assignments or []))


def _check_target(path: Path | None, suffix: str = "") -> None:
    """Refuse, before the work, a file that could not be written after it."""
    if path is None:
        return
    if path.suffix.lower() != suffix and suffix:
        raise TargetError(f"{path} needs a name that ends in {suffix}")
    if path.is_dir():
        raise TargetError(f"{path} is a folder; give the name of a file to write")
    if not path.absolute().parent.is_dir():
        raise TargetError(f"{path} cannot be written: there is no folder {path.absolute().parent}; make it first")
    if not os.access(path.absolute().parent, os.W_OK):
        raise TargetError(f"{path} cannot be written: the folder {path.absolute().parent} is not writable")


def _session(scene: str, settings: Settings, define: list[str] | None) -> Any:
    """A session, after a word about compiling where that takes a while."""
    from joulebox_render.kernels import compilation

    if not compilation.is_compiled():
        _compile_all()
    from joulebox_render.session import Session

    return Session(scene, settings, read_defines(define))


def _compile_all() -> None:
    """Compile every kernel by rendering miniatures of scenes and settings that need them all."""
    from joulebox_render.kernels import compilation
    from joulebox_render.scene import list_scenes
    from joulebox_render.session import Session

    if not compilation.CACHED:
        messages.print(
            f"note: {compilation.CACHE} cannot be written, so kernels are compiled at every start (about a minute); "
            "set JOULEBOX_CACHE_DIR to a folder that can",
            highlight=False,
        )
        return
    messages.print("compiling the renderer's kernels for this machine (once, about a minute) ...", highlight=False)
    names = {entry.name for entry in list_scenes()}
    for settings in (
        {"use_shadow_photons": True}, {"importance_sampling": True, "irradiance_cache_tolerance": 0.0},
        {"photon_spacing": 0, "indirect": "direct_visualization"}, {"indirect": "path"},
    ):  # fmt: skip
        if "cornell-spheres" in names:
            with Session("cornell-spheres", make_settings(settings)):
                pass
    compilation.mark_compiled()


def _print_report(document: dict[str, Any]) -> None:
    image = document["image"]
    table = Table("stage", "time s", "CPU s", "rays", title=f"{document['scene']}  {image['width']}x{image['height']}")
    for name, row in document["stages"].items():
        table.add_row(name, f"{row['time_s']:.3f}", f"{row['cpu_s']:.3f}", f"{row['rays']:,}")
    table.add_row("image", f"{image['time_s']:.3f}", f"{image['cpu_s']:.3f}", "")
    Console().print(table)


def write_text(path: Path, text: str) -> None:
    """Write a text file; RenderError where that fails."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RenderError(f"{path} cannot be written: {error.strerror}") from None


def main() -> None:
    """Entry point: errors of ours become one sentence and an exit code."""
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except RenderError as error:
        print(f"joulebox-render: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except OSError as error:
        if not isinstance(error, BrokenPipeError):  # where the reader has gone nobody is left to tell
            where = error.filename or "standard output"
            print(f"joulebox-render: {where} cannot be used: {error.strerror}", file=sys.stderr)
        # point stdout at nothing so that the interpreter's last flush stays quiet
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
