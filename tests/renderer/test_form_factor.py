"""The form factor of two parallel squares, by shadow rays and by photons."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.kernels.emission import emit_photons
from joulebox_render.records import Rays
from joulebox_render.stages.aim import aim_everywhere
from joulebox_render.stages.precomputed import direct_irradiance

SIGMAS = 4.5  # a false alarm in 150,000
Make = Callable[..., Path]
Open = Callable[..., Any]


def form_factor(x: float) -> float:
    """Of two equal squares that face each other at a distance of 1 / x sides (Howell's catalogue, C-11)."""
    y = x * x
    return (2 / (math.pi * y)) * (
        math.log((1 + y) / math.sqrt(1 + 2 * y)) + 2 * x * math.sqrt(1 + y) * math.atan(x / math.sqrt(1 + y))
        - 2 * x * math.atan(x)
    )  # fmt: skip


@pytest.mark.parametrize("distance", [0.5, 2.0, 8.0])
@pytest.mark.parametrize("way", ["shadow rays", "photons"])
def test_the_form_factor_of_parallel_squares(
    make_scene: Make, open_session: Open, z_score: Callable[[Any, float], float], distance: float, way: str
) -> None:
    """The share of a square light's flux that reaches the other square: by shadow rays, and by photons.

    A square of side 2 whose distance is given; radiance 1, so flux 4 pi and mean irradiance pi F.
    """
    light = (
        f'<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="180"/><translate z="{distance}"/>'
        '</transform><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
        '<emitter type="area"><rgb name="radiance" value="1 1 1"/></emitter></shape>'
    )
    session = open_session(make_scene('<shape type="rectangle"/>' + light), sampler="independent")
    expected = form_factor(2 / distance)
    count = 40_000
    if way == "shadow rays":
        places = np.random.default_rng(2).uniform(-1, 1, (count, 3)).astype(np.float32)
        places[:, 2] = 0
        up = np.tile(np.float32([0, 0, 1]), (count, 1))
        shares = direct_irradiance(session.context, np.arange(count), places, up)[:, 0] / math.pi
    else:
        tables = session.context.tables
        rays = Rays.empty(count)
        emit_photons(tables, aim_everywhere(tables), False, np.uint64(5), 0, rays)
        hits = session.context.intersector.closest(rays.origin, rays.direction)
        shares = rays.weight[:, 0] / (4 * math.pi) * (hits.primitive >= 0)
    assert shares.std() / math.sqrt(count) < 0.05 * expected
    assert abs(z_score(shares, expected)) < SIGMAS
