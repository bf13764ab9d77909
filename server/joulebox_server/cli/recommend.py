"""`joulebox recommend`: settings for a budget."""

from typing import Annotated, Any

import typer

from joulebox_server.cli.connection import (
    Connection,
    DataOption,
    JsonOption,
    ServerOption,
    TokenOption,
    connect,
    named,
)
from joulebox_server.cli.findings import DeviceOption, SceneOption, SweepArgument
from joulebox_server.cli.output import print_json, quantity


def recommend(
    sweep: SweepArgument,
    budget_j: Annotated[float | None, typer.Option(help="Joules an image.")] = None,
    budget_s: Annotated[float | None, typer.Option(help="Seconds an image.")] = None,
    budget_wh: Annotated[float | None, typer.Option(help="Watt-hours for all --images.")] = None,
    battery_percent: Annotated[
        float | None, typer.Option(help="Percent of the device's full battery for all --images, or for one.")
    ] = None,
    images: Annotated[int | None, typer.Option(help="How many images share the budget.")] = None,
    scene: SceneOption = None,
    device: DeviceOption = None,
    difference_limit: Annotated[
        float | None, typer.Option(help="Largest difference; the sweep's limit unless given.")
    ] = None,
    confidence: Annotated[float, typer.Option(help="Of each bound that must hold.")] = 0.95,
    predict: Annotated[
        bool, typer.Option("--predict", help="Let combinations that were never measured answer too.")
    ] = False,
    confirm: Annotated[
        int | None, typer.Option(min=1, max=50, help="Queue runs of so many settings that promise more.")
    ] = None,
    server: ServerOption = None,
    token: TokenOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Settings that meet a budget by their upper bounds; without a budget the cheapest acceptable ones."""
    given: dict[str, Any] = {
        "budget_j": budget_j,
        "budget_s": budget_s,
        "budget_wh": budget_wh,
        "battery_percent": battery_percent,
        "images": images,
        "scene": scene,
        "device": device,
        "difference_limit": difference_limit,
        "confidence": confidence,
        "predict": "true" if predict else None,
    }
    params = {name: value for name, value in given.items() if value is not None}
    connection = connect(server, token, data)
    path = f"/sweeps/{named(sweep)}/recommendation"
    found = connection.json("GET", path, params=params)
    if confirm is not None:
        found["queued_jobs"] = _queued(connection, path, params, confirm)
    if as_json:
        print_json(found)
        return
    _print_recommendation(found)
    if confirm is not None:
        typer.echo(f"{found['queued_jobs']} job(s) queued; ask again once they are measured")


def _queued(connection: Connection, path: str, params: dict[str, Any], count: int) -> int:
    answer = connection.json("POST", f"{path}:confirm", params=params, json={"count": count})
    return int(answer["queued_jobs"])


def _print_recommendation(found: dict[str, Any]) -> None:
    if found["answer"] == "none":
        typer.echo(f"no setting meets this for {found['scene']} on {found['device']}")
    else:
        basis = "" if found["basis"] == "measured" else " [predicted, never measured]"
        typer.echo(f"for {found['scene']} on {found['device']}: {found['label']}{basis}")
        if found["energy_j"] is not None:
            typer.echo(f"  energy      {_energy(found)}")
        if found["time_s"] is not None:
            typer.echo(f"  time        {quantity(found['time_s'], 's')} an image")
        typer.echo(f"  difference  {quantity(found['difference'], '')}, limit {found['limit']:.4g}")
        if found["saves_share"] is not None:
            typer.echo(f"  saves       {found['saves_share']:.0%} of the reference")
        if found["fragile"]:
            typer.echo(f"  fragile     {found['fragile']}")
    for reason in found["why"]:
        typer.echo(f"  - {reason}")
    for step in found["steps"]:
        typer.echo(f"  {_step(step)}")
    if found["runner_up"]:
        typer.echo(f"runner-up: {found['runner_up']['label']}")
    for choice in found["nearest"]:
        typer.echo(f"nearest: {choice['label']}: {choice['misses']}")
    for choice in found["proposals"]:
        told = "never measured" if choice["basis"] == "predicted" else "not known well enough"
        typer.echo(f"promises more, {told}: {choice['label']}: difference {quantity(choice['difference'], '')}")


def _step(step: dict[str, Any]) -> str:
    """What one setting changed to its next value would do, as measured."""
    told = f"step to {step['setting']}={step['end']}:"
    if step["same_picture"]:
        told += " the very same picture,"
    cost = "of unknown cost" if step["cost_ratio"] is None else f"{step['cost_ratio']:.3g} times the cost"
    if step["difference_end"] is None:
        return f"{told} {cost}"
    slope = "" if step["slope"] is None else f", slope {step['slope']:.2g}"
    return f"{told} {cost}, difference {step['difference_end']:.4g}{slope}{', a cliff' if step['cliff'] else ''}"


def _energy(found: dict[str, Any]) -> str:
    told = f"{quantity(found['energy_j'], 'J')} an image"
    # Anything that was not measured says so wherever it is printed.
    return told if found["energy_quality"] == "measured" else f"{told} [{found['energy_quality']}]"
