"""`joulebox device ...`."""

from typing import Annotated, Any

import typer

from joulebox_server.cli.connection import (
    DataOption,
    JsonOption,
    ServerOption,
    TokenOption,
    WrongUseError,
    connect,
    named,
)
from joulebox_server.cli.output import print_json, print_table

HEALTHS = ("good", "suspect", "maintenance", "retired")

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Enrol devices and look after them.")

DeviceArgument = Annotated[str, typer.Argument(help="Id or name of a device.")]


@app.command("list")
def list_devices(
    server: ServerOption = None, token: TokenOption = None, data: DataOption = None, as_json: JsonOption = False
) -> None:
    """Every enrolled device, the most recently seen first."""
    connection = connect(server, token, data)
    items: list[dict[str, Any]] = []
    cursor: str | None = ""
    while cursor is not None:
        found = connection.json("GET", "/devices", params={"limit": 200, **({"cursor": cursor} if cursor else {})})
        items += found["items"]
        cursor = found["next"]
    items.sort(key=lambda device: float(device["last_seen_age_s"]))
    if as_json:
        print_json({"items": items, "next": None})
        return
    print_table(
        ("id", "name", "health", "machine", "energy", "seen", "to look at"),
        [
            (
                device["id"],
                device["name"],
                device["health"],
                _machine(device["capabilities"]),
                _energy(device["capabilities"]),
                f"{device['last_seen_age_s']:.0f} s ago",
                "; ".join(flag["message"] for flag in device["flags"]),
            )
            for device in items
        ],
        "no device yet; `joulebox device enroll` makes a code for one",
    )


def _machine(capabilities: dict[str, object] | None) -> str:
    return "" if capabilities is None else f"{capabilities['os']} {capabilities['machine']}"


def _energy(capabilities: dict[str, list[dict[str, object]]] | None) -> str:
    methods = capabilities["energy_methods"] if capabilities else []
    return ", ".join(str(method["method"]) for method in methods if method["available"]) or "none"


@app.command()
def enroll(
    name: Annotated[str | None, typer.Option(help="Note for the list of codes.")] = None,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a one-time code; print the command to run on the device within 15 minutes."""
    connection = connect(server, token, data)
    found = connection.json("POST", "/enrollments", json={"name": name})
    if as_json:
        command = f"joulebox-agent enroll --server {connection.url} --code {found['code']}"
        print_json({**found, "server": connection.url, "command": command})
        return
    typer.echo(f"code {found['code']}, good for one device until {found['expires_at']}; on the device run:")
    typer.echo(found["join"])


@app.command("token")
def rotate_token(
    device: DeviceArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a new token for a device and print it, this once; the old one ends."""
    found = connect(server, token, data).json("POST", f"/devices/{named(device)}/token")
    if as_json:
        print_json(found)
    else:
        typer.echo(found["token"])


@app.command()
def disagreements(
    device: DeviceArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Pictures of a device that differ from what another made of the same settings, the newest 200."""
    found = connect(server, token, data).json("GET", f"/devices/{named(device)}/disagreements", params={"limit": 200})
    if as_json:
        print_json(found)
        return
    print_table(
        ("scene", "settings", "device", "class", "other device", "class", "p99 JND"),
        [
            (
                check["scene"],
                " ".join(f"{name}={value}" for name, value in check["settings"].items()),
                check["device"],
                check["render_class"],
                check["other_device"],
                check["other_render_class"],
                "other pixels" if check["p99_jnd"] is None else f"{check['p99_jnd']:.2f}",
            )
            for check in found["items"]
        ],
        "its pictures agree with those of every other device",
    )


@app.command()
def revoke(
    device: DeviceArgument,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Shut a device out; what it measured stays."""
    connect(server, token, data).request("DELETE", f"/devices/{named(device)}")
    if as_json:
        print_json({"revoked": device})
    else:
        typer.echo(f"device {device} is shut out")


@app.command()
def health(
    device: DeviceArgument,
    value: Annotated[str, typer.Argument(help=f"One of {', '.join(HEALTHS)}.")],
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Set a device's health; suspect, in maintenance or retired it gets no jobs, and `good` clears it."""
    if value not in HEALTHS:
        raise WrongUseError(f"a device's health is one of {', '.join(HEALTHS)}, not {value!r}")
    found = connect(server, token, data).json("PATCH", f"/devices/{named(device)}", json={"health": value})
    if as_json:
        print_json(found)
    else:
        typer.echo(f"device {found['name']} is {found['health']}")
