"""The bsdfs and lights that load_scene makes of a scene."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from joulebox_render.records import (
    BLACK,
    DIFFUSE,
    DISK_LIGHT,
    GLASS,
    MESH_LIGHT,
    MIRROR,
    POINT_LIGHT,
    SPHERE_LIGHT,
    SPOT_LIGHT,
)
from scene_files import load


def read_bsdf(folder: Path, text: str) -> tuple[int, list[float], float, int]:
    """(kind, albedo, ior, two_sided) of a bsdf."""
    materials = load(folder, f'<shape type="rectangle">{text}</shape>').materials
    assert len(materials.kind) == 1
    albedo = [float(value) for value in materials.albedo[0]]
    return int(materials.kind[0]), albedo, float(materials.ior[0]), int(materials.two_sided[0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", (DIFFUSE, [0.5] * 3, 1.0, 0)),
        ('<bsdf type="diffuse"/>', (DIFFUSE, [0.5] * 3, 1.0, 0)),
        ('<bsdf type="diffuse"><rgb name="reflectance" value="0.25"/></bsdf>', (DIFFUSE, [0.25] * 3, 1.0, 0)),
        (
            '<bsdf type="diffuse"><rgb name="reflectance" value="0,0.5,1"/></bsdf>',
            (DIFFUSE, [0, 0.5, 1], 1.0, 0),
        ),
        (
            '<bsdf type="diffuse"><rgb name="reflectance" value=" .5, 5e-1 1. "/></bsdf>',
            (DIFFUSE, [0.5, 0.5, 1], 1, 0),
        ),
        (
            '<bsdf type="diffuse"><rgb name="reflectance" value="#ff0080"/></bsdf>',
            (DIFFUSE, [1, 0, 0.2158605], 1, 0),
        ),
        (
            '<bsdf type="diffuse"><spectrum name="reflectance" value="0.25"/></bsdf>',
            (DIFFUSE, [0.25] * 3, 1.0, 0),
        ),
        (
            '<bsdf type="diffuse"><float name="reflectance" value="0.25"/></bsdf>',
            (DIFFUSE, [0.25] * 3, 1.0, 0),
        ),
        ('<bsdf type="diffuse"><rgb name="reflectance" value="0 0 0"/></bsdf>', (BLACK, [0.0] * 3, 1.0, 0)),
        ('<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>', (DIFFUSE, [0.5] * 3, 1.0, 1)),
        ('<bsdf type="conductor"/>', (MIRROR, [1.0] * 3, 1.0, 0)),
        (
            '<bsdf type="conductor"><string name="material" value="none"/>'
            '<rgb name="specular_reflectance" value="0.9"/></bsdf>',
            (MIRROR, [0.9] * 3, 1.0, 0),
        ),
        ('<bsdf type="dielectric"/>', (GLASS, [1.0] * 3, 1.5046 / 1.000277, 0)),
        (
            '<bsdf type="dielectric"><string name="int_ior" value="water"/><float name="ext_ior" value="1"/></bsdf>',
            (GLASS, [1.0] * 3, 1.333, 0),
        ),
        (
            '<bsdf type="dielectric"><float name="int_ior" value="1"/><string name="ext_ior" value="diamond"/></bsdf>',
            (GLASS, [1.0] * 3, 1.0 / 2.419, 0),
        ),
    ],
)
def test_bsdf(tmp_path: Path, text: str, expected: tuple[int, list[float], float, int]) -> None:
    kind, albedo, ior, two_sided = read_bsdf(tmp_path, text)
    assert (kind, two_sided) == (expected[0], expected[3])
    assert albedo == pytest.approx(expected[1], abs=1e-6)
    assert ior == pytest.approx(expected[2], rel=1e-6)


def test_shapes_share_the_row_of_a_referred_bsdf(tmp_path: Path) -> None:
    """One row a bsdf, before or after the shapes; a bsdf without shapes has none."""
    shape = '<shape type="rectangle"><ref id="grey"/></shape>'
    scene = load(
        tmp_path,
        f'{shape}{shape}<shape type="disk"><ref name="bsdf" id="grey"/></shape>'
        '<bsdf type="diffuse" id="grey"/><bsdf type="dielectric" id="unused"/>',
    )
    assert scene.materials.kind.tolist() == [DIFFUSE]
    assert scene.material.tolist() == [0] * 5


def test_a_light_without_bsdf_is_black(tmp_path: Path) -> None:
    scene = load(tmp_path, '<shape type="rectangle"><emitter type="area"/></shape><shape type="rectangle"/>')
    assert scene.materials.kind[scene.material].tolist() == [BLACK, BLACK, DIFFUSE, DIFFUSE]


def test_flat_lights_keep_a_right_handed_frame(tmp_path: Path) -> None:
    """edge_u x edge_v points along the normal, also when mirrored or flipped; corners span the area."""
    for transform in ("", '<scale x="-1"/>', '<scale z="-2"/>'):
        for flip in ("false", "true"):
            for kind in ("rectangle", "disk"):
                text = (
                    f'<shape type="{kind}"><boolean name="flip_normals" value="{flip}"/>'
                    f'<transform name="to_world">{transform}<translate z="3"/></transform>'
                    '<emitter type="area"/></shape>'
                )
                lights = load(tmp_path, text, lamp="").lights
                crossed = np.cross(lights.edge_u[0], lights.edge_v[0])
                np.testing.assert_allclose(crossed, lights.normal[0], atol=1e-6)
                np.testing.assert_allclose(lights.position[0], [0.0, 0.0, 3.0], atol=1e-6)
                assert lights.area[0] == pytest.approx(4.0 if kind == "rectangle" else math.pi, rel=1e-6)


def test_kinds_and_power_of_lights(tmp_path: Path) -> None:
    area = '<emitter type="area"><rgb name="radiance" value="2"/></emitter></shape>'
    scene = load(
        tmp_path,
        f'<shape type="sphere"><float name="radius" value="2"/>{area}<shape type="disk">{area}'
        f'<shape type="cube">{area}<shape type="rectangle"/>'
        '<emitter type="point"><point name="position" x="1" y="2" z="3"/></emitter>'
        '<emitter type="spot"><float name="cutoff_angle" value="60"/><float name="beam_width" value="60"/>'
        '<transform name="to_world"><lookat origin="0,1,0" target="0,0,0" up="0,0,1"/></transform></emitter>',
        lamp="",
    )
    # Triangles come first, and so do the lights made of them.
    lights = scene.lights
    assert lights.kind.tolist() == [MESH_LIGHT, SPHERE_LIGHT, DISK_LIGHT, POINT_LIGHT, SPOT_LIGHT]
    np.testing.assert_allclose(lights.area, [24.0, 16.0 * math.pi, math.pi, 0.0, 0.0], rtol=1e-6)
    pi2 = 2.0 * math.pi**2
    expected = [24.0 * 2.0 * math.pi, 16.0 * pi2, pi2, 4.0 * math.pi, math.pi]
    np.testing.assert_allclose(lights.power[:, 1], expected, rtol=1e-6)
    assert (lights.triangle_first[0], lights.triangle_count[0]) == (0, 12)
    assert scene.light.tolist() == [0] * 12 + [-1, -1] + [1, 2]
    np.testing.assert_allclose(lights.position[3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(lights.normal[4], [0.0, -1.0, 0.0], atol=1e-7)


def test_spot_power_is_the_integral_of_its_falloff(tmp_path: Path) -> None:
    lights = load(tmp_path, '<shape type="cube"/><emitter type="spot"/>', lamp="").lights
    beam, cutoff = math.radians(15.0), math.radians(20.0)
    np.testing.assert_allclose(lights.cone_cos[0], [math.cos(beam), math.cos(cutoff)], rtol=1e-6)
    edges = np.linspace(0.0, cutoff, 20001)
    angle = 0.5 * (edges[1:] + edges[:-1])
    falloff = np.clip((cutoff - angle) / (cutoff - beam), 0.0, 1.0)
    integral = float(np.sum(falloff * np.sin(angle)) * (edges[1] - edges[0]) * 2.0 * math.pi)
    assert lights.power[0, 0] == pytest.approx(integral, rel=1e-6)


def test_lights_that_emit_nothing_are_left_out(tmp_path: Path) -> None:
    dark = '<emitter type="area"><rgb name="radiance" value="0"/></emitter>'
    scene = load(tmp_path, f'<shape type="rectangle">{dark}</shape>')
    assert scene.lights.kind.tolist() == [POINT_LIGHT]
    assert scene.light.tolist() == [-1, -1]
    assert any("radiance 0" in note for note in scene.notes)


def test_spectrum_of_a_light_is_equal_energy_white(tmp_path: Path) -> None:
    lamp = '<emitter type="point"><spectrum name="intensity" value="2"/></emitter>'
    intensity = load(tmp_path, '<shape type="cube"/>', lamp=lamp).lights.radiance[0]
    np.testing.assert_allclose(intensity, [2.40959, 1.89656, 1.81783], rtol=1e-4)
