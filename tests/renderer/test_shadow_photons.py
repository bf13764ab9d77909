"""Direct and shadow photons: a light is called seen or hidden only where it is, and pictures stay as they were.

The shadow of a square under a square lamp is known in closed form. With lamp half side a at height H over the plane
and blocker half side b at height t, r = H / (H - t): the lamp is hidden where max(|x|, |y|) < b r - a (r - 1), and
wholly seen where max(|x|, |y|) > b r + a (r - 1).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render import integrator
from joulebox_render.bench import shadow_test_report
from joulebox_render.kernels.lighting import shadow_rays as light_rays
from joulebox_render.kernels.shadow_photons import HIDDEN, LIT, UNKNOWN, find_cells
from joulebox_render.plan import make_plan
from joulebox_render.records import Points, ShadowRays
from joulebox_render.scene import load_scene
from joulebox_render.settings import make_settings
from joulebox_render.stages.eye import look
from joulebox_render.stages.shadow_photons import build_shadow_map, emit_through

Render = Callable[..., Any]
Open = Callable[..., Any]
Make = Callable[..., Path]

ON: dict[str, Any] = {"use_shadow_photons": True}
DIRECT: dict[str, Any] = {
    "indirect": "none", "caustics": False, "width": 48, "height": 48, "samples_per_pixel": 1, "shadow_rays": 16,
}  # fmt: skip
# The plane z = -1, the blocker at z = -0.5, lamps about z = 0.5 that shine down.
BLOCKER_HALF, SHARPNESS = 0.3, 1.5
PLANE = (
    '<shape type="rectangle"><transform name="to_world"><scale value="1.5"/><translate value="0,0,-1"/></transform>'
    "</shape>"
)
MIRROR = '<bsdf type="conductor"><string name="material" value="none"/></bsdf>'
EMITTER = '<emitter type="area"><rgb name="radiance" value="4 4 4"/></emitter>'
# From the side, so that neither lamp nor blocker is in front of their shadow.
CAMERA = '<transform name="to_world"><lookat origin="3,0,0.2" target="0.3,0,-1" up="0,0,1"/></transform>'


def placed(kind: str, inside: str, *steps: str) -> str:
    return f'<shape type="{kind}"><transform name="to_world">{"".join(steps)}</transform>{inside}</shape>'


def blocker(inside: str = "") -> str:
    return placed("rectangle", inside, f'<scale value="{BLOCKER_HALF}"/>', '<translate value="0,0,-0.5"/>')


def square_lamp(half: float) -> str:
    down = ('<rotate x="1" angle="180"/>', '<translate value="0,0,0.5"/>')
    return placed("rectangle", EMITTER, f'<scale value="{half}"/>', *down)


LAMPS = {
    "rectangle": square_lamp(0.2),
    "disk": square_lamp(0.2).replace("rectangle", "disk"),
    "sphere": f'<shape type="sphere"><point name="center" value="0,0,0.5"/><float name="radius" value="0.2"/>{EMITTER}'
    "</shape>",
    "mesh": placed("cube", EMITTER, '<scale value="0.15"/>', '<translate value="0,0,0.5"/>'),
}


def edges(lamp_half: float) -> tuple[float, float]:
    """Half sides of the umbra and of the penumbra's outline."""
    spread = lamp_half * (SHARPNESS - 1)
    return BLOCKER_HALF * SHARPNESS - spread, BLOCKER_HALF * SHARPNESS + spread


def lattice() -> Any:
    """Points of the plane over [-0.9, 0.9]^2, (N, 3) f4, lifted a little."""
    along = np.linspace(-0.9, 0.9, 121)
    x, y = (axis.ravel() for axis in np.meshgrid(along, along))
    return np.stack([x, y, np.full(len(x), -1 + 2e-5)], axis=1).astype(np.float32)


def verdicts(session: Any, position: Any, light: int = 0) -> Any:
    """What the session's shadow map says of points."""
    cells = build_shadow_map(session.context).cells
    points = Points.empty(len(position))
    points.position[:] = position
    cell = np.empty(len(position), np.int32)
    find_cells(cells, points, 0, len(position), cell)
    return cells.verdict[light, cell]


def changed(before: Any, after: Any) -> float:
    """Share of pixels that differ at all."""
    return float((before.pixels != after.pixels).any(axis=-1).mean())


def shadow_rays(image: Any) -> int:
    return int(image.clock.totals()["direct"]["rays"])


# --- where lights are seen and hidden ---


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("lamp_half", [0.05, 0.2, 0.4])
def test_umbra_is_hidden_penumbra_unknown_and_the_rest_lit(
    make_scene: Make, open_session: Open, lamp_half: float, seed: int
) -> None:
    """No point of a penumbra is decided and no other is decided wrongly; beyond reach of its photons nearly all are.

    Cells are about 0.05 m wide here, and one whose neighbours' far sides lie outside the penumbra is decided unless
    it has too few photons: 0.12 m from the edge.
    """
    session = open_session(make_scene(PLANE + blocker() + square_lamp(lamp_half)), **DIRECT, **ON, seed=seed)
    position = lattice()
    from_axis = np.abs(position[:, :2]).max(axis=1)
    umbra, outline = edges(lamp_half)
    found = verdicts(session, position)
    penumbra = (from_axis > umbra) & (from_axis < outline)
    assert penumbra.sum() > 300
    assert (found[penumbra] == UNKNOWN).all()
    assert not (found[from_axis <= umbra] == LIT).any()
    assert not (found[from_axis >= outline] == HIDDEN).any()
    far = (from_axis > outline + 0.12) & (np.hypot(position[:, 0], position[:, 1]) < 0.9)
    assert (found[far] == LIT).mean() > 0.95
    deep = from_axis < umbra - 0.12
    assert deep.sum() > 20
    assert (found[deep] == HIDDEN).mean() > 0.95


def test_direct_photons_lie_in_the_light_and_shadow_photons_behind_them(make_scene: Make, open_session: Open) -> None:
    """Exactly as many direct photons as asked for, in the order of emission; each shadow photon has one before it."""
    session = open_session(make_scene(PLANE + blocker() + square_lamp(0.2)), **DIRECT, **ON, direct_photons=5000)
    photons, emitted, _ = emit_through(session.context)
    is_shadow = photons.is_shadow == 1
    on_plane = photons.position[:, 2] < -0.9
    from_axis = np.abs(photons.position[:, :2]).max(axis=1)
    umbra, outline = edges(0.2)
    assert (~is_shadow).sum() == 5000
    assert (np.diff(photons.number) >= 0).all()
    assert photons.number[-1] < emitted
    assert (from_axis[~is_shadow & on_plane] > umbra - 1e-4).all()
    assert on_plane[is_shadow].all()
    assert (from_axis[is_shadow] < outline + 1e-4).all()
    assert is_shadow.sum() > 500
    blocked = photons.number[~is_shadow & ~on_plane]
    assert set(photons.number[is_shadow]) == set(blocked), "the shadow of the blocker falls on the plane whole"


@pytest.mark.parametrize("scene", ["cornell-boxes", "many-lights"])
def test_penumbrae_that_rays_find_are_left_to_rays(open_session: Open, scene: str) -> None:
    """At least 99.9 % of what eye rays see and 144 rays find partly lit by a light is unknown to the map."""
    session = open_session(scene, **{**DIRECT, **ON, "width": 64, "height": 64})
    context, rays = session.context, 144
    points = look(context, session.scene.camera, 0, 64 * 64).direct
    count = len(points.owner)
    partly = decided = 0
    for light in range(len(context.tables.light_kind)):
        shadow = ShadowRays.empty(count * rays)
        written = light_rays(context.tables, light, rays, context.columns(rays), points, 0, count, shadow)
        blocked = context.intersector.occluded(
            shadow.origin[:written], shadow.direction[:written], shadow.limit[:written]
        )
        asked = np.bincount(shadow.owner[:written], minlength=count)
        hidden = np.bincount(shadow.owner[:written], blocked, count)
        penumbra = (hidden > 0) & (hidden < asked)
        partly += int(penumbra.sum())
        decided += int((verdicts(session, points.position, light)[penumbra] != UNKNOWN).sum())
    assert partly > 200
    assert decided <= 0.001 * partly


# --- pictures ---


@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize("inside", ["", MIRROR], ids=["diffuse", "mirror"])
def test_rays_are_saved_under_every_kind_of_area_light(
    make_scene: Make, render: Render, lamp: str, inside: str
) -> None:
    """Samples that are not traced count as they would have: not a bit differs where nothing was misjudged."""
    scene = make_scene(PLANE + blocker(inside) + LAMPS[lamp], camera=CAMERA)
    before, after = render(scene, **DIRECT), render(scene, **DIRECT, **ON)
    assert changed(before, after) == 0
    assert shadow_rays(after) < 0.8 * shadow_rays(before)


def test_more_direct_photons_miss_less_of_what_is_small(make_scene: Make, render: Render) -> None:
    """The known weakness: 25 cubes of 1 cm afloat 9 cm over a plane, photons 2 cm apart, cells 4.5 cm wide.

    A picture of 9216 pixels then has up to 0.3 % that lack a shadow they should have; with ten times the photons none.
    """
    cubes = "".join(
        placed("cube", "", '<scale value="0.005"/>', f'<translate value="{x},{y},-0.9"/>')
        for x in np.linspace(-0.8, 0.8, 5) for y in np.linspace(-0.77, 0.83, 5)
    )  # fmt: skip
    scene = make_scene(PLANE + cubes + square_lamp(0.1), camera=CAMERA, fov_deg=45)
    settings = {**DIRECT, "width": 96, "height": 96}
    before = render(scene, **settings)
    few, many = (render(scene, **settings, **ON, direct_photons=count) for count in (10_000, 100_000))
    assert 0 < changed(before, few) < 0.003
    assert changed(before, many) == 0
    assert (few.pixels >= before.pixels).all(), "shadows are missed, not made"


@pytest.mark.parametrize("scene", ["cornell-boxes", "cornell-spheres", "many-lights", "caustic-ring"])
def test_pictures_of_scenes_stay_and_rays_fall(render: Render, scene: str) -> None:
    """At most 1 pixel in 500 is misjudged somewhere; a third of the shadow rays go, and as many as the report says.

    Rays at hidden points are counted by one sample in 16, which is off by far less than 3 % over 2304 points.
    """
    before, after = render(scene, **DIRECT), render(scene, **DIRECT, **ON)
    assert changed(before, after) <= 0.002
    np.testing.assert_allclose(after.pixels.mean(), before.pixels.mean(), rtol=1e-3)
    saved = shadow_rays(before) - shadow_rays(after)
    assert saved > 0.33 * shadow_rays(before)
    assert after.photons["shadow_rays_saved"] == pytest.approx(saved, rel=0.03)
    assert after.photons["direct_stored"] == 10_000
    assert after.photons["shadow_stored"] > 0
    assert before.photons["shadow_rays_saved"] == before.photons["direct_stored"] == 0


def test_every_one_of_many_lights_is_decided(open_session: Open) -> None:
    cells = build_shadow_map(open_session("many-lights", **DIRECT, **ON).context).cells
    assert len(cells.verdict) == 16
    assert ((cells.verdict == LIT).sum(axis=1) > 100).all()
    assert ((cells.verdict == HIDDEN).sum(axis=1) > 0).all()


def test_threads_chunks_and_bands_do_not_show(render: Render, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {**DIRECT, **ON, "sampler": "sobol", "direct_photons": 3000}
    first = render("many-lights", **settings)
    for threads, chunk_rays, band_rays in ((1, 500, 131_072), (3, 1237, 1000), (2, 50_000, 777)):
        monkeypatch.setattr(integrator, "BAND_RAYS", band_rays)
        other = render("many-lights", chunk_rays=chunk_rays, **{**settings, "threads": threads})
        assert other.pixel_sha256 == first.pixel_sha256
        assert other.photons == first.photons
        assert shadow_rays(other) == shadow_rays(first)


# --- the plan ---


def test_shadow_photons_are_off_unless_asked_for() -> None:
    assert make_plan(load_scene("cornell-boxes"), make_settings({})).left_out["shadow_photons"] == (
        "use_shadow_photons=false"
    )


def test_no_direct_photons_is_no_test(render: Render, open_session: Open) -> None:
    session = open_session("cornell-boxes", **DIRECT, **ON, direct_photons=0)
    assert session.plan.left_out["shadow_photons"] == "direct_photons=0"
    assert "photon_map" not in session.plan.run
    assert session.render().pixel_sha256 == render("cornell-boxes", **DIRECT).pixel_sha256


def test_a_point_light_needs_none(open_session: Open) -> None:
    """Forced on, they have no light to come from and change nothing."""
    planned = open_session("point-light", **DIRECT, **ON)
    assert not planned.plan.shadow_photons
    assert planned.plan.left_out["shadow_photons"].startswith("no area light")
    forced = open_session("point-light", force_all=True, **DIRECT, **ON)
    assert forced.plan.shadow_photons
    image = forced.render()
    assert image.pixel_sha256 == planned.render().pixel_sha256
    assert image.photons["direct_stored"] == image.photons["shadow_rays_saved"] == 0


def test_a_point_light_beside_a_lamp_is_asked_with_rays(make_scene: Make, open_session: Open) -> None:
    light = '<emitter type="point"><point name="position" value="0.4,0,0.5"/></emitter>'
    session = open_session(make_scene(PLANE + light + square_lamp(0.2)), **DIRECT, **ON)
    kinds = session.scene.lights.kind
    at = {kind: verdicts(session, lattice(), int(np.flatnonzero(kinds == kind)[0])) for kind in set(kinds.tolist())}
    assert sorted((found != UNKNOWN).any() for found in at.values()) == [False, True]


def test_the_map_is_timed_and_reported(open_session: Open) -> None:
    session = open_session("cornell-boxes", **DIRECT, **ON)
    assert session.plan.run == ["photon_map", "direct"]
    image = session.render()
    stage = session.report(image)["stages"]["photon_map"]
    assert stage["shadow_photons_s"] > 0
    assert stage["rays"] > 8 * 10_000
    assert image.notes == []


def test_light_that_falls_on_nothing_is_said_and_saves_nothing(make_scene: Make, render: Render) -> None:
    scene = make_scene(PLANE + placed("rectangle", EMITTER, '<scale value="0.2"/>', '<translate value="0,0,9"/>'))
    image = render(scene, **DIRECT, **ON, direct_photons=20)
    assert image.photons["direct_stored"] == 0
    assert image.photons["direct_emitted"] == 50 * 20
    assert image.photons["shadow_rays_saved"] == 0
    assert any("direct photons were stored after 1000 were emitted" in note for note in image.notes)
    assert image.pixel_sha256 == render(scene, **DIRECT).pixel_sha256


def test_the_report_of_what_the_test_saves() -> None:
    figures = shadow_test_report("cornell-boxes", DIRECT, repeats=1)
    assert 0.5 < figures["rays_saved"] < 1
    assert figures["rays_with_test"] < figures["rays"]
    assert figures["pixels_changed"] == figures["relmse"] == figures["largest_change"] == 0
    assert figures["map_cpu_s"] > 0
