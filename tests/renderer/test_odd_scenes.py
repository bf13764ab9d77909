"""Scenes that are legal and make no sense: finite pictures, no warnings, and an end."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

FLOOR = '<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform>'
FLOOR += "</shape>"
GLASS = '<bsdf type="dielectric"><float name="int_ior" value="1.5"/></bsdf>'
AREA = '<emitter type="area"><rgb name="radiance" value="{}"/></emitter>'
# A camera at the origin looks along -z; things stand there.
BALL = '<shape type="sphere"><point name="center" x="{x}" y="0" z="{z}"/><float name="radius" value="{r}"/>'
BALL += "{inside}</shape>"
NEEDLE = (
    '<emitter type="spot"><float name="cutoff_angle" value="0.01"/><float name="beam_width" value="0.001"/></emitter>'
)


def ball(r: float, inside: str = "", x: float = 0.0, z: float = -3.0) -> str:
    return BALL.format(r=r, inside=inside, x=x, z=z)


def lamp(side: float, radiance: str = "5") -> str:
    """A square lamp under the ceiling that there would be."""
    return (
        f'<shape type="rectangle"><transform name="to_world"><scale value="{side}"/><rotate x="1" angle="90"/>'
        f'<translate y="1.5" z="-3"/></transform>{AREA.format(radiance)}</shape>'
    )


ROOM = '<shape type="cube"><boolean name="flip_normals" value="true"/><transform name="to_world"><scale value="{}"/>'
ROOM += '</transform><bsdf type="diffuse"><rgb name="reflectance" value="{}"/></bsdf></shape>'
SCENES: dict[str, str] = {
    "a lamp alone": ball(1, AREA.format(5)),
    "the camera inside a lamp": ball(1, AREA.format(5), z=0),
    "the camera inside glass": ball(1, GLASS, z=0) + ball(0.5, AREA.format(5)),
    "a lamp inside glass": ball(1, GLASS) + ball(0.3, AREA.format(5)) + ROOM.format(5, 0.5),
    "twenty balls of glass in one another": "".join(ball(1 - 0.04 * i, GLASS) for i in range(20)) + lamp(0.5) + FLOOR,
    "things in the same place": FLOOR + FLOOR + lamp(0.5) + lamp(0.5),
    "a lamp of a micrometre": lamp(1e-6) + ROOM.format(4, 0.5),
    "a lamp as bright as single precision": lamp(0.5, "1e30") + ROOM.format(4, 0.5),
    "a lamp that hardly shines": lamp(0.5, "1e-30") + ROOM.format(4, 0.5),
    "a room that absorbs nothing": lamp(0.5) + ROOM.format(4, 1.0),
    "a room that reflects nothing": lamp(0.5) + ROOM.format(4, 0.0),
    "a lamp that shines away": FLOOR + ball(0.5, AREA.format(5) + '<boolean name="flip_normals" value="true"/>'),
    "a thousand times as large": lamp(500) + ROOM.format(4000, 0.5),
    "a millionth of the size": lamp(5e-7, "5") + ROOM.format(4e-6, 0.5),
    "far from the origin": ball(1, AREA.format(5), x=1e6) + FLOOR,
    "glass that hardly refracts": ball(1, GLASS.replace("1.5", "1")) + lamp(0.5) + FLOOR,
    "glass like none": ball(1, GLASS.replace("1.5", "1e9")) + lamp(0.5) + FLOOR,
    "a spot as narrow as a needle": FLOOR + NEEDLE,
}
SMALL: dict[str, Any] = {
    "width": 8, "height": 8, "samples_per_pixel": 2, "shadow_rays": 2, "global_photons": 500, "caustic_photons": 200,
    "final_gather_rays": 9, "direct_photons": 200,
}  # fmt: skip
METHODS: dict[str, dict[str, Any]] = {
    "paths": {"indirect": "path"},
    "gathered and cached": {"irradiance_cache_tolerance": 0.8, "photon_spacing": 4, "sampler": "sobol"},
    "gathered, all else": {"photon_spacing": 0, "importance_sampling": True, "use_shadow_photons": True},
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_a_picture_of_finite_radiance(
    make_scene: Callable[..., Path], render: Callable[..., Any], name: str, method: str
) -> None:
    """Warnings are errors, so overflows and invalid values would show; pytest would show a hang."""
    pixels = render(make_scene(SCENES[name]), **SMALL, **METHODS[method]).pixels
    assert np.isfinite(pixels).all()
    assert (pixels >= 0).all()
