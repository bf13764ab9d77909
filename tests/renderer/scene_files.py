"""Small scene files for the tests of the scene reader."""

from __future__ import annotations

from pathlib import Path

import pytest
from joulebox_render.errors import SceneError
from joulebox_render.records import Scene
from joulebox_render.scene import load_scene

SENSOR = '<sensor type="perspective"><float name="fov" value="40"/></sensor>\n'
LAMP = '<emitter type="point"/>\n'
SHAPE = '<shape type="cube"/>\n'
# Line 1 is <scene>, 2 the sensor, 3 the light, 4 a shape; what a test of errors adds starts on line 5.
FIRST_LINE = 5


def load(folder: Path, body: str, *, sensor: str = SENSOR, lamp: str = LAMP, **defines: str) -> Scene:
    """Load a scene whose file holds `body` besides a sensor and a light."""
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">{sensor}{lamp}{body}</scene>')
    return load_scene(folder, defines)


def refused(path: Path | str, **defines: str) -> str:
    """The error of a scene, checked to be one sentence that ends the program with code 2."""
    with pytest.raises(SceneError) as caught:
        load_scene(path, defines)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 700
    assert caught.value.exit_code == 2
    return text


def message(folder: Path, body: str, **defines: str) -> str:
    """The error of a scene that is good but for `body`, which starts on FIRST_LINE."""
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">\n{SENSOR}{LAMP}{SHAPE}{body}\n</scene>')
    return refused(folder, **defines)


def shape(inside: str, kind: str = "rectangle") -> str:
    """A shape with children."""
    return f'<shape type="{kind}">{inside}</shape>'


def bsdf(inside: str, kind: str = "diffuse") -> str:
    """A rectangle with a bsdf."""
    return shape(f'<bsdf type="{kind}">{inside}</bsdf>')


def moved(step: str, kind: str = "rectangle") -> str:
    """A shape with a to_world transform."""
    return shape(f'<transform name="to_world">{step}</transform>', kind)
