"""No light is counted twice or lost, however it is split between direct, indirect and caustics.

cornell-spheres holds all kinds of paths; its converged picture (data/, by Mitsuba's path tracer, which knows no such
split) is the truth. A kind of light that is left out or doubled shifts `counted` by 1.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render.session import Session
from joulebox_render.settings import make_settings
from plain_settings import PLAIN

SIZE = 64
SETTINGS: dict[str, Any] = {**PLAIN, "width": SIZE, "height": SIZE, "samples_per_pixel": 9}
WAYS: dict[str, dict[str, Any]] = {
    "final_gather": {"indirect": "final_gather"},
    "final_gather at every look-up": {"photon_spacing": 0, "final_gather_rays": 16, "gather_count": 40},
    "final_gather, rays find caustics": {"indirect": "final_gather", "caustics": False},
    "final_gather, no caustic photons": {"indirect": "final_gather", "caustic_photons": 0},
    "final_gather, absorbed photons": {"indirect": "final_gather", "store_at_every_bounce": False},
    "direct_visualization": {"indirect": "direct_visualization"},
    "direct_visualization, one map": {"indirect": "direct_visualization", "caustics": False},
    "direct_visualization, no caustic photons": {"indirect": "direct_visualization", "caustic_photons": 0},
}
Render = Callable[..., Any]


@pytest.fixture(scope="module")
def truth() -> Any:
    with np.load(Path(__file__).parent / "data" / "cornell-spheres.npz") as stored:
        return stored["mean"].astype(np.float64)


@functools.cache
def rendered(settings: tuple[tuple[str, Any], ...]) -> Any:
    """Pixels of cornell-spheres; several tests look at the same picture."""
    with Session("cornell-spheres", make_settings(SETTINGS, dict(settings))) as session:
        return session.render().pixels.astype(np.float64)


def picture(**settings: Any) -> Any:
    return rendered(tuple(settings.items()))


def counted(image: Any, truth: Any, part: Any, where: Any) -> float:
    """How many times too often `part` of the light is in the image: 0 when right, -1 left out, 1 doubled."""
    return float((image - truth)[where].sum() / part[where].sum())


@pytest.fixture
def caustics(truth: Any) -> tuple[Any, Any]:
    """Light of the caustic map alone, and where it makes up at least a third of what is seen."""
    part = picture(indirect="none") - picture(indirect="none", caustics=False)
    where = part.sum(axis=-1) > truth.sum(axis=-1) / 3
    assert 20 < where.sum() < SIZE * SIZE / 4
    return part, where


@pytest.mark.parametrize("way", WAYS)
def test_caustics_are_counted_once(truth: Any, caustics: tuple[Any, Any], way: str) -> None:
    """Where caustics are bright. 0.2 allows for their blur by the gather disc and for the noise of gather rays."""
    part, where = caustics
    assert abs(counted(picture(**WAYS[way]), truth, part, where)) < 0.2


def test_without_indirect_light_caustics_can_be_left_out(caustics: tuple[Any, Any]) -> None:
    """The measure itself: with and without the map differ by one."""
    part, where = caustics
    shown, left_out = (picture(indirect="none", caustics=on) for on in (True, False))
    assert counted(shown, left_out, part, where) == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("way", WAYS)
def test_the_whole_is_as_bright_as_it_should_be(truth: Any, way: str) -> None:
    """1.5 % of the mean, where indirect light makes up a third of it and caustics several per cent."""
    direct = picture(indirect="none", caustics=False)
    assert 0.2 < 1 - direct.mean() / truth.mean() < 0.8
    assert picture(**WAYS[way]).mean() == pytest.approx(truth.mean(), rel=0.015)


@pytest.mark.parametrize("way", [*WAYS, "none", "path"])
def test_the_lamp_is_seen_with_its_radiance_once(truth: Any, way: str) -> None:
    """Pixels inside the lamp are 15 exactly, by any method: black but for its emission."""
    lamp = np.all(np.abs(truth - 15) < 1e-3, axis=-1)
    assert lamp.sum() >= 10
    settings = WAYS.get(way, {"indirect": way})
    np.testing.assert_allclose(picture(**settings)[lamp], 15, rtol=1e-6)


@pytest.mark.parametrize("indirect", ["direct_visualization", "final_gather"])
def test_indirect_light_leaves_out_direct_light(render: Render, indirect: str) -> None:
    """A floor alone under a lamp gets nothing from elsewhere: the method adds nothing to direct light."""
    settings = {**SETTINGS, "global_photons": 5000, "shadow_rays": 4}
    plain = render("caustic-ring", indirect="none", caustics=False, **settings).pixels.astype(np.float64)
    image = render("caustic-ring", indirect=indirect, **settings).pixels.astype(np.float64)
    only = render("caustic-ring", indirect="none", **settings).pixels.astype(np.float64)
    np.testing.assert_allclose(image, only, rtol=1e-5, atol=1e-7)
    assert only.mean() > plain.mean()
