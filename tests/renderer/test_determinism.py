"""The same scene, settings and seed give the same pixels, whatever the threads, the chunks and the bands."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from joulebox_render import integrator
from joulebox_render.errors import StoppedError
from joulebox_render.pool import WorkerPool
from joulebox_render.settings import Settings
from joulebox_render.stages import photon_map

SIZE: dict[str, Any] = {
    "width": 20, "height": 13, "samples_per_pixel": 2, "shadow_rays": 5, "final_gather_rays": 7,
    "global_photons": 3000, "caustic_photons": 1500, "gather_count": 20,
}  # fmt: skip
METHODS: dict[str, dict[str, Any]] = {
    "none": {"indirect": "none"},
    "direct_visualization": {"indirect": "direct_visualization", "gather_filter": "cone"},
    "final_gather": {"indirect": "final_gather", "sampler": "independent"},
    "final_gather at every look-up": {"indirect": "final_gather", "photon_spacing": 0},
    "final_gather, absorbed photons": {"indirect": "final_gather", "store_at_every_bounce": False},
    "final_gather, sobol": {"sampler": "sobol", "caustic_hints": True},
    "final_gather, cached": {"irradiance_cache_tolerance": 0.3, "final_gather_rays": 30},
    "path": {"indirect": "path"},
    "path, sobol": {"indirect": "path", "sampler": "sobol"},
}
SCENES = ["cornell-boxes", "cornell-spheres", "caustic-ring", "phong-spheres"]
Render = Callable[..., Any]


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("method", METHODS)
def test_threads_chunks_and_bands_do_not_show(
    render: Render, monkeypatch: pytest.MonkeyPatch, scene: str, method: str
) -> None:
    """Chunks of odd sizes, so that rays fall at all places of vector lanes; bands of one pixel and of three rows."""
    settings = {**SIZE, **METHODS[method]}
    first = render(scene, **settings)
    assert np.isfinite(first.pixels).all()
    assert first.pixels.max() > 0
    for threads, chunk_rays, band_rays in (
        (1, 500, 131_072), (2, 1237, 131_072), (3, 50_000, 131_072), (2, 16_384, 120), (3, 777, 2 * 37),
    ):  # fmt: skip
        monkeypatch.setattr(integrator, "BAND_RAYS", band_rays)
        other = render(scene, chunk_rays=chunk_rays, **{**settings, "threads": threads})
        np.testing.assert_array_equal(other.pixels, first.pixels)
        assert other.pixel_sha256 == first.pixel_sha256
        assert other.photons == first.photons


def test_photons_do_not_depend_on_when_those_left_go_on_together(
    open_session: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From their emission on, after one surface, or never: the same photons in the same order."""
    session = open_session("cornell-spheres", chunk_rays=500, **{**SIZE, "threads": 2})
    usual = photon_map.emit_and_store(session.context)
    for lead in (0, 1, 1000):
        monkeypatch.setattr(photon_map, "LEAD", lead)
        emission = photon_map.emit_and_store(session.context)
        for ours, theirs in (
            (emission.global_photons, usual.global_photons), (emission.caustic_photons, usual.caustic_photons),
        ):  # fmt: skip
            assert len(ours.number) >= 1500
            for column, expected in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(column, expected)


@pytest.mark.parametrize("method", METHODS)
def test_another_seed_gives_other_pixels(render: Render, method: str) -> None:
    settings = {**SIZE, **METHODS[method], "width": 13}
    ours, other = (render("cornell-spheres", seed=seed, **settings).pixels for seed in (0, 1))
    changed = (ours != other).any(axis=-1)
    # The lamp and what is black stay as they are; all the rest is noise of its own.
    assert changed.mean() > 0.8


def test_the_same_session_renders_the_same_image_again(open_session: Callable[..., Any]) -> None:
    session = open_session("cornell-spheres", **SIZE)
    assert session.render().pixel_sha256 == session.render().pixel_sha256


def test_threads_take_part() -> None:
    """Work does go to as many threads as asked for: each chunk waits for two others to be at work."""
    together = threading.Barrier(3, timeout=10)

    def work(first: int, last: int) -> int:
        together.wait()
        return threading.get_ident()

    with WorkerPool(3, chunk_rays=1) as pool:
        assert len(set(pool.map_chunks(work, 3, 1))) == 3


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_chunks_cover_the_work_once_and_in_order(threads: int) -> None:
    with WorkerPool(threads, chunk_rays=100) as pool:
        for count in (0, 1, 7, 99, 100, 101, 1234):
            for rays, together in ((1, 1), (9, 1), (9, 4), (1000, 4)):
                spans = pool.map_chunks(lambda first, last: (first, last), count, rays, together)
                assert [row for first, last in spans for row in range(first, last)] == list(range(count))
                assert max((last - first for first, last in spans), default=0) <= together * max(1, 100 // rays)


@pytest.mark.parametrize("threads", [1, 3])
def test_what_a_chunk_raises_ends_the_work(threads: int) -> None:
    """Whichever thread it is on; an IndexError, too, which a chunk that is out of work might be mistaken for."""
    done: list[int] = []

    def work(first: int, last: int) -> None:
        if first == 5:
            raise IndexError("chunk 5")
        done.append(first)

    with WorkerPool(threads, chunk_rays=1) as pool:
        with pytest.raises(IndexError, match="chunk 5"):
            pool.map_chunks(work, 10_000, 1)
        assert len(done) < 10_000
        assert pool.map_chunks(lambda first, last: first, 3, 1) == [0, 1, 2]
        pool.stop()
        with pytest.raises(StoppedError):
            pool.map_chunks(work, 3, 1)


def test_every_bit_of_a_seed_counts(render: Render) -> None:
    """From 0 to the largest of the schema, beyond what 32 bits and what a double can hold."""
    largest = Settings.model_json_schema()["properties"]["seed"]["maximum"]
    assert largest >= 2**53 + 100_000  # a sweep counts up from a seed that a browser can hold
    seeds = [0, 2**31 - 1, 2**31, 2**32, 2**53, 2**53 + 1, largest - 1, largest]
    pictures = [render("cornell-spheres", seed=seed, **SIZE, sampler="sobol").pixel_sha256 for seed in seeds]
    assert len(set(pictures)) == len(seeds)
