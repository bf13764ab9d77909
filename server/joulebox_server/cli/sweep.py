"""`joulebox sweep ...`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from joulebox_server.cli.connection import (
    Connection,
    DataOption,
    JsonOption,
    ServerOption,
    TokenOption,
    checked,
    connect,
    named,
)
from joulebox_server.cli.output import print_json, print_table
from joulebox_server.cli.sweep_file import read_sweep, send_scenes
from joulebox_server.cli.watch import watch_sweep

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Submit sweeps and follow them.")

SweepArgument = Annotated[str, typer.Argument(help="Id of a sweep, or its name if only one has it.")]
FileArgument = Annotated[Path, typer.Argument(help="Sweep file, TOML or JSON.")]


@app.command()
def preview(
    file: FileArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """What a sweep would take. Sends its scene folders, makes nothing else."""
    found = _post(connect(server, token, data), file, "/v1/sweeps:preview", {})
    if as_json:
        print_json(found)
        return
    jobs, time_s = found["jobs"], found["time_s"]
    typer.echo(
        f"{found['configurations']} configurations, {jobs['total']} jobs on {found['devices']} device(s): "
        f"{jobs['measure']} measurements, {jobs['reference']} references, {jobs['noise_floor']} noise floors, "
        f"{jobs['control']} control runs; {jobs['metered']} of them metered"
    )
    typer.echo(f"{time_s['low'] / 3600:.2f} to {time_s['high'] / 3600:.2f} hours a device")
    energy_j = found["energy_j"]
    if energy_j is None:
        typer.echo("joules are unknown: nothing was measured on these devices yet")
    else:
        typer.echo(f"about {energy_j:.0f} J ({energy_j / 3600:.1f} Wh) at {found['power_w']:.1f} W")
        charges = found["battery_charges"]
        if charges is not None:
            full_wh = found["battery_full_j"] / 3600
            typer.echo(f"{charges:.1f} battery charges, each from 90 to 30 % of {full_wh:.0f} Wh")


@app.command()
def submit(
    file: FileArgument,
    idempotency_key: Annotated[
        str | None, typer.Option(help="Submitting again with the same key makes no second sweep.")
    ] = None,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Send scene folders named in the file, then make the sweep."""
    headers = {} if idempotency_key is None else {"Idempotency-Key": idempotency_key}
    found = _post(connect(server, token, data), file, "/v1/sweeps", headers)
    if as_json:
        print_json(found)
    else:
        typer.echo(f"sweep {found['id']} ({found['name']}): {found['jobs']['total']} jobs")


def _post(connection: Connection, file: Path, path: str, headers: dict[str, str]) -> dict[str, Any]:
    definition = read_sweep(file)
    with connection.opened() as client:
        complete = send_scenes(client, definition, file.parent)
        document: dict[str, Any] = checked(client.post(path, json=complete, headers=headers)).json()
    return document


@app.command("list")
def list_sweeps(
    limit: Annotated[int, typer.Option(min=1, max=200)] = 50,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Sweeps, the newest first."""
    found = connect(server, token, data).json("GET", "/sweeps", params={"limit": limit})
    if as_json:
        print_json(found)
        return
    print_table(
        ("id", "name", "state", "done", "failed", "made"),
        [
            (
                sweep["id"],
                sweep["name"],
                sweep["state"],
                f"{sweep['jobs']['done']}/{sweep['jobs']['total']}",
                sweep["jobs"]["failed"],
                sweep["created_at"],
            )
            for sweep in found["items"]
        ],
        "no sweep yet; `joulebox sweep submit FILE` makes one",
    )


@app.command()
def status(
    sweep: SweepArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """How far a sweep is, and why jobs failed."""
    connection = connect(server, token, data)
    found = connection.json("GET", f"/sweeps/{named(sweep)}")
    if as_json:
        print_json(found)
        return
    _print_state(found)
    jobs = connection.json("GET", f"/sweeps/{found['id']}/jobs", params={"limit": 200})["items"]
    for job in jobs:
        if job["reason"] and job["state"] != "leased":
            where = f"{job['purpose']} of {job['scene']}, repeat {job['repeat']}"
            typer.echo(f"  {job['state']}: {where}: {job['reason']}")


@app.command()
def watch(
    sweep: SweepArgument,
    timeout_s: Annotated[
        float | None, typer.Option("--timeout", min=0, help="Give up after this many seconds.")
    ] = None,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Follow a sweep until it ends; exit code 1 when it did not end well."""
    found = watch_sweep(connect(server, token, data), sweep, timeout_s, quiet=as_json)
    if as_json:
        print_json(found)
    else:
        _print_state(found)
    if found["state"] != "done":
        raise typer.Exit(1)


@app.command()
def retry(
    sweep: SweepArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Queue the failed jobs of a sweep again, and no others."""
    found = connect(server, token, data).json("POST", f"/sweeps/{named(sweep)}:retry-failed")
    if as_json:
        print_json(found)
    else:
        typer.echo(f"{found['retried']} job(s) queued again")


@app.command()
def pause(
    sweep: SweepArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Hand out no more jobs of a sweep; those being measured are finished."""
    _act(connect(server, token, data), sweep, "pause", as_json)


@app.command()
def resume(
    sweep: SweepArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Go on with a paused sweep."""
    _act(connect(server, token, data), sweep, "resume", as_json)


@app.command()
def cancel(
    sweep: SweepArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """End a sweep early; what was measured stays."""
    _act(connect(server, token, data), sweep, "cancel", as_json)


@app.command()
def delete(
    sweep: SweepArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Remove a sweep with its results and the pictures that only it used."""
    connect(server, token, data).request("DELETE", f"/sweeps/{named(sweep)}")
    if as_json:
        print_json({"deleted": sweep})
    else:
        typer.echo(f"sweep {sweep} is deleted")


def _act(connection: Connection, sweep: str, action: str, as_json: bool) -> None:
    found = connection.json("PATCH", f"/sweeps/{named(sweep)}", json={"action": action})
    if as_json:
        print_json(found)
    else:
        _print_state(found)


def _print_state(found: dict[str, Any]) -> None:
    jobs = found["jobs"]
    parts = [f"{jobs[state]} {state}" for state in ("queued", "leased", "failed", "cancelled") if jobs[state]]
    if found["differences_pending"]:
        parts.append(f"{found['differences_pending']} differences to compute")
    more = f" ({', '.join(parts)})" if parts else ""
    typer.echo(f"sweep {found['name']} is {found['state']}: {jobs['done']} of {jobs['total']} jobs done{more}")
