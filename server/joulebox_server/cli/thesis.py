"""`joulebox thesis`."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from joulebox_server.cli.connection import JsonOption, TokenOption, WrongUseError, connect
from joulebox_server.cli.output import print_json

if TYPE_CHECKING:
    from joulebox_server.thesis.batch import Batch
    from joulebox_server.thesis.study import Study

MOST_AGENTS = 8


def thesis(
    out: Annotated[Path, typer.Option("-o", "--output", help="Folder of the study; one that has begun goes on.")],
    batch: Annotated[
        list[str] | None, typer.Option(help="Only this batch; repeatable.", show_default="all of them")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="One render a configuration, CPU seconds instead of joules.")
    ] = False,
    device: Annotated[str | None, typer.Option(help="Device of the server that renders.")] = None,
    server: Annotated[
        str | None,
        typer.Option(help="Server with devices of its own.", show_default="one started here for this machine"),
    ] = None,
    source: Annotated[
        str, typer.Option(help="What this machine meters with, as joulebox-agent run takes it (exec:COMMAND, rapl).")
    ] = "auto",
    token: TokenOption = None,
    scenes: Annotated[
        Path | None, typer.Option(help="Folder of the scenes.", show_default="that of the checkout")
    ] = None,
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Render nothing; write the report of what the folder holds.")
    ] = False,
    markdown: Annotated[Path | None, typer.Option(help="Write the table of claims to this file too.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Do the study again that this project grew from: its figures, and which of its claims hold on this device."""
    # Here, because what draws charts takes seconds to import and the other commands need none of it.
    from joulebox_server.thesis import catalogue, evaluation
    from joulebox_server.thesis.local import can_meter
    from joulebox_server.thesis.study import Study

    chosen = catalogue.chosen(batch)
    if device is not None and server is None:
        server = connect(None, token).url  # a device's name means a server that runs
    if source != "auto" and (quick or server is not None):
        why = "a quick run meters nothing" if quick else "the devices of a server have sources of their own"
        raise WrongUseError(f"--source {source}: {why}; leave it out")
    if report_only:
        study = Study.found(out)
    else:
        study = Study.opened(out, quick, server, device, lambda: server is not None or can_meter(source), source)
        with _ended_by_signals():
            _run(study, chosen, token, scenes, quiet=as_json)
    written = evaluation.write(study, chosen, markdown)
    if as_json:
        print_json(written.document())
    else:
        typer.echo(written.summary())


def _run(study: "Study", chosen: "list[Batch]", token: str | None, scenes: Path | None, *, quiet: bool) -> None:
    from joulebox_server.thesis import discharge
    from joulebox_server.thesis.following import Follower
    from joulebox_server.thesis.local import Local, agent_program
    from joulebox_server.thesis.pages import tiles_of
    from joulebox_server.thesis.study import scene_folder

    folder = scene_folder(scenes)
    with contextlib.ExitStack() as stack:
        show = stack.enter_context(_progress(quiet))
        if study.server is not None:
            connection, check = connect(study.server, token), lambda: None
        else:
            agents = min(MOST_AGENTS, _cores()) if study.quick else 1
            if not study.quick and not study.metered:
                typer.echo("This machine can measure no energy, so the study rests on time.", err=True)
            local = stack.enter_context(Local(study.folder, agents, study.source if study.metered else "none"))
            connection, check = local.connection, local.check
        if not study.quick and not quiet:
            study.send_scenes(chosen, connection, folder)
            low_s, high_s = study.expected_s(chosen, connection)
            typer.echo(f"about {low_s / 3600:.1f} to {high_s / 3600:.1f} hours on one device", err=True)
        study.run(chosen, connection, folder, Follower(show, check))
        if study.results().basis == "measured":
            discharge.keep_measured(study.folder, connection, study.rows())
        elif study.results().discharge is None:
            discharge.keep_replayed(study.folder, agent_program(), folder / "cornell-boxes")
        tiles = tiles_of(study.results(), chosen)
        study.keep_pictures(connection, [tile.image_sha256 for tile in tiles])


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[int, int, str], None]]:
    """A bar on a terminal, plain lines elsewhere, nothing with --json."""
    on_terminal = sys.stderr.isatty() and not quiet
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not on_terminal) as progress:
        task = progress.add_task("thesis")
        last = ""

        def show(finished: int, total: int, doing: str) -> None:
            nonlocal last
            progress.update(task, completed=finished, total=total, description=doing)
            line = f"{finished} of {total}: {doing}"
            if not on_terminal and not quiet and line != last:
                typer.echo(line, err=True)
                last = line

        yield show


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP end the study as Ctrl-C does, and with it what it started."""
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda number, _: sys.exit(128 + number))
    yield
