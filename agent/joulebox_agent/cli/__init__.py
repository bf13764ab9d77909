"""The command `joulebox-agent`: exit code 0 good, 1 failed, 2 wrong use; failures are one sentence."""

import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from types import FrameType

import typer

from joulebox_agent import __version__
from joulebox_agent.cli.calibrate import calibrate
from joulebox_agent.cli.doctor import doctor
from joulebox_agent.cli.fleet import enroll, install_service, run, status
from joulebox_agent.cli.measure import measure
from joulebox_agent.errors import AgentError

app = typer.Typer(
    name="joulebox-agent",
    help="Measures what a picture costs in joules on this machine.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (doctor, measure, calibrate, enroll, run, status, install_service):
    app.command()(command)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(__version__)
        raise typer.Exit()


@app.callback()
def _options(
    version: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Print the version."),
) -> None:
    pass


@contextlib.contextmanager
def _ended_in_order() -> Iterator[None]:
    """The signals that end a program unwind it as Ctrl-C does: its renderer is stopped, its folder removed, a battery
    that drains on its cable charged again. One that is ignored (nohup) stays ignored."""

    def end(number: int, frame: FrameType | None) -> None:
        sys.exit(128 + number)

    known = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    taken = [number for number in known if signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def main() -> None:
    """Entry point of the command."""
    try:
        try:
            with _ended_in_order():
                app()
        finally:
            sys.stdout.flush()
    except AgentError as error:
        print(f"joulebox-agent: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(130)
    except OSError as error:
        if not isinstance(error, BrokenPipeError):  # where the reader has gone nobody is left to tell
            where = error.filename or "standard output"
            print(f"joulebox-agent: {where} cannot be used: {error.strerror}.", file=sys.stderr)
        # point stdout at nothing so that the interpreter's last flush stays quiet
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
