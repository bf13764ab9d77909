"""Every setting does what it is for: what is measured moves the way that the table says, by at least its factor.

Factors are well inside what theory or a count gives (noise falls with the root of a count, rays grow with it), so
that seeds are not chosen for them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from joulebox_render.images import srgb_bytes
from joulebox_render.session import Image
from joulebox_render.settings import Settings

SMALL: dict[str, Any] = {
    "width": 20, "height": 20, "samples_per_pixel": 1, "jitter": False, "shadow_rays": 4, "final_gather_rays": 8,
    "global_photons": 3000, "caustic_photons": 1000, "gather_count": 50,
}  # fmt: skip
# look(**changes) renders the row's scene with its settings and these changes.
Look = Callable[..., Image]
Measure = Callable[[Look], float]
DIRECT = {"indirect": "none", "caustics": False}
CAUSTICS = {"indirect": "none", "shadow_rays": 1, "caustic_gather_distance_m": 0.05, "caustic_gather_count": 5000}
PHOTONS = {"indirect": "direct_visualization", "caustics": False, "global_photons": 20_000}
GATHERED = {"caustics": False, "global_photons": 20_000, "gather_distance_m": 0.05}
CACHED = {**GATHERED, "final_gather_rays": 256, "width": 48, "height": 48, "irradiance_cache_tolerance": 0.4}


def spread(look: Look) -> float:
    """How far two seeds are apart, relative to the picture: noise. The lamp, ten times as bright, is left out."""
    ours, other = (look(seed=seed).pixels for seed in (1, 2))
    shown = (ours < 3) & (other < 3)
    return float(np.abs(ours - other)[shown].mean() / ours[shown].mean())


def brightness(look: Look) -> float:
    pixels = look().pixels
    return float(pixels[pixels < 3].mean())


def caustic(look: Look, **changes: Any) -> Any:
    """What the caustic map adds; the rest has the same random numbers and cancels."""
    return look(**changes).pixels - look(**changes, caustics=False).pixels


def caustic_peak(look: Look) -> float:
    return float(caustic(look).max())


def rays(stage: str) -> Measure:
    return lambda look: float(look().clock.totals()[stage]["rays"])


def photons(counter: str) -> Measure:
    return lambda look: float(look().photons[counter])


def records(look: Look) -> float:
    return float(look().irradiance_records)


def bending(look: Look) -> float:
    """Mean error against the same render with every point gathered."""
    exact = look(irradiance_cache_tolerance=0.0, final_gather_rays=1024).pixels
    return float(np.abs(look().pixels - exact)[exact < 3].mean())


def caustic_spread(look: Look) -> float:
    """How far two seeds' caustics are apart."""
    ours, other = (caustic(look, seed=seed) for seed in (1, 2))
    return float(np.abs(ours - other).mean() / ours.mean())


def columns(look: Look) -> float:
    return float(look().pixels.shape[1])


def lines(look: Look) -> float:
    return float(look().pixels.shape[0])


class Row(NamedTuple):
    """From `low` to `high`, `measure` becomes at least `factor` times as large (at most, for a factor below 1).

    Factor 1 means that it stays exactly what it was; None that it changes.
    """

    low: Any
    high: Any
    measure: Measure
    factor: float | None
    settings: dict[str, Any] = {}  # noqa: RUF012
    scene: str = "cornell-spheres"


def fingerprint(look: Look) -> float:
    return float(int(look().pixel_sha256[:12], 16))


ROWS: dict[str, Row] = {
    "width": Row(20, 30, columns, 1.5, DIRECT),
    "height": Row(20, 30, lines, 1.5, DIRECT),
    # Noise falls with the root of the samples, within the 36 strata of a pixel faster.
    "samples_per_pixel": Row(1, 36, spread, 0.4, {**DIRECT, "jitter": True}, "cornell-boxes"),
    # One light, one ray, nothing but the place in the pixel is random.
    "jitter": Row(False, True, lambda look: 1 + spread(look), 1.001, DIRECT, "point-light"),
    "seed": Row(0, 1, fingerprint, None, DIRECT),
    "threads": Row(1, 3, fingerprint, 1.0),
    "exposure": Row(1.0, 3.0, fingerprint, 1.0, DIRECT),
    "global_photons": Row(3000, 48_000, spread, 0.6, {**PHOTONS, "shadow_rays": 100}),
    "caustic_photons": Row(300, 10_000, caustic_spread, 0.5, CAUSTICS),
    "max_photon_bounces": Row(0, 64, brightness, 1.1, PHOTONS),
    # A photon of the Cornell box is stored about three times before it is absorbed.
    "store_at_every_bounce": Row(False, True, photons("global_emitted"), 0.6),
    "shadow_rays": Row(1, 36, spread, 0.4, DIRECT, "cornell-boxes"),
    "max_depth": Row(0, 12, brightness, 1.05, DIRECT),
    "indirect": Row("none", "path", brightness, 1.2, DIRECT),
    "gather_count": Row(5, 100, spread, 0.6, {**PHOTONS, "gather_distance_m": 0.1, "shadow_rays": 100}),
    "gather_distance_m": Row(0.005, 0.05, spread, 0.6, {**PHOTONS, "gather_count": 1000, "shadow_rays": 100}),
    # The cone weighs the disc's middle more: fewer photons count, so more noise (the means agree: test_density).
    "gather_filter": Row("constant", "cone", spread, 1.05, {**PHOTONS, "shadow_rays": 100}),
    "photon_spacing": Row(1, 10, records, 0.15),
    "final_gather_rays": Row(4, 64, spread, 0.6, {**GATHERED, "shadow_rays": 100}, "cornell-boxes"),
    "irradiance_cache_tolerance": Row(0.2, 0.8, records, 0.75, CACHED, "cornell-boxes"),
    "irradiance_gradients": Row(False, True, bending, 0.95, CACHED, "cornell-boxes"),
    "caustics": Row(False, True, brightness, 1.005, {"indirect": "none"}),
    "caustic_gather_count": Row(4, 200, caustic_spread, 0.5, {**CAUSTICS, "caustic_gather_distance_m": 0.5}),
    "caustic_gather_distance_m": Row(0.005, 0.1, caustic_peak, 0.5, {**CAUSTICS, "caustic_photons": 10_000}),
    "caustic_hints": Row(False, True, photons("caustic_emitted"), 0.5, {"indirect": "none"}),
    "sampler": Row("independent", "sobol", spread, 0.7, {**DIRECT, "shadow_rays": 16}, "cornell-boxes"),
    "direct_photons": Row(100, 1000, photons("direct_stored"), 5.0, {"use_shadow_photons": True, **DIRECT}),
    "use_shadow_photons": Row(False, True, rays("direct"), 0.98, DIRECT, "cornell-boxes"),
    # Light that comes from few directions (test_importance compares scenes); measured 0.64.
    "importance_sampling": Row(
        False, True, spread, 0.8, {**GATHERED, "final_gather_rays": 64, "shadow_rays": 64}, "corner-light",
    ),
}  # fmt: skip
ELSEWHERE = {"normal_angle_deg"}  # below


def test_every_setting_has_its_direction_written_down() -> None:
    assert {*ROWS, *ELSEWHERE} == set(Settings.model_fields)


@pytest.mark.parametrize("name", ROWS)
def test_a_setting_moves_what_it_is_for(render: Callable[..., Image], name: str) -> None:
    row = ROWS[name]

    def look_at(value: Any) -> Look:
        return lambda **changes: render(row.scene, **{**SMALL, **row.settings, name: value, **changes})

    low, high = row.measure(look_at(row.low)), row.measure(look_at(row.high))
    assert low > 0
    if row.factor is None:
        assert high != low
    elif row.factor == 1:
        assert high == low
    elif row.factor > 1:
        assert high >= row.factor * low, (low, high)
    else:
        assert high <= row.factor * low, (low, high)


def test_exposure_brightens_what_is_displayed(render: Callable[..., Image]) -> None:
    """exposure acts on PNG pictures, by its factor in linear light; see test_render_command for the file."""
    pixels = render("cornell-boxes", **{**SMALL, **DIRECT}).pixels
    assert srgb_bytes(pixels, 3.0).mean() > 1.2 * srgb_bytes(pixels, 1.0).mean()


def test_photons_on_surfaces_turned_away_count_by_the_angle(
    render: Callable[..., Image], make_scene: Callable[..., Path]
) -> None:
    """Inside a ball of radius 1, photons within 0.2 m lie on normals up to 11.5 degrees away, half within 8.

    The lopsided ones of the estimates, one in three or fewer, are made up for what the angle takes from their discs.
    """
    ball = '<shape type="sphere"><boolean name="flip_normals" value="true"/></shape><emitter type="point"/>'
    settings = {**SMALL, "indirect": "direct_visualization", "gather_count": 5000, "gather_distance_m": 0.2}
    scene = make_scene(ball)
    direct = render(scene, **{**settings, "indirect": "none"}).pixels.mean()
    all_, half, none = (
        render(scene, **settings, normal_angle_deg=angle).pixels.mean() - direct for angle in (30, 8.1, 0.01)
    )
    assert 0.45 * all_ < half < 0.7 * all_
    assert none < 0.05 * all_
