"""`joulebox serve`."""

from pathlib import Path
from typing import Annotated

import typer

from joulebox_server.cli.connection import DataOption, JsonOption, default_data_dir


def serve(
    host: Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0 for every network.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 takes a free one.")] = 8473,
    data: DataOption = None,
    enrollment_secret_file: Annotated[
        Path | None,
        typer.Option(help="File with a secret that enrols devices, instead of one-time codes."),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=64, help="Processes that compare pictures.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Run the server until Ctrl-C."""
    # Here, because the server's libraries take seconds to import and the other commands need none of them.
    from joulebox_server.cli.serving import run_server

    run_server(data or default_data_dir(), host, port, enrollment_secret_file, workers, as_json)
