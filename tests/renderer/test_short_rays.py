"""Gather rays that end nearer than the photon map can tell places apart: corners, and floors behind thin walls.

A second gather takes the place of the look-up there. What is compared is gathered light alone: pictures with it less
pictures without, whose eye and shadow rays have the same random numbers. Where photons are merely few, they answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.clock import StageClock
from joulebox_render.integrator import illumination, make_maps
from joulebox_render.kernels.gathering import take_unsure
from joulebox_render.kernels.lookup import OUTSIDE
from joulebox_render.records import Points
from joulebox_render.stages import gather
from scipy import stats

Make = Callable[..., Path]
Open = Callable[..., Any]


def plane(turn: str, move: str = "0,0,0", reflectance: float = 0.8) -> str:
    return (
        f'<shape type="rectangle"><transform name="to_world"><scale value="3"/>{turn}<translate value="{move}"/>'
        f'</transform><bsdf type="diffuse"><rgb name="reflectance" value="{reflectance}"/></bsdf></shape>'
    )


FLOOR = plane("")
WALL = plane('<rotate y="1" angle="90"/>')
LAMP = (
    '<shape type="sphere"><point name="center" value="{}"/><float name="radius" value="0.1"/>'
    '<emitter type="area"><rgb name="radiance" value="30"/></emitter></shape>'
)


def looking(origin: str, target: str) -> str:
    return f'<transform name="to_world"><lookat origin="{origin}" target="{target}" up="0,0,1"/></transform>'


def gathered(open_session: Open, scene: Path, seeds: range, **settings: Any) -> Any:
    """(seeds, 16, 16) gathered light alone."""
    pictures = []
    for seed in seeds:
        how = {"width": 16, "height": 16, "samples_per_pixel": 16, "shadow_rays": 1, "seed": seed, **settings}
        whole, rest = (open_session(scene, **{**how, **change}) for change in ({}, {"indirect": "none"}))
        pictures.append((whole.render().pixels.astype(float) - rest.render().pixels)[..., 0])
    return np.array(pictures)


def mean_and_error(values: Any) -> tuple[Any, Any]:
    return values.mean(axis=0), values.std(axis=0, ddof=1) / math.sqrt(len(values))


BROAD: dict[str, Any] = {
    "indirect": "final_gather", "gather_distance_m": 0.2, "gather_count": 5000, "global_photons": 40_000,
    "final_gather_rays": 64,
}  # fmt: skip


@pytest.mark.parametrize("spacing", [0, 4])
def test_a_corner_is_as_bright_as_paths_say(make_scene: Make, open_session: Open, spacing: int) -> None:
    """The wall within 5 cm of the floor, under discs of 20 cm: each row of pixels within 4 % of `path`, and its noise.

    Without the second gather the discs reach beyond the corner, and a fifth to two fifths of the light is lost.
    """
    camera = looking("1.2,0,0.025", "0,0,0.025")
    scene = make_scene(FLOOR + WALL + LAMP.format("0.8,0,1"), camera=camera, fov_deg=2.2)
    ours, our_error = mean_and_error(gathered(open_session, scene, range(4), photon_spacing=spacing, **BROAD).mean(2))
    path = {"indirect": "path", "samples_per_pixel": 256}
    theirs, their_error = mean_and_error(gathered(open_session, scene, range(4), **path).mean(2))
    error = np.hypot(our_error, their_error)
    assert np.all(error < 0.03 * theirs)
    assert np.all(np.abs(ours - theirs) < 0.04 * theirs + 4.5 * error), ours / theirs
    assert abs(ours.mean() / theirs.mean() - 1) < 0.04


def test_a_thin_wall_leaks_less(make_scene: Make, open_session: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind an endless thin wall it is dark; photons of the lit floor reach under it into the map's discs.

    At the wall's foot the rays that would meet them are short.
    """
    thin = plane('<rotate y="1" angle="90"/>') + plane('<rotate y="1" angle="-90"/>', "-0.002,0,0")
    camera = looking("-1.2,0,0.02", "0,0,0.02")
    scene = make_scene(FLOOR + thin + LAMP.format("0.5,0,0.5"), camera=camera, fov_deg=1.8)
    front = make_scene(FLOOR + thin + LAMP.format("0.5,0,0.5"), camera=looking("0.2,0,0.02", "0,0,0.02"), fov_deg=1.8)
    lit = gathered(open_session, front, range(1), **BROAD).mean()
    again = gathered(open_session, scene, range(2), **BROAD).mean()
    monkeypatch.setattr(gather, "MOST_SHORT", 0)
    leaking = gathered(open_session, scene, range(2), **BROAD).mean()
    assert leaking > 0.02 * lit
    assert 0 <= again < 0.2 * leaking


def test_the_limit_varies_from_half_to_one_and_a_half_times_the_reach() -> None:
    """Short with the chance (1.5 - distance / reach), clipped: binomial, 4.5 sigma."""
    count = 20_000
    points, near = Points.empty(count), Points.empty(count)
    points.key[:], points.sample[:], points.owner[:] = 77, np.arange(count), np.arange(count)
    sure = np.zeros(count, np.uint8)
    for share in (0.49, 0.75, 1.0, 1.25, 1.51):
        points.distance[:], points.weight[:] = share * 0.02, 0.5
        taken = take_unsure(points, sure, 0.02, near)
        chance = min(1.0, max(0.0, 1.5 - share))
        assert abs(taken / count - chance) <= 4.5 * math.sqrt(chance * (1 - chance) / count)
        # What is taken counts there alone, and what is left here alone.
        rows = near.owner[:taken]
        assert np.all(np.diff(rows) > 0)
        np.testing.assert_array_equal(near.weight[:taken], 0.5)
        kept = np.setdiff1d(np.arange(count), rows)
        assert not points.weight[rows].any()
        np.testing.assert_array_equal(points.weight[kept], 0.5)
    points.distance[:] = np.random.default_rng(1).uniform(0.01, 0.03, count)
    assert stats.binomtest(take_unsure(points, sure, 0.02, near), count, 0.5).pvalue > 2e-4


def test_unsure_places_are_taken_at_any_distance() -> None:
    points, near = Points.empty(6), Points.empty(6)
    points.key[:], points.sample[:], points.owner[:], points.distance[:] = 5, np.arange(6), np.arange(6), 9.0
    unsure = np.array([0, 1, 1, 0, 0, 1], np.uint8)
    assert take_unsure(points, unsure, 0.02, near) == 3
    assert near.owner[:3].tolist() == [1, 2, 5]


FURNACE = (
    '<shape type="cube"><boolean name="flip_normals" value="true"/><transform name="to_world"><scale value="0.5"/>'
    '<translate x="{}"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>'
    '<emitter type="area"><rgb name="radiance" value="{}"/></emitter></shape>'
)


def test_a_dim_room_is_known_from_its_photons(make_scene: Make, open_session: Open) -> None:
    """Beside a room twenty times as bright, which gets nearly all photons, a furnace of radiance e / (1 - 0.8).

    A disc of 5 cm holds a few of its photons, and cells around its records, as wide as the bright room asks for, cover
    a third of it. Photons answer at nearly all other places, without bias: of ten maps the mean irradiance is pi times
    the radiance, and that outside cells over that inside, in which the maps' own noise cancels, is 1; 4.5 of their
    standard errors, which are held under 4 and 3 %. Photons that are records would be missing where none is near: with
    them the ratio came out 0.80. Edges, where photons lie behind the next wall, are left out.
    """
    scene = make_scene(FURNACE.format(0, 20) + FURNACE.format(3, 1))
    random = np.random.default_rng(5)
    points = Points.empty(3000)
    points.position[:] = random.uniform(-0.35, 0.35, (3000, 3))
    face, side = random.integers(3, size=3000), random.choice([-1.0, 1.0], 3000)
    points.normal[:] = points.geometric[:] = -side[:, None] * np.eye(3)[face]
    points.position[np.arange(3000), face] = (0.5 - 1e-4) * side
    points.position[:, 0] += 3
    points.distance[:] = 1
    points.key[:] = random.integers(2**63, size=3000)
    points.sample[:] = 0
    known, irradiance, ratio = [], [], []
    for seed in range(10):
        how = {"global_photons": 40_000, "gather_distance_m": 0.05, "gather_count": 1000, "photon_spacing": 4}
        session = open_session(scene, seed=seed, indirect="final_gather", **how)
        light = illumination(session.context, make_maps(session.context, StageClock()))
        assert light.records
        _, far = replace(light, records=light.records._replace(others=None)).look_up(points)
        found, unsure = light.look_up(points)
        known.append((unsure == 0).mean())
        irradiance.append(found[unsure == 0].mean())
        ratio.append(found[(far == OUTSIDE) & (unsure == 0)].mean() / found[far == 0].mean())
    assert min(known) > 0.95
    for values, expected, most in ((irradiance, 5 * math.pi, 0.04), (ratio, 1, 0.03)):
        mean, error = mean_and_error(np.array(values) / expected)
        assert error < most
        assert abs(mean - 1) < 4.5 * error, (mean, error)
