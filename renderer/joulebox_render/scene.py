"""Scenes: finding them by path or name, and reading Mitsuba 3 XML into a Scene."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from joulebox_render.errors import SceneError
from joulebox_render.records import ENVIRONMENT, F8, Scene
from joulebox_render.scene_assembly import assemble
from joulebox_render.scene_bsdfs import MaterialTable
from joulebox_render.scene_camera import read_sensor
from joulebox_render.scene_lights import Light, light_table, read_light, surround
from joulebox_render.scene_shapes import SceneFolder, ShapeReader
from joulebox_render.scene_xml import Element, parse_xml, resolve_defines, suggest

_NO_DEFINES: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class SceneEntry:
    """A scene shipped with the renderer: its name, its folder, and the heading of its README."""

    name: str
    path: Path
    title: str


def list_scenes() -> list[SceneEntry]:
    """The scenes shipped with the renderer, by name."""
    folder = _shipped_folder()
    found = sorted(folder.glob("*/scene.xml")) if folder else []
    return [SceneEntry(file.parent.name, file.parent, _title(file.parent)) for file in found]


def _shipped_folder() -> Path | None:
    """Inside the installed package, else in the checkout that the package is part of."""
    package = Path(__file__).resolve().parent
    for folder in (package / "scenes", package.parents[1] / "scenes"):
        if folder.is_dir():
            return folder
    return None


def _title(folder: Path) -> str:
    readme = folder / "README.md"
    lines = readme.read_text(encoding="utf-8").splitlines() if readme.is_file() else []
    return next((line.removeprefix("# ").strip() for line in lines if line.startswith("# ")), folder.name)


def find_scene(path: Path | str) -> Path:
    """The scene file that `path` means: a folder's scene.xml, an .xml file, or a shipped scene by name."""
    given = Path(path)
    try:
        if (given / "scene.xml").is_file():
            return given / "scene.xml"
        if given.suffix == ".xml" and given.is_file():
            return given
        exists = given.exists()
    except (OSError, ValueError):
        exists = False
    shipped = {entry.name: entry.path for entry in list_scenes()}
    if str(path) in shipped:
        return shipped[str(path)] / "scene.xml"
    if exists:
        wrong = "has no scene.xml inside" if given.is_dir() else "is not an .xml file"
        raise SceneError(f"scene {str(path)!r} {wrong}; give a folder with scene.xml, an .xml file, or a scene's name")
    raise SceneError(
        f"there is no scene {str(path)!r}; give a folder with scene.xml, an .xml file, or a scene's name"
        f"{suggest(str(path), shipped)}"
    )


def load_scene(path: Path | str, defines: Mapping[str, str] = _NO_DEFINES) -> Scene:
    """Read a scene.

    path      a folder with scene.xml, an .xml file, or the name of a scene shipped with the renderer
    defines   values for the $names of the file; they win over its <default>s
    Raises SceneError, naming file and line, for anything that is wrong or not supported.
    """
    file = find_scene(path)
    try:
        data = file.read_bytes()
    except OSError as error:
        raise SceneError(f"cannot read {file}: {error.strerror}") from None
    root = parse_xml(data, str(file))
    resolved = resolve_defines(root, defines)
    digest = hashlib.sha256(hashlib.sha256(data).digest())
    digest.update(hashlib.sha256(json.dumps(resolved, sort_keys=True).encode()).digest())
    objects_by_id = _objects_by_id(root)
    notes = _check_top_level(root)
    camera, width, height = read_sensor(_only_sensor(root), objects_by_id, notes)
    materials = MaterialTable(objects_by_id)
    reader = ShapeReader(objects_by_id, SceneFolder(file.parent, digest), materials)
    geometry = assemble([reader.read(shape) for shape in _children(root, "shape")], notes)
    if not len(geometry.material):
        raise root.error("the scene has no geometry; add a <shape>")
    materials.check(_children(root, "bsdf"))
    lights = geometry.lights + _lone_lights(root, objects_by_id, geometry.corners, notes)
    if not lights:
        raise root.error(
            "the scene has no light; put an area <emitter> into a shape, or add a point, spot or constant light"
        )
    return Scene(
        name=file.resolve().parent.name if file.name == "scene.xml" else file.stem,
        folder=file.parent,
        sha256=digest.hexdigest(),
        camera=camera,
        film_width=width,
        film_height=height,
        vertices=geometry.vertices,
        triangles=geometry.triangles,
        corner_normals=geometry.corner_normals,
        face_normals=geometry.face_normals,
        analytic_kind=geometry.analytic_kind,
        analytic_center=geometry.analytic_center,
        analytic_normal=geometry.analytic_normal,
        analytic_radius=geometry.analytic_radius,
        material=geometry.material,
        light=geometry.light,
        materials=materials.table(),
        lights=light_table(lights),
        notes=tuple(notes),
    )


def _children(root: Element, tag: str) -> list[Element]:
    return [child for child in root.children if child.tag == tag]


def _lone_lights(root: Element, objects_by_id: Mapping[str, Element], corners: F8, notes: list[str]) -> list[Light]:
    """The point, spot and constant lights that emit anything."""
    lights: list[Light] = []
    for element in _children(root, "emitter"):
        light = read_light(element, objects_by_id)
        if light.kind == ENVIRONMENT:
            if any(other.kind == ENVIRONMENT for other in lights):
                raise element.error("the scene has a constant light already; keep one")
            light = surround(light, corners)
        if light.power.any():
            lights.append(light)
        else:
            notes.append(f"line {element.line}: the {element.type} light has intensity 0 and is left out.")
    return lights


def _objects_by_id(root: Element) -> dict[str, Element]:
    found: dict[str, Element] = {}
    for element in root.walk():
        name = element.attributes.get("id")
        if name is None or element.tag == "ref":
            continue
        if name in found:
            raise element.error(f'id "{name}" is already used on line {found[name].line}; ids must differ')
        found[name] = element
    return found


def _check_top_level(root: Element) -> list[str]:
    """Refuse what cannot stand directly in a scene; returns notes on what is ignored there."""
    notes = []
    known = ("bsdf", "default", "emitter", "integrator", "sensor", "shape")
    for child in root.children:
        if child.tag == "integrator":
            notes.append(f'line {child.line}: integrator "{child.type}" is ignored; the method is a setting.')
        elif child.tag not in known:
            raise child.error(f"<{child.tag}> cannot stand directly in <scene>{suggest(child.tag, known)}")
    return notes


def _only_sensor(root: Element) -> Element:
    sensors = _children(root, "sensor")
    if not sensors:
        raise root.error('the scene has no sensor; add <sensor type="perspective">')
    if len(sensors) > 1:
        raise sensors[1].error(f"the scene has {len(sensors)} sensors, the first on line {sensors[0].line}; keep one")
    return sensors[0]
