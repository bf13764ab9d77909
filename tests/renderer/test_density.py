"""Photon density estimates over planes whose irradiance is known.

A plane carries photons of flux 2 W as a Poisson process of DENSITY a square metre: its irradiance is
E = 2 DENSITY. Queries lie farther apart than two discs reach, so their estimates are independent and the standard
error of their mean follows from their spread. Two-sided at 4.5 sigma (a false alarm in 150,000); each test also
holds the spread to a few per cent, so that the bias of k / (k - 1), 4 % and more here, could not hide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from joulebox_render.kernels.gathering import kernel_weight
from joulebox_render.kernels.lookup import nearest_records
from joulebox_render.records import Photons, Scratch
from joulebox_render.stages.density import FILTERS, DensityEstimate
from joulebox_render.stages.photon_map import PhotonMap, build_photon_map, grow_tree

DENSITY = 10_000.0
FLUX = 2.0
IRRADIANCE = FLUX * DENSITY
SIGMAS = 4.5
COS_LIMIT = math.cos(math.radians(30))
Z = Callable[[Any, float], float]


def photons_at(position: Any, flux: float = FLUX, normal: Any = (0, 0, 1)) -> Photons:
    count = len(position)
    photons = Photons.empty(count)
    photons.position[:], photons.normal[:] = position, normal
    photons.flux[:] = flux * np.array([1, 0.5, 0.25])
    photons.number[:] = np.arange(count)
    return photons


def plane(width_m: float, seed: int = 1) -> PhotonMap:
    """Photons at random on z = 0, |x|, |y| < width / 2."""
    random = np.random.default_rng(seed)
    count = random.poisson(DENSITY * width_m**2)
    position = np.zeros((count, 3), np.float32)
    position[:, :2] = (random.random((count, 2)) - 0.5) * width_m
    return build_photon_map(photons_at(position), 1, count)


def lattice(width_m: float, step_m: float) -> Any:
    """Points of the plane `step` apart."""
    line = np.arange(-width_m / 2, width_m / 2 + 1e-9, step_m, dtype=np.float32)
    x, y = np.meshgrid(line, line)
    return np.ascontiguousarray(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], -1))


def estimates(photons: PhotonMap, at: Any, k: int, reach_m: float, kind: str, normal: Any = (0, 0, 1)) -> Any:
    """Irradiance (N, 3) at points facing `normal`."""
    normals = np.tile(np.array(normal, np.float32), (len(at), 1))
    estimate = DensityEstimate(photons, k, reach_m, COS_LIMIT, FILTERS[kind])
    return estimate(at, normals, np.zeros(len(at), np.uint64)).irradiance.astype(np.float64)


# A disc that holds 30 photons in the mean reaches 0.031 m; k = 4000 is never reached there, k = 25 always at 0.2 m,
# and at k = 30 within 0.031 m either happens half the time.
LIMITS = {"radius": (4000, 0.031), "k": (25, 0.2), "either": (30, 0.031), "few": (4, 0.2)}


@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("kind", FILTERS)
def test_a_uniform_plane_is_estimated_without_bias(kind: str, limit: str, z_score: Z) -> None:
    k, reach_m = LIMITS[limit]
    found = estimates(plane(3.2), lattice(2.88, 0.08), k, reach_m, kind)
    np.testing.assert_allclose(found[:, 1], found[:, 0] / 2, rtol=1e-5)
    np.testing.assert_allclose(found[:, 2], found[:, 0] / 4, rtol=1e-5)
    # 1369 discs of about 30 photons (3 at "few"): 0.5 % (2 %), while k / (k - 1) is 3.4 % (33 %).
    assert found[:, 0].std() / math.sqrt(len(found)) < (0.03 if limit == "few" else 0.008) * IRRADIANCE
    assert abs(z_score(found[:, 0], IRRADIANCE)) < SIGMAS


@pytest.mark.parametrize("kind", FILTERS)
def test_filters_have_mean_one_over_the_disc(kind: str) -> None:
    share = (np.arange(20_000) + 0.5) / 20_000
    weights = np.array([kernel_weight(FILTERS[kind], share2) for share2 in share])
    assert weights.mean() == pytest.approx(1, abs=1e-3)
    assert weights.min() >= 0
    assert np.all(np.diff(weights) <= 0)


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize(("place", "share"), [("edge", 0.5), ("corner", 0.25)])
@pytest.mark.parametrize("limit", ["radius", "k"])
def test_boundary_bias_is_the_share_of_the_disc_that_hangs_over(
    kind: str, place: str, share: float, limit: str, z_score: Z
) -> None:
    """Jensen 2001, section 7.2: half the irradiance at an edge, a quarter at a corner, whatever the filter."""
    k, reach_m = {"radius": (4000, 0.031), "k": (10, 0.3)}[limit]
    values = []
    for seed in range(12 if place == "edge" else 150):
        photons = plane(2.0 if place == "edge" else 0.5, seed)
        line = np.arange(-0.85, 0.851, 0.1) if place == "edge" else np.array([0.25])
        at = np.zeros((len(line), 3), np.float32)
        at[:, 0], at[:, 1] = (1.0, line) if place == "edge" else (0.25, 0.25)
        values += list(estimates(photons, at, k, reach_m, kind)[:, 0])
    assert abs(z_score(values, share * IRRADIANCE)) < SIGMAS
    assert np.std(values) / math.sqrt(len(values)) < 0.04 * share * IRRADIANCE


def test_photons_of_a_surface_turned_away_do_not_count(z_score: Z) -> None:
    """A wall's photons next to a floor, and the floor's other side."""
    floor = plane(1.0)
    at = lattice(0.8, 0.08)
    assert estimates(floor, at, 50, 0.03, "constant", (0, 0, -1)).max() == 0
    assert estimates(floor, at, 50, 0.03, "constant", (1, 0, 0)).max() == 0
    tilted = (math.sin(math.radians(25)), 0, math.cos(math.radians(25)))
    assert abs(z_score(estimates(floor, at, 50, 0.03, "constant", tilted)[:, 0], IRRADIANCE)) < SIGMAS


def test_nothing_within_reach_is_dark() -> None:
    found = estimates(plane(0.1), np.array([[0, 0, 1], [5, 0, 0]], np.float32), 10, 0.5, "constant")
    np.testing.assert_array_equal(found, 0)


def test_no_photons_at_all_is_dark() -> None:
    empty = build_photon_map(Photons.empty(0), 1000, 10)
    assert not empty.complete
    np.testing.assert_array_equal(estimates(empty, np.zeros((3, 3), np.float32), 10, 0.5, "cone"), 0)


def test_flux_is_divided_by_the_number_emitted() -> None:
    position = np.random.default_rng(4).random((100, 3))
    one, many = (build_photon_map(photons_at(position), emitted, 100) for emitted in (1, 250))
    np.testing.assert_allclose(many.flux * 250, one.flux, rtol=1e-6)
    assert one.flux.sum(axis=0) == pytest.approx(100 * FLUX * np.array([1, 0.5, 0.25]), rel=1e-5)


def test_a_photon_at_the_point_itself_is_finite() -> None:
    """Photons that coincide with the point: no division by zero."""
    photons = build_photon_map(photons_at(np.zeros((30, 3))), 1, 30)
    for k in (2, 30, 31):
        assert np.isfinite(estimates(photons, np.zeros((1, 3), np.float32), k, 0.1, "cone")).all()


def test_the_order_of_the_photons_does_not_matter() -> None:
    """Up to the order of the sum: single-precision rounding of sums over 40 photons."""
    random = np.random.default_rng(6)
    position = random.random((2000, 3)) * (1, 1, 0)
    at = lattice(0.5, 0.05) + np.float32(0.5) * np.array([1, 1, 0], np.float32)
    first, second = (
        estimates(build_photon_map(photons_at(chosen), 1, 2000), at, 40, 0.2, "epanechnikov")
        for chosen in (position, position[random.permutation(2000)])
    )
    np.testing.assert_allclose(first, second, rtol=1e-5)


def test_the_nearest_record_is_looked_up() -> None:
    random = np.random.default_rng(8)
    position = (random.random((500, 3)) * (1, 1, 0)).astype(np.float32)
    records = random.random((500, 3), np.float32)
    tree, order = grow_tree(position, np.tile(np.array([0, 0, 1], np.float32), (500, 1)))
    at = (random.random((200, 3)) * (1.5, 1.5, 0)).astype(np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (200, 1))
    row = np.empty(200, np.int32)
    nearest_records(tree, at, normal, 0.2, COS_LIMIT, Scratch.empty(1), row)
    found = np.where(row[:, None] >= 0, records[order][row], 0)
    distance = np.linalg.norm(at[:, None, :] - position, axis=2)
    expected = np.where(distance.min(axis=1)[:, None] < 0.2, records[distance.argmin(axis=1)], 0)
    np.testing.assert_array_equal(found, expected)
    assert (expected == 0).all(axis=1).any(), "some points lie beyond reach"
