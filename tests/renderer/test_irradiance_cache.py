"""The irradiance cache: gradients against finite differences, interpolation, neighbour clamping, and its pictures."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from joulebox_render.clock import StageClock
from joulebox_render.integrator import illumination, make_maps
from joulebox_render.kernels.irradiance import clamp_neighbours, interpolate_irradiance, summarize_gather
from joulebox_render.kernels.rng import path_key
from joulebox_render.records import Points
from joulebox_render.session import Image
from joulebox_render.stages.eye import camera_frame, look
from joulebox_render.stages.gather import NOT_BENT, aim_gather
from joulebox_render.stages.irradiance_cache import (
    MOST_PIXELS,
    CacheRecords,
    IrradianceCache,
    Strata,
    fill_cache,
    gather_again,
    gather_grids,
    gather_records,
    index_records,
    least_pixels,
)

Open = Callable[..., Any]
Render = Callable[..., Image]
# Radiance comes from the plane z = 1 alone; a channel each: a broad blob, a blob off to a side, a lit rectangle.
POLAR, AZIMUTH = 48, 150
# A tolerance under which the nearest surface does not limit a record.
LOOSE = 0.1
RECTANGLE = ((-0.4, 0.3), (-0.2, 0.9))
TILTED = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])


def radiance(x: Any, y: Any) -> Any:
    """(..., 3) at places of the plane."""
    lit = (x > RECTANGLE[0][0]) & (x < RECTANGLE[0][1]) & (y > RECTANGLE[1][0]) & (y < RECTANGLE[1][1])
    return np.stack([np.exp(-(x**2 + y**2) / 4), np.exp(-((x - 0.7) ** 2 + (y + 0.4) ** 2)), lit * 1.0], -1)


def exact_irradiance(position: Any, normal: Any) -> Any:
    """(3,) irradiance by midpoint sums over the plane: L cos cos' / d^2; independent of directions and strata."""
    step = 0.01
    x, y = np.meshgrid(np.arange(-6, 6, step) + step / 2, np.arange(-6, 6, step) + step / 2)
    to = np.stack([x - position[0], y - position[1], np.full_like(x, 1 - position[2])], -1)
    d2 = (to**2).sum(-1)
    weight = np.maximum(0, to @ normal) * to[..., 2] / d2**2 * step**2
    return np.einsum("yx,yxc->c", weight, radiance(x, y))


def points_at(position: Any, normal: Any) -> Points:
    count = len(position)
    points = Points.empty(count)
    points.position[:], points.normal[:], points.geometric[:] = position, normal, normal
    points.albedo[:], points.weight[:], points.distance[:] = 1, 1, 1
    points.owner[:], points.sample[:] = np.arange(count), 0
    points.key[:] = [path_key(4, 9, index) for index in range(count)]
    return points


def gathered(points: Points, polar: int = POLAR, azimuth: int = AZIMUTH) -> CacheRecords:
    """Records of stratified gathers under the plane."""
    count = polar * azimuth
    records = CacheRecords.empty(len(points.owner))
    for row in range(len(points.owner)):
        rays = aim_gather(points, row, row + 1, count, polar, NOT_BENT)
        z = rays.direction[:, 2].astype(float)
        distance = np.where(z > 1e-3, (1 - points.position[row, 2]) / np.maximum(z, 1e-3), 1e3)
        at = points.position[row] + distance[:, None] * rays.direction
        incident = np.where(z[:, None] > 1e-3, radiance(at[:, 0], at[:, 1]), 0.0)
        near, far = np.zeros(1, np.float32), np.full(1, 1e9, np.float32)
        summarize_gather(
            points,
            row,
            Strata.of(polar, azimuth),
            LOOSE,
            incident,
            distance.astype(np.float32),
            near,
            far,
            records,
            row,
        )
    return records


PLACES = [(0.0, 0.0, 0.0), (0.5, -0.3, 0.1), (-0.6, 0.8, 0.0)]
NORMALS = {"upright": np.array([0.0, 0.0, 1.0]), "tilted": TILTED}


@pytest.mark.parametrize("place", range(len(PLACES)))
@pytest.mark.parametrize("normal", NORMALS)
def test_gradients_are_those_of_the_irradiance(place: int, normal: str) -> None:
    """Central differences of the plane's irradiance along two tangents, and about them.

    7200 strata with jitter: 1 % of the irradiance's own size, by which all is measured; the rectangle's edges, which
    strata see as steps, 4 %. A sign or a frame that is wrong is off by the whole gradient, a third and more.
    """
    position, n = np.array(PLACES[place]), NORMALS[normal]
    records = gathered(points_at([position], n))
    exact = exact_irradiance(position, n)
    assert np.all(np.abs(records.irradiance[0] - exact) < np.array([0.005, 0.005, 0.03]) * exact)
    across = np.cross(n, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    largest = 0.0
    for axis in (across, np.cross(n, across)):
        moved = [exact_irradiance(position + s * 0.02 * axis, n) for s in (1, -1)]
        slope = (moved[0] - moved[1]) / 0.04
        turned = []
        for s in (1, -1):
            other = n * math.cos(0.02) + s * math.sin(0.02) * np.cross(axis, n)
            turned.append(exact_irradiance(position, other))
        turn = (turned[0] - turned[1]) / 0.04
        for wanted, found in ((slope, records.translation), (turn, records.rotation)):
            got = found[0].reshape(3, 3) @ axis
            allowed = np.array([0.02, 0.02, 0.05]) * exact
            assert np.all(np.abs(got - wanted) < allowed), (got, wanted, exact)
            largest = max(largest, float(np.abs(wanted / exact).max()))
    assert largest > 0.3, "the field is meant to change"


def test_gradients_lie_in_the_tangent_plane() -> None:
    records = gathered(points_at([PLACES[1]], TILTED), 12, 36)
    for gradient in (records.translation, records.rotation):
        np.testing.assert_allclose(gradient[0].reshape(3, 3) @ TILTED, 0, atol=1e-5)


def test_the_radius_is_the_harmonic_mean_distance() -> None:
    """Under a plane of one radiance at height h, 1 / distance is cos / h, 2 / (3 h) in the mean."""
    points = points_at([PLACES[0]], NORMALS["upright"])
    rays = aim_gather(points, 0, 1, 12 * 36, 12, NOT_BENT)
    distance = (0.8 / np.maximum(rays.direction[:, 2], 1e-3)).astype(np.float32)
    records = CacheRecords.empty(1)
    bounds = np.zeros(1, np.float32), np.full(1, 1e9, np.float32)
    for tolerance in (LOOSE, 1.6):
        summarize_gather(
            points, 0, Strata.of(12, 36), tolerance, np.ones((12 * 36, 3)), distance.copy(), *bounds, records, 0
        )
        # A record does not reach beyond the nearest surface, here straight above: tolerance x radius <= height.
        expected = min(1.5 * 0.8, 0.8 / tolerance)
        assert records.radius[0] == pytest.approx(expected, rel=0.01 if tolerance == LOOSE else 0.1)
        assert tolerance == LOOSE or tolerance * records.radius[0] >= 0.8
        np.testing.assert_allclose(records.irradiance, math.pi, rtol=1e-6)
        np.testing.assert_allclose(records.translation, 0, atol=1e-6)


def test_steep_gradients_shorten_the_radius() -> None:
    """Where the gradient would change the irradiance by more than itself over the mean distance, its length wins."""
    records = gathered(points_at(PLACES, NORMALS["upright"]))
    for row, place in enumerate(PLACES):
        slopes = np.linalg.norm(records.translation[row].reshape(3, 3), axis=1)
        longest = 1 / (slopes / records.irradiance[row]).max()
        assert records.radius[row] == pytest.approx(min(1.5 * (1 - place[2]), longest), rel=0.01)


def test_bounds_of_the_radius_are_kept_and_gradients_scaled() -> None:
    points = points_at([PLACES[1]] * 3, NORMALS["upright"])
    free = gathered(points, 12, 36)
    near = np.array([0.0, 5.0, 0.0], np.float32)
    far = np.array([1e9, 1e9, 0.25], np.float32)
    count = 12 * 36
    bound = CacheRecords.empty(3)
    for row in range(3):
        rays = aim_gather(points, row, row + 1, count, 12, NOT_BENT)
        distance = (1 - points.position[row, 2]) / rays.direction[:, 2].astype(float)
        at = points.position[row] + distance[:, None] * rays.direction
        summarize_gather(
            points, row, Strata.of(12, 36), LOOSE, radiance(at[:, 0], at[:, 1]), distance.astype(np.float32),
            near[row : row + 1], far[row : row + 1], bound, row,
        )  # fmt: skip
    np.testing.assert_allclose(bound.radius, [free.radius[0], 5.0, 0.25], rtol=1e-6)
    np.testing.assert_allclose(bound.translation[1], free.translation[1] * free.radius[1] / 5.0, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(bound.translation[2], free.translation[2], rtol=1e-4, atol=1e-6)


# --- interpolation ---


def asked(cache: IrradianceCache, points: Points, tolerance: float, gradients: bool) -> tuple[Any, Any]:
    irradiance, radius = np.empty((len(points.owner), 3), np.float32), np.empty(len(points.owner), np.float32)
    interpolate_irradiance(cache.records, cache.grid, tolerance, gradients, points, irradiance, radius)
    return irradiance.astype(float), (radius > 0).astype(int)


def test_gradients_make_interpolation_better() -> None:
    """Records 0.3 m apart under the plane, asked between with the normal turned a little: half the error and less.

    The broad blob is flat and its records' differences cancel anyway: there gradients must do no harm.
    """
    line = np.arange(-0.9, 0.91, 0.3)
    records = gathered(points_at([(x, y, 0) for x in line for y in line], NORMALS["upright"]), 24, 75)
    cache = index_records(records, 0.4)
    random = np.random.default_rng(2)
    places = np.column_stack([random.uniform(-0.6, 0.6, (12, 2)), np.zeros(12)])
    normals = np.array([0, 0, 1]) + np.column_stack([random.uniform(-0.08, 0.08, (12, 2)), np.zeros(12)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    exact = np.array([exact_irradiance(place, n) for place, n in zip(places, normals, strict=True)])
    error = {}
    for gradients in (False, True):
        irradiance, found = asked(cache, points_at(places, normals), 0.4, gradients)
        assert found.all()
        error[gradients] = np.sqrt((((irradiance - exact) / exact) ** 2).mean(axis=0))
    assert np.all(error[True][1:] < 0.5 * error[False][1:]), error
    assert np.all(error[True] < [0.01, 0.02, 0.04]), error


def test_a_record_answers_for_its_place_and_not_beyond_its_reach() -> None:
    """Error |x - x_i| / R + sqrt(1 - cos): found within the tolerance, on one side of it and the other."""
    records = gathered(points_at([(0, 0, 0)], NORMALS["upright"]), 12, 36)
    radius = float(records.radius[0])
    tolerance = 0.3
    cache = index_records(records, tolerance)
    turn = 2 * math.asin(0.299 / math.sqrt(2))
    places = [(0.299 * radius, 0, 0), (0.301 * radius, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, -0.1 * radius)]
    normals = [(0, 0, 1)] * 2 + [(math.sin(turn), 0, math.cos(turn)), (math.sin(1.02 * turn), 0, math.cos(1.02 * turn))]
    normals.append((0, 0, 1))
    irradiance, found = asked(cache, points_at(places, normals), tolerance, False)
    assert found.tolist() == [1, 0, 1, 0, 0]
    np.testing.assert_allclose(irradiance[[0, 2]], np.repeat(records.irradiance, 2, axis=0), rtol=1e-6)
    np.testing.assert_array_equal(irradiance[[1, 3, 4]], 0)


# --- neighbour clamping ---


@pytest.mark.parametrize("seed", range(4))
def test_no_radius_exceeds_a_neighbours_by_more_than_their_distance(seed: int) -> None:
    """R_i <= R_j + d_ij for all that a record's reach holds; no radius grows, nor falls under the least."""
    random = np.random.default_rng(seed)
    records = CacheRecords.empty(300)
    records.position[:] = random.random((300, 3))
    records.normal[:, 2] = 1
    before = np.exp(random.uniform(-3, 1, 300)).astype(np.float32)
    records.radius[:] = before
    tolerance = (0.1, 0.3, 1.0, 3.0)[seed]
    cache = index_records(records, tolerance)
    radius = records.radius.astype(float)
    distance = np.linalg.norm(records.position[:, None, :].astype(float) - records.position[None], axis=-1)
    reaches = distance < tolerance * radius[:, None]
    assert np.all((radius[:, None] <= (radius + distance) * (1 + 1e-5))[reaches])
    assert (radius < before).sum() > 20
    assert np.all(radius <= before)
    assert radius.min() == before.min()
    clamped = records.radius.copy()
    clamp_neighbours(records, cache.grid, tolerance, np.ones(300, np.uint8))
    np.testing.assert_array_equal(records.radius, clamped)


# --- gathers that are made again ---

ONCE: dict[str, Any] = {"irradiance_cache_tolerance": 0.8, "samples_per_pixel": 1, "sampler": "sobol"}


def test_unsure_gathers_are_made_again_with_four_times_the_rays(open_session: Open) -> None:
    """In `corner-light` few rays find the light. What is gathered again errs by less than 0.75 as much, half at best.

    Errors are relative to gathers of 64 times the rays. Gathers that are sure stay as they are, to the last bit.
    """
    session = open_session("corner-light", width=24, height=24, final_gather_rays=80, **ONCE)
    context, camera = session.context, session.scene.camera
    light = illumination(context, make_maps(context, StageClock()))
    points = look(context, camera, 0, 24 * 24).direct
    once, doubt = gather_grids(context, camera, light, points, 5, 16)
    exact, _ = gather_grids(context, camera, light, points, 40, 128)
    unsure = gather_again(doubt)
    records = gather_records(context, camera, light, points)
    assert 0.1 < unsure.mean() < 0.9

    def error(found: CacheRecords) -> float:
        truth = exact.irradiance[unsure].sum(axis=1)
        return float(np.sqrt(((found.irradiance[unsure].sum(axis=1) / truth - 1) ** 2).mean()))

    assert error(records) < 0.75 * error(once)
    np.testing.assert_array_equal(records.irradiance[~unsure], once.irradiance[~unsure])


def test_doubt_is_the_standard_error_of_the_mean(open_session: Open) -> None:
    """Where one ray of 80 brings all the light it is sqrt(1 - 1 / 80), in even light none, in the dark none."""
    session = open_session("furnace", width=4, height=4, final_gather_rays=80, **ONCE)
    context, camera = session.context, session.scene.camera
    points = look(context, camera, 0, 16).direct
    rows_of = {"one": 0, "even": 1, "dark": 2}

    def lit(_context: Any, _light: Any, rays: Any) -> tuple[Any, Any]:
        incident = np.zeros((len(rays.owner) // 80, 80, 3))
        incident[rows_of["one"], 17] = 3.0
        incident[rows_of["even"]] = 0.5
        return incident.reshape(-1, 3), np.ones(len(rays.owner), np.float32)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("joulebox_render.stages.irradiance_cache.incident_radiance", lit)
        three = Points(*(column[:3].copy() for column in points))
        _, doubt = gather_grids(context, camera, None, three, 5, 16)  # type: ignore[arg-type]
    np.testing.assert_allclose(doubt, [math.sqrt(1 - 1 / 80), 0, 0], atol=1e-9)


# --- pictures ---

SMALL: dict[str, Any] = {
    "width": 20, "height": 14, "samples_per_pixel": 2, "shadow_rays": 3, "final_gather_rays": 30,
    "global_photons": 3000, "caustic_photons": 800, "gather_count": 20, "irradiance_cache_tolerance": 0.3,
}  # fmt: skip


@pytest.mark.parametrize("scene", ["cornell-boxes", "cornell-spheres", "caustic-ring"])
@pytest.mark.parametrize("changes", [{}, {"irradiance_gradients": False}, {"sampler": "sobol"}], ids=str)
def test_threads_and_chunks_do_not_show(render: Render, scene: str, changes: dict[str, Any]) -> None:
    settings = {**SMALL, **changes}
    first = render(scene, **settings)
    assert first.irradiance_records > (1 if scene == "caustic-ring" else 50)
    for threads, chunk_rays in ((1, 400), (3, 1237), (2, 50_000)):
        other = render(scene, chunk_rays=chunk_rays, **{**settings, "threads": threads})
        np.testing.assert_array_equal(other.pixels, first.pixels)
        assert other.pixel_sha256 == first.pixel_sha256
        assert other.irradiance_records == first.irradiance_records


LARGER: dict[str, Any] = {
    "width": 48, "height": 48, "samples_per_pixel": 1, "shadow_rays": 1, "global_photons": 30_000,
    "gather_distance_m": 0.04,
}  # fmt: skip


@pytest.fixture
def relative_error(render: Render) -> Callable[..., tuple[float, Image]]:
    """Mean squared relative error of a render of the boxes, and its image.

    Against every point gathered with 2048 rays: the same eye rays, photons and shadow rays, so only the cache
    differs. The worst 0.5 % are left out: contacts and the gap over the lamp are narrower than the least spacing of
    records (1.5 pixels) in a picture this small.
    """
    exact = render("cornell-boxes", **LARGER, final_gather_rays=2048).pixels.astype(float)
    scale = exact**2 + 0.01 * (exact[exact < 3] ** 2).mean()

    def measure(**settings: Any) -> tuple[float, Image]:
        image = render("cornell-boxes", **LARGER, final_gather_rays=400, **settings)
        error = np.sort(((image.pixels - exact) ** 2 / scale).ravel())
        if settings.get("irradiance_cache_tolerance", 0) <= 0.4:
            assert image.pixels.mean() == pytest.approx(exact.mean(), rel=0.004)
        return float(error[: int(0.995 * len(error))].mean()), image

    return measure


def test_tolerance_trades_records_for_error(relative_error: Callable[..., tuple[float, Image]]) -> None:
    """Fewer records and more error as it grows; at 0.2 no more error than twice what 400 rays at every point have.

    Beyond 0.8 the nearest surfaces limit records, not the tolerance, so their number hardly falls.
    """
    uncached, _ = relative_error()
    fine, coarse, coarser = (relative_error(irradiance_cache_tolerance=tolerance) for tolerance in (0.2, 0.8, 1.6))
    assert 0.00005 < uncached < 0.0005
    assert fine[0] < 2 * uncached + 0.0003
    assert coarser[0] > 1.3 * coarse[0] > 1.3 * 1.4 * fine[0]
    counts = [image.irradiance_records for _, image in (fine, coarse, coarser)]
    assert counts[0] > 1.3 * counts[1] > 1.3 * counts[2], counts


def test_gradients_pay(relative_error: Callable[..., tuple[float, Image]]) -> None:
    """At the tolerance of 0.8 the same records answer, with less than half the error."""
    plain, other = relative_error(irradiance_cache_tolerance=0.8, irradiance_gradients=False)
    steep, image = relative_error(irradiance_cache_tolerance=0.8)
    assert image.irradiance_records == other.irradiance_records
    assert steep < 0.5 * plain


def test_records_reach_two_pixels_unless_the_tolerance_asks_for_more() -> None:
    assert [least_pixels(tolerance) for tolerance in (0.02, 0.2, 0.5, 1.0, 2.0)] == [0.7, 0.7, 1.0, 2.0, 2.0]


@pytest.mark.parametrize("tolerance", [0.2, 0.4])
def test_records_reach_within_their_least_and_most_pixels(open_session: Open, tolerance: float) -> None:
    session = open_session("cornell-boxes", **{**SMALL, "irradiance_cache_tolerance": tolerance})
    least = least_pixels(tolerance)
    context, camera = session.context, session.scene.camera
    light = illumination(context, make_maps(context, StageClock()))
    points = look(context, camera, 0, 20 * 14).direct
    records = gather_records(context, camera, light, points)
    assert len(records.radius) == len(points.owner)
    frame = camera_frame(camera, 20, 14)
    footprint = 2 * np.linalg.norm(frame[1]) / 20 * np.linalg.norm(points.position - frame[0], axis=1)
    pixels = tolerance * records.radius / footprint
    assert np.all(pixels >= least * (1 - 1e-4))
    assert np.all(pixels <= MOST_PIXELS * (1 + 1e-4))
    assert (pixels > 1.01 * least).any()
    cache = fill_cache(context, camera, light)
    at = np.linalg.norm(cache.records.position - frame[0], axis=1) * 2 * np.linalg.norm(frame[1]) / 20
    reach = tolerance * cache.records.radius
    assert np.all(reach <= MOST_PIXELS * at * (1 + 1e-4))
    # Clamping may pull a record down to its neighbours, never below the least of them.
    assert reach.min() >= least * at.min() * (1 - 1e-4)


def test_gathers_are_made_again_by_their_own_doubt_and_sooner_by_their_neighbours() -> None:
    """A doubt of 0.3 is enough beside, not in itself; the picture's first and last gather have one neighbour."""
    doubt = np.array([0.0, 0.3, 0.0, 0.0, 0.5, 0.2, 0.2, 0.3])
    assert gather_again(doubt).tolist() == [True, False, True, True, True, True, True, False]
    assert not len(gather_again(np.zeros(0)))
