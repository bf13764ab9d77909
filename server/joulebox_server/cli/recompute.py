"""`joulebox recompute`: differences by the metric of today."""

from typing import Annotated

import typer

from joulebox_server.cli.connection import DataOption, JsonOption, ServerOption, TokenOption, connect
from joulebox_server.cli.output import print_json


def recompute(
    sweep: Annotated[str | None, typer.Argument(help="Id or name of a sweep; all of them unless given.")] = None,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute what another version of the metric computed, or failed to; the old values stay beside the new."""
    params = {} if sweep is None else {"sweep": sweep}
    found = connect(server, token, data).json("POST", "/differences:recompute", params=params)
    if as_json:
        print_json(found)
    else:
        version = f"{found['metric']} {found['version']}"
        typer.echo(f"{found['asked']} difference(s) are computed anew by {version}; {found['kept']} are of it already")
