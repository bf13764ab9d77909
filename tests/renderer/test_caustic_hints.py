"""Aimed emission: no photon that could make a caustic is left out, and what is drawn carries the same light.

Fluxes are held two-sided to 4.5 standard errors (a false alarm in 150,000), taken from independent emissions and
bounded themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.intersect import Intersector
from joulebox_render.kernels.emission import AIM_COLUMNS, AIM_ROWS, emit_photons
from joulebox_render.kernels.rng import draw_2d, path_key
from joulebox_render.records import GLASS, MIRROR, PHONG, Aim, Rays
from joulebox_render.scene import load_scene
from joulebox_render.stages import photon_map
from joulebox_render.stages.aim import aim_at_specular, aim_everywhere, specular_balls
from joulebox_render.stages.photon_map import CAUSTIC
from joulebox_render.tables import SceneTables, scene_tables

SIGMAS = 4.5
CELLS = AIM_ROWS * AIM_COLUMNS
Make = Callable[..., Path]
Open = Callable[..., Any]


def place(steps: str) -> str:
    return f'<transform name="to_world">{steps}</transform>'


EMITTER = '<emitter type="area"><rgb name="radiance" value="3 2 1"/></emitter>'
INTENSITY = '<rgb name="intensity" value="3 2 1"/>'
SCALE, MOVE = '<scale value="%s"/>', '<translate value="%s"/>'
TURN = '<rotate x="0.6" y="0.8" angle="30"/>'
DOWN = '<rotate x="0.8" y="0.6" angle="165"/><translate value="0.1,0.2,0.8"/>'
LIGHTS = {
    "rectangle": f'<shape type="rectangle">{place(SCALE % 0.1 + DOWN)}{EMITTER}</shape>',
    "disk": f'<shape type="disk">{place(SCALE % 0.1 + DOWN)}{EMITTER}</shape>',
    "sphere": (
        '<shape type="sphere"><point name="center" value="0.1,0.2,0.8"/><float name="radius" value="0.1"/>'
        f"{EMITTER}</shape>"
    ),
    "point": f'<emitter type="point"><point name="position" value="0.1,0.2,0.8"/>{INTENSITY}</emitter>',
    "spot": (
        '<emitter type="spot"><float name="cutoff_angle" value="60"/><float name="beam_width" value="20"/>'
        + INTENSITY
        + place('<lookat origin="0.1,0.2,0.8" target="0.2,0,-1" up="0,1,0"/>')
        + "</emitter>"
    ),
}
UNLIMITED = {
    "mesh": f'<shape type="cube">{place(SCALE % 0.05 + DOWN)}{EMITTER}</shape>',
    "environment": '<emitter type="constant"/>',
}
ROOM = '<shape type="sphere"><float name="radius" value="2"/><boolean name="flip_normals" value="true"/></shape>'
FLOOR = f'<shape type="rectangle">{place(SCALE % 2 + MOVE % "0,0,-1")}</shape>'
GLASS_BALL = (
    '<shape type="sphere"><point name="center" value="0.3,-0.2,-0.6"/><float name="radius" value="0.15"/>'
    '<bsdf type="dielectric"/></shape>'
)
MIRROR_BOX = (
    f'<shape type="cube">{place(SCALE % 0.1 + TURN + MOVE % "-0.5,0.3,-0.4")}'
    '<bsdf type="conductor"><string name="material" value="none"/></bsdf></shape>'
)
GLOSSY_PLATE = f'<shape type="rectangle">{place(SCALE % 0.1 + MOVE % "0.5,0.6,-0.3")}<bsdf type="phong"/></shape>'
THINGS = GLASS_BALL + MIRROR_BOX + GLOSSY_PLATE


def family_of(seed: int) -> np.uint64:
    return np.uint64(path_key(seed, photon_map.EMISSION_STREAM, photon_map.EVERYWHERE))


def marked(aim: Aim, light: int) -> Any:
    """(CELLS,) whether a light draws each cell of its directions."""
    cells = aim.cell[aim.first[light] : aim.first[light + 1]]
    return np.isin(np.arange(CELLS), cells) if len(cells) else np.full(CELLS, aim.share[light] > 0)


def caustic_flux(session: Any, aim: Aim, count: int, seed: int) -> Any:
    """(count, 3) flux that each emission stores as caustic photons."""
    photons = photon_map.trace_photons(session.context, aim, family_of(seed), 0, count)
    chosen = photons.history == CAUSTIC
    return np.stack([np.bincount(photons.number[chosen], photons.flux[chosen, c], count) for c in range(3)], -1)


@pytest.mark.parametrize("sampler", ["independent", "sobol"])
@pytest.mark.parametrize("light", [*LIGHTS, "spot and rectangle", *UNLIMITED])
def test_caustics_keep_their_power(make_scene: Make, open_session: Open, light: str, sampler: str) -> None:
    """Flux stored as caustic photons an emission, with hints and without, channel by channel."""
    lamps = "".join({**LIGHTS, **UNLIMITED}[kind] for kind in light.split(" and "))
    if " and " in light:
        lamps = lamps.replace('origin="0.1,0.2,0.8"', 'origin="-0.2,-0.3,0.7"')
    # The sky does not shine into a room.
    around = FLOOR if light == "environment" else ROOM
    session = open_session(make_scene(around + THINGS + lamps), max_photon_bounces=8, sampler=sampler)
    tables = session.context.tables
    count = 200_000 if light in UNLIMITED else 40_000
    aimed = caustic_flux(session, aim_at_specular(tables), count, 1)
    unaimed = caustic_flux(session, aim_everywhere(tables), 2 * count, 2)
    difference = aimed.mean(axis=0) - unaimed.mean(axis=0)
    error = np.hypot(aimed.std(axis=0) / math.sqrt(count), unaimed.std(axis=0) / math.sqrt(2 * count))
    assert np.all(error < 0.1 * unaimed.mean(axis=0))
    assert np.all(np.abs(difference) < SIGMAS * error)
    if light in LIGHTS:
        # Fewer photons are thrown away: the same emissions tell more.
        assert (aimed[:, 0] > 0).mean() > 2 * (unaimed[:, 0] > 0).mean()


def first_hits(tables: SceneTables, count: int, seed: int) -> tuple[Any, Any]:
    """Cells that unaimed photons of a single light were drawn from, and the material each meets first."""
    rays = Rays.empty(count)
    family = family_of(seed)
    emit_photons(tables, aim_everywhere(tables), False, family, 0, rays)
    numbers = np.array([draw_2d(False, family, number, 3) for number in range(count)])
    cell = np.floor(numbers[:, 0] * AIM_ROWS).astype(int) * AIM_COLUMNS
    cell += np.floor(numbers[:, 1] * AIM_COLUMNS).astype(int)
    hits = Intersector(tables).closest(rays.origin, rays.direction)
    kind = np.where(hits.primitive >= 0, tables.material_kind[tables.material[hits.primitive]], -1)
    return cell, kind


@pytest.mark.parametrize("light", LIGHTS)
def test_what_meets_a_specular_object_first_comes_from_a_marked_cell(make_scene: Make, light: str) -> None:
    """No exception among many unaimed photons; cells are few, and those along the objects' rims are met too."""
    tables = scene_tables(load_scene(make_scene(ROOM + THINGS + LIGHTS[light])))
    cells = marked(aim_at_specular(tables), 0)
    assert 0 < cells.sum() < 0.4 * CELLS
    cell, kind = first_hits(tables, 60_000, 5)
    meets = np.isin(kind, (MIRROR, GLASS, PHONG))
    assert meets.sum() > 300
    assert cells[cell[meets]].all()
    # Not by marking everything near: a good part of what is drawn does meet something.
    assert meets[cells[cell]].mean() > 0.05


@pytest.mark.parametrize("trial", range(8))
def test_also_wherever_lights_and_objects_are(make_scene: Make, trial: int) -> None:
    """Lamps close to a ball, within its shadow, behind it, and under a lamp that faces away: random places."""
    random = np.random.default_rng(trial)
    x, y, z = random.uniform(-1, 1, 3)
    radius = random.uniform(0.02, 0.3)
    axis, angle = random.normal(size=3), random.uniform(0, 360)
    axis /= np.linalg.norm(axis)
    turn = f'<rotate value="{axis[0]},{axis[1]},{axis[2]}" angle="{angle}"/>'
    kind = ("rectangle", "disk", "spot")[trial % 3]
    where = MOVE % "0.1,0.2,0.3"
    lamp = (
        f'<emitter type="spot"><float name="cutoff_angle" value="90"/>{place(turn + where)}</emitter>'
        if kind == "spot"
        else f'<shape type="{kind}">{place(SCALE % 0.2 + turn + where)}{EMITTER}</shape>'
    )
    ball = (
        f'<shape type="sphere"><point name="center" value="{x},{y},{z}"/><float name="radius" value="{radius}"/>'
        '<bsdf type="dielectric"/></shape>'
    )
    tables = scene_tables(load_scene(make_scene(ROOM + ball + lamp)))
    cells = marked(aim_at_specular(tables), 0)
    cell, material = first_hits(tables, 40_000, trial)
    assert cells[cell[material == GLASS]].all()


def test_a_lamp_inside_a_glass_ball_is_not_limited(make_scene: Make) -> None:
    ball = GLASS_BALL.replace("0.3,-0.2,-0.6", "0.1,0.2,0.75").replace('"0.15"', '"0.2"')
    aim = aim_at_specular(scene_tables(load_scene(make_scene(ROOM + ball + LIGHTS["point"]))))
    assert marked(aim, 0).all()
    assert aim.share[0] == 1


@pytest.mark.parametrize("light", UNLIMITED)
def test_meshes_and_the_environment_are_not_limited(make_scene: Make, light: str) -> None:
    aim = aim_at_specular(scene_tables(load_scene(make_scene(ROOM + THINGS + UNLIMITED[light]))))
    assert marked(aim, 0).all()
    np.testing.assert_array_equal(aim.share, 1)


def test_lights_are_chosen_by_the_power_that_they_send_on_drawn_paths(make_scene: Make) -> None:
    lamps = LIGHTS["point"] + LIGHTS["spot"] + UNLIMITED["mesh"]
    tables = scene_tables(load_scene(make_scene(ROOM + THINGS + lamps)))
    aim = aim_at_specular(tables)
    power = tables.light_power.astype(float).mean(axis=1)
    sent = power * [marked(aim, light).mean() for light in range(3)]
    np.testing.assert_allclose(np.diff(aim.choice, prepend=0), sent / sent.sum(), rtol=1e-9)


def test_balls_hold_what_is_specular_and_nothing_else(make_scene: Make) -> None:
    """One for the glass ball, one for the mirror cube (a mesh of doubled corners), one for the plate."""
    tables = scene_tables(load_scene(make_scene(ROOM + THINGS + LIGHTS["point"])))
    balls = sorted(specular_balls(tables).tolist())
    assert len(balls) == 3
    expected = sorted([[0.3, -0.2, -0.6, 0.15], [-0.5, 0.3, -0.4, 0.1 * math.sqrt(3)],
                       [0.5, 0.6, -0.3, 0.1 * math.sqrt(2)]])  # fmt: skip
    for found, wanted in zip(balls, expected, strict=True):
        np.testing.assert_allclose(found[:3], wanted[:3], atol=1e-6)
        assert wanted[3] * (1 - 1e-6) <= found[3] <= wanted[3] * 1.01


def test_without_specular_objects_nothing_is_emitted(make_scene: Make, open_session: Open) -> None:
    scene = make_scene(ROOM + LIGHTS["rectangle"])
    tables = scene_tables(load_scene(scene))
    assert not marked(aim_at_specular(tables), 0).any()
    settings = {"caustic_hints": True, "global_photons": 500, "width": 4, "height": 4}
    forced = open_session(scene, force_all=True, **settings).render()
    planned = open_session(scene, **settings).render()
    assert forced.photons["caustic_emitted"] == 0
    assert forced.pixel_sha256 == planned.pixel_sha256


@pytest.mark.parametrize("scene", ["cornell-spheres", "caustic-ring"])
def test_far_fewer_photons_are_emitted(open_session: Open, scene: str) -> None:
    """Emissions for each photon stored fall by the share of directions that are drawn: within 4.5 standard errors.

    Unaimed emission never fills the ring's map: the ring takes less than a hundredth of what the lamp sends.
    """
    settings = {"indirect": "none", "caustic_photons": 4000, "width": 4, "height": 4, "samples_per_pixel": 1}
    session = open_session(scene, caustic_hints=True, **settings)
    aimed = session.render().photons
    unaimed = open_session(scene, caustic_hints=False, **settings).render().photons
    assert aimed["caustic_stored"] == 4000
    assert (unaimed["caustic_stored"] == 4000) == (scene == "cornell-spheres")
    share = aim_at_specular(session.context.tables).share[0]
    assert 0 < share < 0.5
    assert aimed["caustic_emitted"] < 0.5 * unaimed["caustic_emitted"]
    ratio, error2 = 1.0, 0.0
    for counts, power in ((aimed, 1), (unaimed, -1)):
        ratio *= (counts["caustic_emitted"] / counts["caustic_stored"]) ** power
        error2 += 1 / counts["caustic_stored"]
    assert ratio == pytest.approx(share, rel=SIGMAS * math.sqrt(error2))


def test_pictures_agree_in_the_mean(open_session: Open) -> None:
    """The caustic under the spheres, blocks of the picture: six seeds, Student's t of ten degrees of freedom (8.5)."""
    found = []
    for hints in (False, True):
        pictures = []
        for seed in range(6):
            settings = {"indirect": "none", "caustic_photons": 4000, "width": 24, "height": 24, "seed": seed,
                        "caustic_gather_distance_m": 0.03, "shadow_rays": 1, "jitter": False}  # fmt: skip
            whole = open_session("cornell-spheres", caustic_hints=hints, **settings).render().pixels
            rest = open_session("cornell-spheres", caustics=False, **settings).render().pixels
            pictures.append((whole - rest).sum(axis=-1).reshape(2, 12, 2, 12).sum(axis=(1, 3)))
        found.append((np.mean(pictures, axis=0), np.std(pictures, axis=0, ddof=1) / math.sqrt(6)))
    (unaimed, unaimed_error), (aimed, aimed_error) = found
    error = np.hypot(unaimed_error, aimed_error)
    lit = unaimed > 0.05 * unaimed.max()
    assert lit.any()
    assert np.all(error[lit] < 0.1 * unaimed[lit])
    assert np.all(np.abs(aimed - unaimed)[lit] < 8.5 * error[lit])
    assert aimed.sum() == pytest.approx(unaimed.sum(), rel=0.05)
