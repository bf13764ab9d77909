"""Against converged pictures by Mitsuba 3, stored with the variance of their mean (data/make_references.py).

A failure leaves the picture, the reference and their difference in tests/failures/.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.images import read_exr, write_exr
from joulebox_render.scene import find_scene
from joulebox_render.session import Session
from joulebox_render.settings import make_settings

HERE = Path(__file__).parent
FAILURES = HERE.parent / "failures"
SCENES = ("cornell-boxes", "cornell-spheres")
SIZE = 64
BLOCK = 8
Render = Callable[..., Any]


@dataclass(frozen=True)
class Reference:
    """mean and variance of that mean, (SIZE, SIZE, 3) f8, over `samples` samples a pixel."""

    mean: Any
    variance: Any
    samples: int


def load_reference(name: str) -> Reference:
    """The stored reference; it must have been made from the scene as it is now."""
    with np.load(HERE / "data" / f"{name}.npz") as stored:
        now = hashlib.sha256(find_scene(name).read_bytes()).hexdigest()
        assert str(stored["scene_file_sha256"]) == now, "the scene changed: run tests/renderer/data/make_references.py"
        samples = int(stored["runs"] * stored["spp"])
        return Reference(stored["mean"].astype(np.float64), stored["variance_of_mean"].astype(np.float64), samples)


def relative_error(image: Any, reference: Any) -> float:
    """relMSE: mean of (3a - 3b)^2 / ((3b)^2 + 0.01), the worst 0.1 % of pixels dropped."""
    error = np.sort((9 * (image - reference) ** 2 / (9 * reference**2 + 0.01)).mean(axis=-1).ravel())
    return float(error[: len(error) - len(error) // 1000].mean())


def blocks(image: Any) -> Any:
    """Sums over BLOCK x BLOCK pixels, (SIZE / BLOCK)^2 x 3."""
    count = SIZE // BLOCK
    return image.reshape(count, BLOCK, count, BLOCK, 3).sum(axis=(1, 3))


@contextmanager
def kept_if_it_fails(name: str, image: Any, reference: Any) -> Iterator[None]:
    """Write actual, reference and their difference where an assertion inside fails."""
    try:
        yield
    except AssertionError:
        FAILURES.mkdir(exist_ok=True)
        pictures = {"actual": image, "reference": reference, "difference": image - reference}
        for part, picture in pictures.items():
            write_exr(FAILURES / f"{name}-{part}.exr", picture.astype(np.float32))
        raise


@pytest.mark.parametrize("name", SCENES)
def test_path_tracing_agrees_with_mitsuba(open_session: Callable[..., Any], name: str) -> None:
    """A z-test on 64 blocks of three channels and on mean brightness.

    Paths through glass have a heavy tail: too few samples underrate both mean and variance. Ours is therefore taken
    as no less than that of Mitsuba's path tracer at as many samples, known from its 16,384. With z near normal,
    beyond 5 in any of 192 blocks is a false alarm in 9,000, beyond 4.5 in the brightness one in 150,000. The mean
    square of z over 64 independent blocks has a standard deviation of 0.18: at most 1 + 4.5 of them, and at least
    half, since our eye rays are stratified.
    """
    reference = load_reference(name)
    runs, samples = 6, 36
    settings = {"indirect": "path", "width": SIZE, "height": SIZE, "samples_per_pixel": samples, "shadow_rays": 4}
    images = np.array([open_session(name, seed=seed, **settings).render().pixels for seed in range(runs)], np.float64)
    mean = images.mean(axis=0)
    ours = np.maximum(
        blocks(images.var(axis=0, ddof=1) / runs),
        blocks(reference.variance) * reference.samples / (runs * samples),
    )
    variance = ours + blocks(reference.variance)
    z = blocks(mean - reference.mean) / np.sqrt(variance)
    with kept_if_it_fails(f"path-{name}", mean, reference.mean):
        assert np.sqrt(variance.sum()) < 0.01 * reference.mean.sum()
        assert np.abs(z).max() < 5
        assert 0.5 < (z**2).mean() < 1.8
        assert abs((mean - reference.mean).sum()) < 4.5 * np.sqrt(variance.sum())


@pytest.mark.parametrize(("name", "limit"), [("cornell-boxes", 0.002), ("cornell-spheres", 0.004)])
def test_final_gathering_agrees_with_mitsuba(render: Render, name: str, limit: float) -> None:
    """Default settings at 64 x 64 and 16 samples: a quarter of the eye rays of the default 256 x 256.

    The bounds at 256 x 256 are relMSE 0.004 and 0.02 and 1.5 % of brightness. Here the errors are 0.0009 and 0.0017
    (noise of the seed, photons' and edges', next to a boundary bias of -0.9 %): the limits are about twice that.
    """
    reference = load_reference(name)
    pixels = render(name, width=SIZE, height=SIZE, samples_per_pixel=16).pixels.astype(np.float64)
    with kept_if_it_fails(f"final-gather-{name}", pixels, reference.mean):
        assert relative_error(pixels, reference.mean) <= limit
        assert abs(pixels.mean() / reference.mean.mean() - 1) <= 0.015


@pytest.mark.long
@pytest.mark.parametrize(("name", "limit"), [("cornell-boxes", 0.004), ("cornell-spheres", 0.02)])
def test_the_default_picture_at_full_size(render: Render, name: str, limit: float) -> None:
    """256 x 256 with default settings: as it is in JOULEBOX_REFERENCES, if that folder is given, and averaged down.

    The folder holds cornell_boxes.exr and cornell_spheres.exr, 256 x 256, converged.
    """
    pixels = render(name).pixels.astype(np.float64)
    reference = load_reference(name).mean
    small = pixels.reshape(SIZE, 4, SIZE, 4, 3).mean(axis=(1, 3))
    with kept_if_it_fails(f"full-size-{name}", small, reference):
        assert relative_error(small, reference) <= limit / 2
        assert abs(small.mean() / reference.mean() - 1) <= 0.015
    folder = os.environ.get("JOULEBOX_REFERENCES")
    if folder:
        given = read_exr(Path(folder) / f"{name.replace('-', '_')}.exr").astype(np.float64)
        with kept_if_it_fails(f"given-{name}", pixels, given):
            assert relative_error(pixels, given) <= limit
            assert abs(pixels.mean() / given.mean() - 1) <= 0.015


@pytest.mark.long
def test_default_settings_on_spheres_outside_their_caustic() -> None:
    """relMSE at most 0.003 where the caustic map brings less than 5 % of the light, 71 % of the picture: 0.0015.

    A blurred caustic must not hide what final gathering gets wrong. The reference is the scene's own, 256 x 256.
    """
    name = "cornell-spheres"

    def picture(**settings: Any) -> Any:
        with Session(name, make_settings(settings)) as session:
            return session.render().pixels.astype(np.float64)

    reference = read_exr(find_scene(name).with_name("reference.exr")).astype(np.float64)
    caustic = picture(indirect="none") - picture(indirect="none", caustics=False)
    outside = caustic.mean(axis=2) < 0.05 * reference.mean(axis=2)
    pixels = picture()
    assert 0.5 < outside.mean() < 0.9
    with kept_if_it_fails("outside-caustic", pixels, reference):
        assert relative_error(pixels[outside], reference[outside]) <= 0.003
