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
def test_default_settings_at_full_size(name: str, defines: dict[str, str], limit: float) -> None:
    """relMSE, and mean brightness within 0.7 %; the bunny's references are made by `make references`."""
    reference = load_reference(name, defines)
    if reference is None:
        pytest.skip(f"no converged picture of {name} is kept: run `python run.py references {name}`")
    height, width = reference.pixels.shape[:2]
    with Session(name, make_settings({"width": width, "height": height}), defines) as session:
        pixels = session.render().pixels
    assert relative_mse(pixels, reference.pixels) <= limit
    assert abs(brightness_error(pixels, reference.pixels)) <= 0.007


def test_no_pixel_of_a_path_traced_picture_is_off(open_session: Callable[..., Any]) -> None:
    """A z-test on each pixel of cornell-boxes against Mitsuba's mean and variance: the least p of 4096, by Sidak's
    correction, is above 1e-3.

    Our mean is that of 24 pictures of 16 samples, close to normal; Student's t with 23 degrees of freedom allows for
    its variance being estimated. On spheres paths through glass have too heavy a tail for single pixels; test_reference
    holds its blocks.
    """
    with np.load(DATA / "cornell-boxes.npz") as stored:
        truth, variance = (stored[key].astype(np.float64).mean(axis=2) for key in ("mean", "variance_of_mean"))
    runs = 24
    settings = {"indirect": "path", "width": SIZE, "height": SIZE, "samples_per_pixel": 16, "shadow_rays": 4}
    pictures = [open_session("cornell-boxes", seed=run, **settings).render().pixels for run in range(runs)]
    images = np.array(pictures, np.float64).mean(axis=3)
    # Channels of a pixel go together: their mean has at most the mean of their variances.
    error = np.sqrt(images.var(axis=0, ddof=1) / runs + variance)
    flat = images.std(axis=0) < 1e-6
    # The lamp, and the black around the open front.
    assert 0 < flat.mean() < 0.1
    np.testing.assert_allclose(images.mean(axis=0)[flat], truth[flat], rtol=1e-3)
    t = (images.mean(axis=0) - truth)[~flat] / error[~flat]
    least = float(2 * stats.t.sf(np.abs(t).max(), runs - 1))
    assert 1 - (1 - least) ** len(t) > 1e-3, (least, len(t))
    assert 0.5 < float((t**2).mean()) < 1.5
