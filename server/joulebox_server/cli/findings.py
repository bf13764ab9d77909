"""`joulebox recommend`, `tradeoff` and `export`."""

from pathlib import Path
from typing import Annotated, Any

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
)
from joulebox_server.cli.output import print_json, print_table, quantity

FORMATS = ("csv", "parquet", "json", "ndjson")

SweepArgument = Annotated[str, typer.Argument(help="Id of a sweep, or its name if only one has it.")]
SceneOption = Annotated[str | None, typer.Option(help="Scene of the sweep; its first unless given.")]
DeviceOption = Annotated[str | None, typer.Option(help="Device of the sweep; its first unless given.")]


def recommend(
    sweep: SweepArgument,
    budget_j: Annotated[float | None, typer.Option(help="Joules an image.")] = None,
    budget_s: Annotated[float | None, typer.Option(help="Seconds an image.")] = None,
    budget_wh: Annotated[float | None, typer.Option(help="Watt-hours for all --images.")] = None,
    images: Annotated[int | None, typer.Option(help="How many images --budget-wh is for.")] = None,
    scene: SceneOption = None,
    device: DeviceOption = None,
    difference_limit: Annotated[
        float | None, typer.Option(help="Largest difference; the sweep's limit unless given.")
    ] = None,
    confidence: Annotated[float, typer.Option(help="Of the bounds that must hold.")] = 0.95,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Settings that meet a budget, as measured; without a budget the cheapest acceptable ones."""
    given = {
        "budget_j": budget_j,
        "budget_s": budget_s,
        "budget_wh": budget_wh,
        "images": images,
        "scene": scene,
        "device": device,
        "difference_limit": difference_limit,
        "confidence": confidence,
    }
    params = {name: value for name, value in given.items() if value is not None}
    found = connect(server, token, data).json("GET", f"/sweeps/{sweep}/recommendation", params=params)
    if as_json:
        print_json(found)
    else:
        _print_recommendation(found)


def _print_recommendation(found: dict[str, Any]) -> None:
    if found["answer"] == "none":
        typer.echo(f"no setting meets this for {found['scene']} on {found['device']}")
    else:
        typer.echo(f"for {found['scene']} on {found['device']}: {found['label']}")
        typer.echo(f"  energy      {_energy(found)}")
        typer.echo(f"  time        {quantity(found['time_s'], 's')} an image")
        typer.echo(f"  difference  {quantity(found['difference'], '')}, limit {found['limit']:.4g}")
        if found["saves_share"] is not None:
            typer.echo(f"  saves       {found['saves_share']:.0%} of the reference")
        if found["fragile"]:
            typer.echo(f"  fragile     {found['fragile']}")
    for reason in found["why"]:
        typer.echo(f"  - {reason}")
    if found["runner_up"]:
        typer.echo(f"runner-up: {found['runner_up']['label']}")
    for choice in found["nearest"]:
        typer.echo(f"nearest: {choice['label']}: {choice['misses']}")


def _energy(found: dict[str, Any]) -> str:
    told = f"{quantity(found['energy_j'], 'J')} an image"
    # Anything that was not measured says so wherever it is printed.
    return told if found["energy_quality"] == "measured" else f"{told} [{found['energy_quality']}]"


def tradeoff(
    sweep: SweepArgument,
    scene: SceneOption = None,
    device: DeviceOption = None,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Cost and difference of every configuration."""
    params = {name: value for name, value in (("scene", scene), ("device", device)) if value is not None}
    found = connect(server, token, data).json("GET", f"/sweeps/{sweep}/tradeoff", params=params)
    if as_json:
        print_json(found)
        return
    quality = found["energy_quality"]
    typer.echo(
        f"{found['scene']} on {found['device'] or 'no device yet'}; energy: {quality}; limit {found['limit']:.4g}"
    )
    axis = "time_s" if quality == "time_only" else "energy_j"
    print_table(
        ("settings", "J an image", "s an image", "difference", "acceptable", "on front"),
        [
            (
                point["label"],
                quantity(point["energy_j"], ""),
                quantity(point["time_s"], ""),
                quantity(point["difference"], ""),
                {True: "yes", False: "no", None: "unknown"}[point["acceptable"]],
                "yes" if point["on_front"][axis] else "",
            )
            for point in found["points"]
        ],
        "nothing has been measured yet",
    )


def export(
    sweep: Annotated[str | None, typer.Option(help="Only this sweep.")] = None,
    file_format: Annotated[str, typer.Option("--format", help=f"One of {', '.join(FORMATS)}.")] = "csv",
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File; standard output unless given.")] = None,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """All results as CSV, Parquet, JSON or lines of JSON; --json is --format json."""
    wanted = "json" if as_json else file_format
    if wanted not in FORMATS:
        raise WrongUseError(f"the format is one of {', '.join(FORMATS)}, not {wanted!r}")
    if wanted == "parquet" and output is None:
        raise WrongUseError("a Parquet file needs a name: give one with -o")
    # The server sends lines; one JSON document is made of them here.
    params = {"format": "ndjson" if wanted == "json" else wanted} | ({} if sweep is None else {"sweep": sweep})
    with connect(server, token, data).opened() as client:
        content = checked(client.get("/v1/results", params=params)).content
    if wanted == "json":
        content = b"[" + b",\n".join(content.splitlines()) + b"]\n"
    if output is None:
        typer.echo(content.decode(), nl=False)
        return
    try:
        output.write_bytes(content)
    except OSError as error:
        raise CommandError(f"the results cannot be written to {output}: {error.strerror}") from None
    if not as_json:
        typer.echo(f"written to {output}")
