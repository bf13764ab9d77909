"""The commands `joulebox-render scenes ...`, and how a scene is named on every command line."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from joulebox_render.errors import SettingsError

scenes_app = typer.Typer(no_args_is_help=True, help="The scenes shipped with the renderer, and checks of others.")

SceneArgument = Annotated[str, typer.Argument(help="Folder with scene.xml, an .xml file, or a shipped scene's name.")]
DefineOption = Annotated[list[str] | None, typer.Option("-D", metavar="NAME=VALUE", help="A scene parameter.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@scenes_app.command("list")
def scenes_list(json_: JsonOption = False) -> None:
    """The shipped scenes."""
    from joulebox_render.scene import list_scenes

    entries = list_scenes()
    if json_:
        print(json.dumps([{"name": e.name, "path": str(e.path), "title": e.title} for e in entries], indent=1))
        return
    table = Table("scene", "what it is")
    for entry in entries:
        table.add_row(entry.name, entry.title)
    Console().print(table)


@scenes_app.command("show")
def scenes_show(scene: SceneArgument, define: DefineOption = None, json_: JsonOption = False) -> None:
    """What a scene holds."""
    from joulebox_render.scene import load_scene

    loaded = load_scene(scene, read_defines(define))
    facts: dict[str, Any] = {
        "scene": loaded.name, "folder": str(loaded.folder), "scene_sha256": loaded.sha256,
        "width": loaded.film_width, "height": loaded.film_height, "triangles": len(loaded.triangles),
        "spheres_and_disks": len(loaded.analytic_kind), "materials": len(loaded.materials.kind),
        "lights": len(loaded.lights.kind), "light_power_w": loaded.lights.power.sum(axis=0).tolist(),
        "notes": list(loaded.notes),
    }  # fmt: skip
    if json_:
        print(json.dumps(facts, indent=1))
        return
    table = Table(show_header=False)
    for name, value in facts.items():
        table.add_row(name, "\n".join(value) if name == "notes" else str(value))
    Console().print(table)


@scenes_app.command("check")
def scenes_check(scene: SceneArgument, define: DefineOption = None, json_: JsonOption = False) -> None:
    """Whether a scene can be rendered; says what is wrong, where, and what would be right."""
    from joulebox_render.scene import load_scene

    loaded = load_scene(scene, read_defines(define))
    if json_:
        print(json.dumps({"scene": loaded.name, "usable": True, "notes": list(loaded.notes)}, indent=1))
        return
    print(f"{loaded.name} can be rendered")
    for note in loaded.notes:
        print(f"note: {note}")


def read_defines(assignments: list[str] | None) -> dict[str, str]:
    """Scene parameters from `-D name=value` texts."""
    pairs = [text.partition("=") for text in assignments or []]
    for name, equals, _ in pairs:
        if not name or not equals:
            raise SettingsError(f"'-D {name}' is not of the form name=value, such as -D detail=948")
    return {name: value for name, _, value in pairs}
