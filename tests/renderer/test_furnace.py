"""Furnaces: a closed room that emits e and reflects rho has the radiance e / (1 - rho) everywhere.

Unbiased estimates are held two-sided to 4.5 standard errors (a false alarm in 150,000), the standard error taken
from independent pixels or seeds and itself bounded; a biased one to its bias, derived.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SIGMAS = 4.5
Z = Callable[[Any, float], float]
Render = Callable[..., Any]
Make = Callable[..., Path]

SPHERE_FURNACE = (
    '<shape type="sphere"><float name="radius" value="0.5"/><boolean name="flip_normals" value="true"/>'
    '<bsdf type="diffuse"><rgb name="reflectance" value="0.5 0.7 0.2"/></bsdf>'
    '<emitter type="area"><rgb name="radiance" value="0.5 0.3 0.8"/></emitter></shape>'
)


@pytest.mark.parametrize("reflectance", ["0.2", "0.5", "0.9"])
@pytest.mark.parametrize("sampler", ["independent", "stratified", "sobol"])
def test_the_cube_furnace_by_paths(render: Render, z_score: Z, sampler: str, reflectance: str) -> None:
    """Unbiased, so 4.5 sigma over independent pixels, whose standard error is held under 3 %.

    Walls light each other at the edges, where the sampled light has a heavy tail: hence the wide error.
    """
    defines = {"reflectance": reflectance, "radiance": str(round(1 - float(reflectance), 3))}
    pixels = render(
        "furnace", defines=defines, indirect="path", width=48, height=48, sampler=sampler, shadow_rays=16, seed=2
    ).pixels
    np.testing.assert_array_equal(pixels, np.repeat(pixels[..., :1], 3, -1))
    assert pixels[..., 0].std() / 48 < 0.03
    assert abs(z_score(pixels[..., 0], 1)) < SIGMAS


@pytest.mark.parametrize(("spacing", "noise"), [(0, 0.004), (4, 0.02)])
def test_the_cube_furnace_by_final_gathering(open_session: Callable[..., Any], spacing: int, noise: float) -> None:
    """As bright as it should be: density estimates are made up for where their discs hang over edges.

    The picture is emission 0.5, direct light 0.25 and gathered light 0.25. The same seed draws the same shadow rays,
    so taking away the picture without indirect light leaves the gathered part alone, free of direct light's noise.
    Radius-limited discs of radius r next to one of a face's four edges lose in the mean 2 / (3 pi) over a strip of
    width r: over a face of side 1 a photon estimate without correction loses 4 r 2 / (3 pi) = 0.85 r, 1.7 % at
    0.02 m (test_coverage.py looks at the strips themselves). A map of 100,000 photons has a noise of 0.4 %; records
    sample direct light, whose tail is heavy where walls light each other at edges: 2 %. 4.5 sigma over six seeds.
    """
    gathered = []
    for seed in range(6):
        settings = {"width": 16, "height": 16, "gather_count": 1000, "seed": seed, "photon_spacing": spacing}
        whole, rest = (open_session("furnace", indirect=how, **settings) for how in ("final_gather", "none"))
        gathered.append((whole.render().pixels.astype(float) - rest.render().pixels).mean())
    assert np.std(gathered) < 1.5 * noise * 0.25
    assert np.mean(gathered) / 0.25 == pytest.approx(1, abs=4.5 * noise / np.sqrt(6))


@pytest.mark.parametrize("bounces", [0, 1, 2])
def test_gathered_light_has_bounced_as_often_as_photons_may(open_session: Callable[..., Any], bounces: int) -> None:
    """Radiance 0.5 (0.5^2 + ... + 0.5^(bounces + 2)): a gather's own reflections, direct light at its rays' ends, and
    one term for each bounce of a photon. Corners, where a second gather asks in place of the map, add none to them.

    Six seeds, whose noise is held to 2 % as above, and 4.5 sigma. With no bounces there is no photon to ask for:
    a gather that went on all the same would be 0.25, twice as bright.
    """
    gathered = []
    for seed in range(6):
        settings = {"width": 16, "height": 16, "seed": seed, "max_photon_bounces": bounces, "global_photons": 40_000}
        whole, rest = (open_session("furnace", indirect=how, **settings) for how in ("final_gather", "none"))
        gathered.append((whole.render().pixels.astype(float) - rest.render().pixels).mean())
    expected = sum(0.5 * 0.5**order for order in range(2, bounces + 3))
    assert np.std(gathered) < 1.5 * 0.02 * expected
    assert np.mean(gathered) / expected == pytest.approx(1, abs=4.5 * 0.02 / np.sqrt(6))


@pytest.mark.parametrize(
    "method",
    [
        {"indirect": "path"},
        {"indirect": "path", "sampler": "sobol"},
        {"indirect": "final_gather"},
        {"indirect": "final_gather", "sampler": "sobol"},
        {"indirect": "final_gather", "photon_spacing": 0, "gather_filter": "cone"},
        {"indirect": "final_gather", "store_at_every_bounce": False},
        {"indirect": "direct_visualization"},
        {"indirect": "direct_visualization", "gather_filter": "epanechnikov", "gather_count": 30},
    ],
    ids=lambda method: " ".join(map(str, method.values())),
)
def test_the_sphere_furnace(make_scene: Make, open_session: Callable[..., Any], z_score: Z, method: Any) -> None:
    """No edges, so no estimate is biased: a ball of radius r cuts exactly pi r^2 out of a sphere (Archimedes).

    Looking up the nearest of a few records is, a little: those where photons are sparse, which estimate too little,
    are nearest to more places. By the relative variance of an estimate of 50 photons, 2 %, times the share of the
    picture that photons light, a quarter and less, times how far a record's surroundings follow its estimate.

    A light that emits inwards, seen from inside. Each seed's mean is one sample: photons are shared by its pixels.
    """
    scene = make_scene(SPHERE_FURNACE)
    means = np.array(
        [
            open_session(
                scene, seed=seed, width=12, height=12, samples_per_pixel=1, global_photons=20_000,
                gather_distance_m=0.05, **method,
            ).render().pixels.mean(axis=(0, 1))
            for seed in range(10)
        ]
    )  # fmt: skip
    assert np.all(means.std(axis=0) < 0.04)
    for channel in means.T:
        # Ten seeds: Student's t has wider tails than a normal; 8.5 is its 4.5 sigma with nine degrees of freedom.
        nearest = method["indirect"] == "final_gather" and method.get("photon_spacing", 4) > 0
        assert abs(z_score(channel, 1)) < 8.5 or abs(channel.mean() - 1) < (0.005 if nearest else 1e-5)
    assert abs(means.mean() - 1) < 0.01
