"""The command `joulebox`."""

import sys

import typer

from joulebox_server import __version__
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.cli import data, device, findings, sweep
from joulebox_server.cli.diff import diff
from joulebox_server.cli.recommend import recommend
from joulebox_server.cli.recompute import recompute
from joulebox_server.cli.report import report
from joulebox_server.cli.serve import serve
from joulebox_server.cli.thesis import thesis
from joulebox_server.errors import InvalidError, ServerError

FAILED, WRONG_USE, INTERRUPTED = 1, 2, 130


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


def build() -> typer.Typer:
    """The command with all its parts."""
    app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)

    @app.callback()
    def joulebox(
        version: bool = typer.Option(
            False, "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ) -> None:
        """What a picture costs in joules, and which settings give the best one for a budget."""

    for command in (
        serve,
        recommend,
        report,
        findings.tradeoff,
        findings.export,
        data.backup,
        data.restore,
        data.gc,
        diff,
        recompute,
        thesis,
    ):
        app.command()(command)
    app.add_typer(sweep.app, name="sweep")
    app.add_typer(device.app, name="device")
    app.add_typer(data.tokens, name="token")
    return app


def main() -> None:
    """Run the command: one sentence and exit code 1 (failed) or 2 (wrong use) for whatever can go wrong."""
    try:
        build()()
    except (InvalidError, AnalysisError) as error:
        _fail(str(error), WRONG_USE)
    except ServerError as error:
        _fail(str(error), FAILED)
    except BrokenPipeError:
        sys.stderr.close()  # whoever read our output has enough
        sys.exit(FAILED)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _fail(sentence: str, code: int) -> None:
    typer.echo(f"joulebox: {sentence}", err=True)
    sys.exit(code)
