"""Owen-scrambled Sobol sequences: scipy's values underneath, nets after scrambling, and less error at equal rays.

Chi-square tests as in test_samplers: fixed seeds, two-sided at 2e-4 each, a dozen of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from joulebox_render.kernels.rng import (
    SOBOL,
    child_key,
    draw_1d,
    draw_2d,
    path_key,
    reverse_bits,
    sample_2d,
    sobol_2d,
    sobol_second,
)
from joulebox_render.session import Image
from scipy import stats
from scipy.stats import qmc

ALPHA = 2e-4
Render = Callable[..., Image]


def keys(count: int, stream: int = 7) -> list[np.uint64]:
    return [np.uint64(path_key(1, stream, index)) for index in range(count)]


def assert_uniform(counts: Any) -> None:
    """Chi-square of equal cells."""
    p = stats.chisquare(np.asarray(counts, float).ravel()).pvalue
    assert ALPHA / 2 < p < 1 - ALPHA / 2, f"p = {p:.3g}"


def binned(points: Any, bins: int = 16) -> Any:
    """Counts of points (N, 2) in bins x bins cells."""
    return np.histogram2d(*np.asarray(points).T, bins=bins, range=[(0, 1)] * 2)[0]


def assert_net(points: Any) -> None:
    """Every elementary interval of area 1 / N holds one of the N = 2^k points: a (0, k, 2)-net."""
    points = np.asarray(points)
    k = len(points).bit_length() - 1
    assert len(points) == 1 << k
    for a in range(k + 1):
        cells = np.floor(points[:, 0] * (1 << a)) * (1 << (k - a)) + np.floor(points[:, 1] * (1 << (k - a)))
        assert len(np.unique(cells)) == len(points), f"2^{a} x 2^{k - a}"


def test_dimensions_are_scipys() -> None:
    """scipy lists the points in the order of the Gray code."""
    theirs = qmc.Sobol(2, scramble=False, bits=32).random(4096)
    index = np.arange(4096)
    gray = index ^ (index >> 1)
    ours = np.array([(reverse_bits(i), reverse_bits(sobol_second(i))) for i in gray.tolist()], float) * 2.0**-32
    np.testing.assert_array_equal(ours, theirs)


def test_high_indices_follow_the_sequences_definition() -> None:
    """Beyond what a list can hold: the sequence is linear over bits, so points add up by exclusive or of their bits."""
    random = np.random.default_rng(1)
    for a, b in random.integers(0, 2**32, (200, 2)).tolist():
        for bits in (reverse_bits, sobol_second):
            assert int(bits(a)) ^ int(bits(b)) == int(bits(a ^ b))
        assert int(reverse_bits(np.uint64(reverse_bits(a)))) == a
    # A single bit k: column k of Pascal's triangle modulo 2, C(k, j) odd where j's bits are among k's (Lucas).
    for k in range(32):
        column = sum(1 << j for j in range(32) if j & k == j and j <= k)
        assert int(sobol_second(1 << k)) == column


@pytest.mark.parametrize("k", range(9))
def test_every_aligned_run_is_a_net(k: int) -> None:
    for key in keys(4):
        for run in (0, 1, 2, 13):
            assert_net([sobol_2d(key, (run << k) + i) for i in range(1 << k)])


def test_a_run_out_of_line_is_no_net() -> None:
    """The test of nets can fail."""
    with pytest.raises(AssertionError):
        assert_net([sobol_2d(keys(1)[0], 5 + i) for i in range(64)])


@pytest.mark.parametrize("index", [0, 1, 5, 1000, 2**31 + 3])
def test_a_point_is_uniform_over_keys(index: int) -> None:
    assert_uniform(binned([sobol_2d(key, index) for key in keys(16_384)]))


def test_sequences_of_different_keys_are_independent() -> None:
    """A point and the same point of the next key, of a sibling, and of a child; each coordinate with the other."""
    found = keys(16_385)
    here = np.array([sobol_2d(key, 3) for key in found])
    child = np.array([sobol_2d(np.uint64(child_key(key, 1)), 3) for key in found])
    sibling = np.array([sobol_2d(np.uint64(child_key(key, 3)), 3) for key in found])
    for a, b in ((here[1:], here[:-1]), (here[1:], child[1:]), (child[1:], sibling[1:])):
        for column in (0, 1):
            assert_uniform(binned(np.stack([a[:, 0], b[:, column]], -1)))


def test_points_of_a_net_are_random_within_their_cells() -> None:
    """Two points share no half of the square; beyond the bit that keeps them apart they are independent (Owen)."""
    pairs = np.array([(sobol_2d(key, 0), sobol_2d(key, 1)) for key in keys(16_384)])
    assert np.all((pairs[:, 0] < 0.5) != (pairs[:, 1] < 0.5))
    within = (2 * pairs) % 1
    for column in (0, 1):
        assert_uniform(binned(within[:, :, column]))


def test_families_cover_their_space_evenly() -> None:
    """Paths 0 ... of a family and dimension make nets; several points a path go on through one sequence."""
    key = keys(1)[0]
    assert_net([draw_2d(True, key, sample, 1) for sample in range(256)])
    assert_net([sample_2d(key, sample, 1, i, 16, SOBOL) for sample in range(16) for i in range(16)])
    first = [draw_1d(True, key, sample, 0) for sample in range(256)]
    assert sorted(np.floor(np.array(first) * 256).astype(int)) == list(range(256))
    # Dimensions are scrambled apart: a point's place in one tells nothing of its place in another.
    pairs = [
        (draw_1d(True, key, 5, 0), draw_1d(True, key, 5, 5), draw_2d(True, key, 5, 1)[0], draw_2d(True, key, 5, 3)[0])
        for key in keys(16_384)
    ]
    for columns in ((0, 1), (1, 2), (2, 3)):
        assert_uniform(binned(np.array(pairs)[:, columns]))


def test_independent_draws_are_uniform_over_keys_and_samples() -> None:
    for pairs in (
        [draw_2d(False, key, 0, 1) for key in keys(16_384)],
        [draw_2d(False, keys(1)[0], sample, 1) for sample in range(16_384)],
        [(draw_1d(False, keys(1)[0], s, 0), draw_1d(False, keys(1)[0], s + 1, 0)) for s in range(16_384)],
    ):
        assert_uniform(binned(pairs))


# --- less error at equal rays ---

SMALL: dict[str, Any] = {"width": 64, "height": 64, "samples_per_pixel": 1, "jitter": False}
SAMPLERS = ("sobol", "stratified", "independent")


def squared_error(render: Render, sampler: str, exact: Any, seeds: range, **settings: Any) -> Any:
    """Per pixel, relative to the picture's mean brightness, over some seeds."""
    pictures = [render("cornell-boxes", **SMALL, **settings, sampler=sampler, seed=seed).pixels for seed in seeds]
    return np.mean([(picture - exact) ** 2 for picture in pictures], axis=0).sum(axis=-1) / (exact**2).mean()


def test_direct_light_of_penumbrae(render: Render) -> None:
    """16 shadow rays: Sobol < stratified < independent, each by a fifth and more.

    The penumbra is the tenth of the pixels where independent samples of other seeds are worst; in it the integrand
    has an edge, so 4 x 4 strata gain a factor of 4^(1/2) at best and a net a little more.
    """
    direct = {"indirect": "none"}
    exact = render("cornell-boxes", **SMALL, **direct, shadow_rays=4096, seed=9).pixels
    worst = squared_error(render, "independent", exact, range(10, 14), shadow_rays=16, **direct)
    penumbra = worst > np.quantile(worst, 0.9)
    for where in (penumbra, ~penumbra):
        error = {
            sampler: squared_error(render, sampler, exact, range(3), shadow_rays=16, **direct)[where].mean()
            for sampler in SAMPLERS
        }
        assert error["sobol"] < 0.8 * error["stratified"]
        assert error["stratified"] < 0.6 * error["independent"]


def test_final_gathering(render: Render) -> None:
    """64 gather rays against 4096 of the same sampler, whose photon map and shadow rays are the same and cancel."""
    gathered = {"shadow_rays": 1, "global_photons": 30_000, "gather_distance_m": 0.04}
    small = {"width": 32, "height": 32}
    error = {}
    for sampler in SAMPLERS:
        found = []
        for seed in range(2):
            few, many = (
                render("cornell-boxes", **{**SMALL, **small}, **gathered, sampler=sampler, seed=seed,
                       final_gather_rays=count).pixels
                for count in (64, 4096)
            )  # fmt: skip
            found.append(((few - many) ** 2).mean() / (many**2).mean())
        error[sampler] = np.mean(found)
    assert error["sobol"] < 0.9 * error["stratified"], error
    assert error["stratified"] < 0.6 * error["independent"], error
