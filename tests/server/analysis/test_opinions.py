"""Second opinions: closed forms, and FLIP against its own command on the same sRGB values."""

import numpy as np
import pytest
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.images import linear_from_srgb
from joulebox_server.analysis.opinions import relative_mse, second_opinions, yee_failing_share


@pytest.fixture
def picture():
    return np.random.default_rng(2).uniform(0.1, 0.3, (40, 50, 3)).astype(np.float32)


def test_equal_pictures(picture):
    assert second_opinions(picture, picture, 3).document() == pytest.approx(
        {"flip_mean": 0, "ssim": 1, "rmse_srgb": 0, "relmse": 0}
    )
    assert yee_failing_share(picture, picture, 3) == 0


def test_rmse_is_taken_of_srgb_values():
    one, other = (linear_from_srgb(np.full((20, 20, 3), level, np.float32)) for level in (0.4, 0.5))
    assert second_opinions(one, other).rmse_srgb == pytest.approx(0.1, abs=1e-5)


def test_exposure_comes_before_everything(picture):
    other = picture * 1.1
    assert second_opinions(picture, other, 2).document() == pytest.approx(
        second_opinions(2 * picture, 2 * other).document(), rel=1e-4
    )


def test_relmse_by_hand_and_without_the_worst_pixels():
    """(3a - 3b)^2 / ((3b)^2 + 0.01) for a = 0.2, b = 0.1 is 0.09 / 0.1; 2 of 2,000 pixels are dropped."""
    reference = np.full((40, 50, 3), 0.1, np.float32)
    test = np.full((40, 50, 3), 0.2, np.float32)
    assert relative_mse(reference, test, 3) == pytest.approx(0.9, rel=1e-5)
    test[0, :2] = 1e6
    assert relative_mse(reference, test, 3) == pytest.approx(0.9, rel=1e-5)
    test[1, 0] = 1e6
    assert relative_mse(reference, test, 3) > 1e6


def test_flip_is_the_published_programs_on_srgb(picture):
    flip_evaluator = pytest.importorskip("flip_evaluator")
    test = np.clip(picture * 1.2, 0, 1)
    # told that the values are linear, it converts them itself: the same metric by another way
    _, mean, used = flip_evaluator.evaluate(picture, test, "LDR", False, False, True, {})
    assert used["ppd"] == pytest.approx(67, abs=0.1)
    assert second_opinions(picture, test).flip_mean == pytest.approx(mean, rel=1e-3)


def test_yee_sees_a_difference(picture):
    assert yee_failing_share(picture, picture * 2) > 0.5


def test_pairs_that_cannot_be_compared(picture):
    bad = picture.copy()
    bad[3, 4] = np.nan
    for opinion in (second_opinions, yee_failing_share):
        with pytest.raises(AnalysisError, match=r"the test image has 1 pixel .* row 3, column 4"):
            opinion(picture, bad)
        with pytest.raises(AnalysisError, match="50 x 40 pixels and the test image 50 x 39"):
            opinion(picture, picture[:39])
