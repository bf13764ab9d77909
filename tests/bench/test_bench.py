"""The arithmetic behind `make bench`: errors, costs at an error, references that grow, rays that are recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joulebox_render import bench as renderer_bench
from joulebox_render.intersect import EmbreeScene
from joulebox_render.pool import usable_cores
from joulebox_render.session import Session
from joulebox_render.settings import make_settings
from joulebox_server.analysis import opinions

from bench import threads
from bench.candidates import Measured, name_of
from bench.mitsuba_side import llvm_version
from bench.picture_error import brightness_error, cost_at, flip, relative_mse
from bench.references import Reference, Wanted, read, write
from bench.rivals import Goal, cheapest, front_row, ratio_row
from bench.table import Row, goals


def picture(value: float, size: int = 40) -> np.ndarray:
    return np.full((size, size, 3), value, np.float32)


def test_relmse_of_a_constant_offset() -> None:
    """(3 x 0.1)^2 / ((3 x 0.5)^2 + 0.01)."""
    assert relative_mse(picture(0.6), picture(0.5)) == pytest.approx(0.09 / 2.26, rel=1e-6)


def test_relmse_drops_the_worst_thousandth_of_pixels() -> None:
    """Of 1600 pixels one is dropped whole: the second firefly counts, with all its channels."""
    image = picture(0.5)
    image[0, 0] = 100
    assert relative_mse(image, picture(0.5)) == 0
    image[1, 1] = 1.5
    assert relative_mse(image, picture(0.5)) == pytest.approx(9 / 2.26 / 1599, rel=1e-6)


def test_relmse_is_the_servers() -> None:
    random = np.random.default_rng(5)
    image, truth = (random.gamma(0.5, 1, (50, 60, 3)).astype(np.float32) for _ in range(2))
    assert relative_mse(image, truth) == pytest.approx(opinions.relative_mse(truth, image, exposure=3.0), rel=1e-9)


def test_flip_is_zero_for_equal_pictures_and_grows_with_noise() -> None:
    random = np.random.default_rng(6)
    truth = picture(0.1)
    noisy = [truth + np.float32(sigma) * random.standard_normal(truth.shape) for sigma in (0.0, 0.01, 0.05)]
    errors = [flip(image.astype(np.float32), truth) for image in noisy]
    assert errors[0] == 0
    assert 0 < 2 * errors[1] < errors[2] < 1


def test_flip_is_taken_at_exposure_three() -> None:
    """Beyond 1/3 everything is white."""
    assert flip(picture(0.9), picture(0.5)) == 0
    assert flip(picture(0.3), picture(0.2)) > 0.05


def test_brightness_error_has_a_sign() -> None:
    assert brightness_error(picture(0.45), picture(0.5)) == pytest.approx(-0.1, abs=1e-6)


def test_cost_at_follows_the_power_law_between_points() -> None:
    """Error = cost^-1/2, so 0.25 costs 16."""
    curve = [(1.0, 1.0), (4.0, 0.5), (64.0, 0.125)]
    assert cost_at(curve, 0.25) == pytest.approx(16)
    assert cost_at(curve, 0.5) == pytest.approx(4)
    assert cost_at(curve, 0.1) is None
    assert cost_at(curve, 2.0) == 1
    assert cost_at([], 1.0) is None


def test_a_reference_grows_to_the_mean_and_its_variance(tmp_path: Path) -> None:
    """Welford's update over eight passes, four of them after a round trip through the file."""
    passes = np.random.default_rng(7).gamma(2, 1, (8, 5, 6, 3)).astype(np.float32)
    zeros = np.zeros(passes[0].shape)
    reference = Reference(zeros, zeros.copy(), 0, 4, "a test")
    for number, one in enumerate(passes):
        if number == 4:
            write(tmp_path / "kept.npz", reference)
            reference = read(tmp_path / "kept.npz")
        reference.add(one)
    exact = passes.astype(np.float64)
    assert (reference.passes, reference.spp, reference.origin) == (8, 4, "a test")
    np.testing.assert_allclose(reference.mean, exact.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(reference.variance_of_mean, exact.var(axis=0, ddof=1) / 8, rtol=1e-10)
    assert [file.name for file in tmp_path.iterdir()] == ["kept.npz"]


def test_one_pass_tells_no_variance() -> None:
    zeros = np.zeros((2, 2, 3))
    reference = Reference(zeros, zeros.copy(), 0, 4, "a test")
    reference.add(np.ones((2, 2, 3), np.float32))
    assert reference.variance_of_mean is None


def test_a_wanted_reference_reads_as_it_is_written() -> None:
    wanted = Wanted.parse("cornell-bunny:detail=948,size=small")
    assert wanted == Wanted("cornell-bunny", {"detail": "948", "size": "small"})
    assert str(wanted) == "cornell-bunny:detail=948,size=small"
    assert Wanted.parse("furnace") == Wanted("furnace")


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-15.so.1", 15),
        ("libLLVM.so.19.1", 19),
        ("libLLVM-19.so", 19),
        ("libLLVM-17.0.6.so", 17),
        ("libLLVM.dylib", 0),
        ("libLLVM.21.dylib", 21),
    ],
)
def test_the_version_of_llvm_is_read_off_its_name(name: str, version: int) -> None:
    assert llvm_version(Path(name)) == version


def test_recorded_rays_are_those_that_were_counted_and_change_no_pixel() -> None:
    """Every ray that a stage reports is recorded for it, and the recording asks what the rendering asked."""
    film = {"width": 12, "height": 12, "threads": 1, "global_photons": 500, "final_gather_rays": 4}
    with Session("cornell-boxes", make_settings(film)) as session:
        before = session.render()
        queries = renderer_bench.record_queries(session)
        after = session.render()
    counted: dict[str, int] = {}
    for interval in before.clock.intervals:
        key = renderer_bench.stage_key(interval)
        counted[key] = counted.get(key, 0) + interval.rays
    recorded = {name: sum(len(batch.origin) for batch in batches) for name, batches in queries.items()}
    assert recorded == {name: rays for name, rays in counted.items() if rays}
    stages = {"direct", "indirect", "indirect, overture", "photon_map, emission", "precomputed_irradiance"}
    assert stages == set(recorded)
    assert all(batch.limit is None for batch in queries["photon_map, emission"])
    assert before.pixel_sha256 == after.pixel_sha256


def measured(name: str, cpu_s: float, error: float) -> Measured:
    return Measured("a-scene", name, cpu_s, error, error, 0.0)


def test_the_cheapest_good_enough_candidate_sets_the_ratio() -> None:
    ours = [measured("a", 0.5, 0.08), measured("b", 1.0, 0.05), measured("c", 0.9, 0.06), measured("d", 3.0, 0.02)]
    theirs = [measured("m", 1.0, 0.2), measured("m", 16.0, 0.05)]
    best = cheapest(ours, "flip", 0.05)
    assert best
    assert best.name == "b"
    row = ratio_row(Goal("a-scene", 0.05, 6, "?"), ours, theirs)
    assert row.met
    assert row.measured.startswith("16.0x")
    assert ratio_row(Goal("a-scene", 0.05, 17, "?"), ours, theirs).met is False
    assert ratio_row(Goal("a-scene", 0.01, 6, "?"), ours, theirs).met is False
    assert ratio_row(Goal("a-scene", 0.05, 6, "?"), ours, []).met is None


def test_a_preset_that_is_beaten_is_named() -> None:
    ours = [measured("draft", 0.5, 0.1), measured("balanced", 2.0, 0.05), measured("x", 1.0, 0.04)]
    asked: list[tuple[str, str]] = []

    def ratio(one: str, other: str) -> float:
        asked.append((one, other))
        return 0.9

    row = front_row("a-scene", ours, ratio)
    assert row.met is False
    assert "balanced is beaten by x" in row.measured
    assert "draft is" not in row.measured
    assert ("x", "balanced") in asked
    assert front_row("a-scene", ours[:2], ratio).met
    # Where both take turns the candidate turns out no cheaper: noise had made it so.
    assert front_row("a-scene", ours, lambda one, other: 0.97).met


def test_the_table_says_what_was_not_run() -> None:
    lines = goals([Row("a", "< 1", "0.5", True), Row("b", "< 1", "2", False), Row.not_run("c", "< 1", "no time")])
    assert lines[2:] == ["| a | < 1 | 0.5 | met |", "| b | < 1 | 2 | **missed** |", "| c | < 1 | no time | not run |"]


def test_settings_in_words() -> None:
    assert name_of({"preset": "fine"}) == "fine"
    assert name_of({"preset": "draft", "shadow_rays": 4}) == "draft, shadow_rays=4"


def test_scaling_is_told_against_the_stages_own_rays() -> None:
    """1.6x of bare rays that gain 2x or, where a stage traces too few of its own, of the rays in the middle."""
    stages = threads.speedups({"direct": (0.16, 0.1), "photon_map": (0.096, 0.06), "caustics": (0.04, 0.04)})
    row = threads.scaling_row("threads", ">= 0.9", stages, {"direct, shadow": 2.0, "indirect, gather": 1.6, "x": 1.6})
    assert row.measured == "direct 0.80, photon_map 1.00 (bare embreex 1.60x)"
    assert row.met is False


@pytest.mark.skipif(usable_cores() < 2 or EmbreeScene is None, reason="compares two threads with bare embreex")
def test_threads_are_timed_in_processes_of_their_own() -> None:
    """A picture so small that no stage takes 50 ms: the child ran, and the row says why it tells nothing."""
    said: list[str] = []
    row = threads.threads_row(said.append, {"width": 12, "height": 12, "global_photons": 500}, processes=1, turns=1)
    assert "no stage takes long enough" in row.measured
    assert said == ["one thread against two, process 1 of 1"]
