"""Importance sampling from the photon map pays where indirect light comes from few directions, elsewhere costs little.

Variance over seeds of the gather rays alone: all pictures share one photon map, and direct light is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render import integrator
from joulebox_render.stages import photon_map, precomputed
from joulebox_render.stages.direct import DirectLight

SEEDS = 5
SETTINGS: dict[str, Any] = {
    "width": 20, "height": 20, "samples_per_pixel": 1, "jitter": False, "shadow_rays": 1, "final_gather_rays": 64,
    "global_photons": 50_000, "gather_distance_m": 0.03, "sampler": "sobol", "caustics": False,
}  # fmt: skip


def wall(matrix: str) -> str:
    return f'<shape type="rectangle"><transform name="to_world"><matrix value="{matrix}"/></transform></shape>'


# A room lit by a spot on its ceiling: a small bright indirect source.
SPOT_ROOM = "".join(
    wall(matrix)
    for matrix in (
        "0 .28 0 0 0 0 .28 -.28 .28 0 0 0 0 0 0 1", ".28 0 0 0 0 0 -.28 .28 0 .28 0 0 0 0 0 1",
        ".28 0 0 0 0 .28 0 0 0 0 .28 -.28 0 0 0 1", "0 0 .28 -.28 .28 0 0 0 0 .28 0 0 0 0 0 1",
        "0 0 -.28 .28 0 .28 0 0 .28 0 0 0 0 0 0 1",
    )
) + (
    '<emitter type="spot"><transform name="to_world"><lookat origin="0,0.1,0.1" target="0.2,0.28,-0.1" '
    'up="0,1,0.1"/></transform><float name="cutoff_angle" value="12"/><rgb name="intensity" value="5"/></emitter>'
)  # fmt: skip
CAMERA = '<transform name="to_world"><lookat origin="0,0,1.08" target="0,0,0" up="0,1,0"/></transform>'


@pytest.fixture
def pictures(monkeypatch: pytest.MonkeyPatch, render: Callable[..., Any]) -> Callable[..., Any]:
    """pictures(scene, **settings): indirect light (SEEDS, 20, 20, 3) of one photon map and several gathers."""
    path_key = photon_map.path_key
    for module in (photon_map, precomputed):
        monkeypatch.setattr(module, "path_key", lambda _seed, *rest: path_key(0, *rest))
    monkeypatch.setattr(
        integrator, "light_directly", lambda _context, points, *_: DirectLight(np.zeros((len(points.owner), 3)), 0)
    )
    return lambda scene, **settings: np.array(
        [render(scene, seed=seed, **SETTINGS, **settings).pixels for seed in range(SEEDS)], np.float64
    )


@pytest.mark.parametrize(
    ("scene", "most"),
    [("spot on the ceiling", 0.35), ("corner-light", 0.92), ("veach-door", 0.95), ("cornell-boxes", 1.15)],
)
def test_noise_at_equal_rays(
    pictures: Callable[..., Any], make_scene: Callable[..., Path], scene: str, most: float
) -> None:
    """Measured ratios of variance: 0.19, 0.72, 0.73 and 0.90; five seeds at 400 pixels are good to a tenth.

    The means agree: what bends the rays does not bend the picture (4.5 standard errors of the mean).
    """
    file = make_scene(SPOT_ROOM, camera=CAMERA, fov_deg=39.3) if " " in scene else scene
    plain, bent = (pictures(file, importance_sampling=on) for on in (False, True))
    shown = plain.mean(axis=0).max(axis=-1) < 3  # not the lamp
    variances = [part.var(axis=0, ddof=1)[shown] for part in (plain, bent)]
    assert variances[1].mean() < most * variances[0].mean(), variances[1].mean() / variances[0].mean()
    difference = (bent.mean(axis=0) - plain.mean(axis=0))[shown].sum()
    # Channels of a pixel share their rays.
    error = np.sqrt(3 * sum(part.sum() for part in variances) / SEEDS)
    assert abs(difference) < 4.5 * error
    assert error < 0.05 * plain.mean(axis=0)[shown].sum()
