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
    tls_certificate: Annotated[
        Path | None, typer.Option(help="Certificate chain (PEM): speak TLS. Needs --tls-key.")
    ] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Private key of the certificate (PEM).")] = None,
    wheels: Annotated[
        Path | None,
        typer.Option(help="Folder of wheels that devices install from.", show_default="wheels in the data folder"),
    ] = None,
    request_log: Annotated[
        Path | None,
        typer.Option(
            help="File for one JSON line a request, - for standard error.",
            show_default="requests.log in the data folder",
        ),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=64, help="Processes that compare pictures.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Run the server until Ctrl-C."""
    # Here, because the server's libraries take seconds to import and the other commands need none of them.
    from joulebox_server.cli.serving import Asked, run_server

    data_dir = data or default_data_dir()
    run_server(
        Asked(
            data_dir=data_dir,
            host=host,
            port=port,
            secret_file=enrollment_secret_file,
            tls_certificate=tls_certificate,
            tls_key=tls_key,
            wheels_dir=wheels or data_dir / "wheels",
            request_log=request_log or data_dir / "requests.log",
            workers=workers,
        ),
        as_json,
    )
