"""`joulebox report`: sweeps as a page that needs no server."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import httpx2
import typer

from joulebox_server.cli.connection import (
    CommandError,
    DataOption,
    JsonOption,
    ServerOption,
    TokenOption,
    WrongUseError,
    checked,
    connect,
    named,
)
from joulebox_server.cli.output import print_json
from joulebox_server.errors import NotFoundError
from joulebox_server.reports.gathering import Ask, Asked, gather
from joulebox_server.reports.page import FIGURES, GENERATOR, PAGE, write
from joulebox_server.reports.sweep import TABLES, sweep_report
from joulebox_server.reports.view import SETTINGS

OWN_FOLDERS = (FIGURES, TABLES, SETTINGS)


def report(
    sweeps: Annotated[list[str], typer.Argument(help="Ids of sweeps, or names that only one has.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the page, its figures and its tables.")],
    scene: Annotated[list[str] | None, typer.Option(help="Only this scene; may be given several times.")] = None,
    device: Annotated[
        list[str] | None,
        typer.Option("--device", "--devices", help="Only this device; several times: these, side by side."),
    ] = None,
    budget_j: Annotated[float | None, typer.Option(help="Joules an image, for the recommended settings.")] = None,
    budget_s: Annotated[float | None, typer.Option(help="Seconds an image, for the recommended settings.")] = None,
    difference_limit: Annotated[
        float | None, typer.Option(help="Largest difference; the sweep's limit unless given.")
    ] = None,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write sweeps as an HTML page with figures (SVG, PNG) and tables (CSV), readable without a network.

    Sweeps with several devices, or several sweeps, set the devices side by side.
    """
    _check_folder(output)
    asked = Asked(tuple(scene or ()), tuple(device or ()), budget_j, budget_s, difference_limit)
    with connect(server, token, data).opened() as client:
        ask = _asking(client)
        findings = [gather(ask, named(sweep), asked, _tell) for sweep in dict.fromkeys(sweeps)]
    _clear(output)
    files = write(sweep_report(findings), output)
    if as_json:
        print_json({"report": str(files[0]), "files": [str(path) for path in files]})
    else:
        typer.echo(f"written to {files[0]}, with {len(files) - 1} files beside it")


def _asking(client: httpx2.Client) -> Ask:
    def ask(path: str, parameters: Mapping[str, Any]) -> bytes:
        response = client.get(f"/v1{path}", params=dict(parameters))
        try:
            return checked(response).content
        except CommandError as error:
            if response.status_code == httpx2.codes.NOT_FOUND:
                raise NotFoundError(str(error)) from None
            raise

    return ask


def _tell(what: str) -> None:
    if sys.stderr.isatty():
        typer.echo(f"reading {what}", err=True)


def _check_folder(folder: Path) -> None:
    """Raise WrongUseError for a folder with other files, whose names a report might take."""
    try:
        if folder.exists() and not folder.is_dir():
            raise WrongUseError(f"{folder} is a file; -o names a folder for the report")
        if folder.is_dir() and any(folder.iterdir()) and not _holds_report(folder):
            raise WrongUseError(f"{folder} holds other files; give a new folder, or one with an earlier report")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"the report cannot be written to {folder}: {error.strerror}") from None


def _holds_report(folder: Path) -> bool:
    try:
        with (folder / PAGE).open(encoding="utf-8", errors="replace") as page:
            return f'<meta name="generator" content="{GENERATOR}' in page.read(4000)
    except FileNotFoundError:
        return False


def _clear(folder: Path) -> None:
    """Remove what an earlier report left in the folders that are a report's own."""
    try:
        for own in OWN_FOLDERS:
            for path in (folder / own).glob("*"):
                path.unlink()
    except OSError as error:
        raise CommandError(f"the earlier report in {folder} cannot be replaced: {error.strerror}") from None
