"""What pictures promise against Mitsuba's converged ones: default settings to so much relMSE, paths without bias."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench.picture_error import brightness_error, relative_mse
from bench.references import load_reference
from joulebox_render.session import Session
from joulebox_render.settings import make_settings
from scipy import stats

DATA = Path(__file__).parent / "data"
SIZE = 64


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("name", "defines", "limit"),
    [
        ("cornell-boxes", {}, 0.0015),
        ("cornell-spheres", {}, 0.008),
        ("cornell-bunny", {}, 0.003),
        ("cornell-bunny", {"detail": "69666"}, 0.003),
    ],
    ids=["boxes", "spheres", "bunny", "fine bunny"],
)
def test_default_settings_at_full_size(name: str, defines: dict[str, str], limit: float, seed: int) -> None:
    """relMSE, and mean brightness within 0.7 %; the bunny's references are made by `make references`."""
    reference = load_reference(name, defines)
    if reference is None:
        pytest.skip(f"no converged picture of {name} is kept: run `python run.py references {name}`")
    height, width = reference.pixels.shape[:2]
    with Session(name, make_settings({"width": width, "height": height, "seed": seed}), defines) as session:
        pixels = session.render().pixels
    assert relative_mse(pixels, reference.pixels) <= limit
    assert abs(brightness_error(pixels, reference.pixels)) <= 0.007


def assert_no_pixel_is_off(name: str, images: Any, reference_runs: int) -> None:
    """Welch's t-test of each pixel's mean over independent pictures (N, SIZE, SIZE) against Mitsuba's.

    The least of 4096 p's is above 1e-3 by Sidak's correction. Pixels that are the same in all pictures, the lamp and
    the black around the open front, have no spread to judge by and must be the reference's to float's precision.
    """
    runs = len(images)
    with np.load(DATA / f"{name}.npz") as stored:
        assert int(stored["runs"]) == reference_runs
        truth, theirs = (stored[key].astype(np.float64).mean(axis=2) for key in ("mean", "variance_of_mean"))
    ours = images.var(axis=0, ddof=1) / runs
    # Channels of a pixel go together: their mean has at most the mean of their variances.
    flat = images.std(axis=0) < 1e-6
    assert 0 < flat.mean() < 0.1
    np.testing.assert_allclose(images.mean(axis=0)[flat], truth[flat], rtol=1e-3)
    ours, theirs, difference = ours[~flat], theirs[~flat], (images.mean(axis=0) - truth)[~flat]
    freedom = (ours + theirs) ** 2 / (ours**2 / (runs - 1) + theirs**2 / (reference_runs - 1))
    t = difference / np.sqrt(ours + theirs)
    least = float((2 * stats.t.sf(np.abs(t), freedom)).min())
    assert 1 - (1 - least) ** len(t) > 1e-3, (least, len(t))
    assert 0.5 < float((t**2).mean()) < 1.5


def path_traced(open_session: Callable[..., Any], name: str, runs: int, samples: int) -> Any:
    """Independent pictures (runs, SIZE, SIZE) in grey."""
    settings = {"indirect": "path", "width": SIZE, "height": SIZE, "samples_per_pixel": samples, "shadow_rays": 4}
    pictures = [open_session(name, seed=run, **settings).render().pixels for run in range(runs)]
    return np.array(pictures, np.float64).mean(axis=3)


def test_no_pixel_of_path_traced_boxes_is_off(open_session: Callable[..., Any]) -> None:
    """Means of 24 pictures of 16 samples are close to normal where all light is diffuse."""
    assert_no_pixel_is_off("cornell-boxes", path_traced(open_session, "cornell-boxes", 24, 16), 32)


@pytest.mark.long
def test_no_pixel_of_path_traced_spheres_is_off(open_session: Callable[..., Any]) -> None:
    """Paths through glass are rare and bright: a pixel's mean over 16,384 samples is still skewed.

    But the reference's is skewed alike, with as many samples in as many runs: the difference of the two is symmetric,
    and where a bright path has come to only one of them, its own variance knows of it.
    """
    assert_no_pixel_is_off("cornell-spheres", path_traced(open_session, "cornell-spheres", 32, 512), 32)
