"""Stage powers from windows of different mixtures, prices, and the calibration of RAPL against the battery."""

import json
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from joulebox_agent.estimates.calibration import Calibration
from joulebox_agent.estimates.drift import drift_covariance
from joulebox_agent.estimates.stage_power import BETWEEN, FitError, StagePowerFit, WindowTotals, fit_stage_powers

POWERS_W = {"photon_map": 24.0, "direct": 17.0, "indirect": 14.0}


def sweep(rng: np.random.Generator, count: int, noise_w: float, drift_w: float = 0.0) -> list[WindowTotals]:
    """Windows of about a minute with other shares each; noise of the mean power, white and drifting over 3 minutes."""
    lengths_s = rng.uniform(60.0, 63.0, count)
    starts_s = np.concatenate([[0.0], np.cumsum(lengths_s + 10.0)[:-1]])
    errors_w = noise_w * rng.standard_normal(count)
    if drift_w:
        errors_w += drift_w * rng.multivariate_normal(np.zeros(count), drift_covariance(starts_s, lengths_s, 180.0))
    windows = []
    for start_s, time_s, error_w in zip(starts_s, lengths_s, errors_w, strict=True):
        shares = dict(zip(POWERS_W, rng.dirichlet([2, 2, 2]), strict=True))
        power_w = sum(share * POWERS_W[name] for name, share in shares.items()) + error_w
        windows.append(WindowTotals(time_s, {n: s * time_s for n, s in shares.items()}, power_w * time_s, start_s))
    return windows


def test_powers_are_exact_without_noise() -> None:
    fitted = fit_stage_powers(sweep(np.random.default_rng(1), 12, 0.0))
    assert {name: fitted.powers_w[name].value for name in POWERS_W} == pytest.approx(POWERS_W, rel=1e-6)
    price = fitted.price({"photon_map": 1.0, "direct": 2.0}, 3.0)
    assert price.value == pytest.approx(24.0 + 2 * 17.0, rel=1e-6)


@pytest.mark.parametrize("drift_w", [0.0, 0.3])
def test_intervals_of_powers_and_of_held_out_windows_hold_95_percent(drift_w: float) -> None:
    """200 sweeps of 16 windows and 4 held out: 600 powers, 800 prices. Within a sweep all share one fit, so the
    spread is taken over sweeps; a share of 95 % then has a standard error of about 0.9 %. Bounds of 4 sigma below;
    above, the prior for drift costs up to 3 % where there is none.
    """
    rng = np.random.default_rng(7)
    powers, prices = [], []
    for _ in range(200):
        windows = sweep(rng, 20, 0.1, drift_w)
        fitted = fit_stage_powers(windows[:16])
        powers.append(np.mean([fitted.powers_w[n].low <= watts <= fitted.powers_w[n].high
                               for n, watts in POWERS_W.items()]))  # fmt: skip
        priced = [fitted.price(w.stages_s, w.time_s) for w in windows[16:]]
        prices.append(np.mean([p.low <= w.energy_j <= p.high for p, w in zip(priced, windows[16:], strict=True)]))
    assert 0.914 <= np.mean(powers) <= 0.99
    assert 0.914 <= np.mean(prices) <= 0.99


def test_a_power_is_never_negative() -> None:
    """A stage that draws nothing, under noise that would make least squares say less than nothing."""
    rng = np.random.default_rng(3)
    clamped = 0
    for _ in range(20):
        windows = [WindowTotals(w.time_s, w.stages_s, w.energy_j - POWERS_W["indirect"] * w.stages_s["indirect"])
                   for w in sweep(rng, 14, 0.3)]  # fmt: skip
        power = fit_stage_powers(windows).powers_w["indirect"]
        assert power.value >= 0.0
        assert power.low >= 0.0
        assert power.high > 0.0
        clamped += power.value == 0.0
    assert clamped


def test_time_between_stages_has_a_power_of_its_own_where_it_can_be_told() -> None:
    rng = np.random.default_rng(5)
    windows = []
    for window in sweep(rng, 16, 0.05):
        rest_s = rng.uniform(5.0, 30.0)
        windows.append(WindowTotals(window.time_s + rest_s, window.stages_s, window.energy_j + 8.0 * rest_s))
    fitted = fit_stage_powers(windows)
    assert fitted.powers_w[BETWEEN].low <= 8.0 <= fitted.powers_w[BETWEEN].high
    constant = [WindowTotals(w.time_s * 1.1, w.stages_s, w.energy_j * 1.1) for w in sweep(rng, 16, 0.0)]
    shared = fit_stage_powers(constant)
    assert BETWEEN not in shared.powers_w
    assert shared.price({"direct": 10.0}, 11.0).value == pytest.approx(17.0 * 11.0, rel=1e-6)


def test_few_or_equal_windows_are_refused_in_a_sentence() -> None:
    windows = sweep(np.random.default_rng(1), 20, 0.1)
    with pytest.raises(FitError, match="3 stages need 12 metered windows; there are 11"):
        fit_stage_powers(windows[:11])
    with pytest.raises(FitError, match="photon_map, direct, indirect cannot be told apart"):
        fit_stage_powers([WindowTotals(60.0, {"photon_map": 20.0, "direct": 30.0, "indirect": 10.0}, 1000.0 + k % 3)
                          for k in range(15)])  # fmt: skip
    tied = [WindowTotals(w.time_s, {"photon_map": w.stages_s["photon_map"], "direct": 0.6 * (w.time_s -
            w.stages_s["photon_map"]), "indirect": 0.4 * (w.time_s - w.stages_s["photon_map"])}, w.energy_j)
            for w in windows]  # fmt: skip
    with pytest.raises(FitError, match="The stages direct, indirect cannot be told apart"):
        fit_stage_powers(tied)
    with pytest.raises(FitError, match="needs finite times"):
        fit_stage_powers([*windows, WindowTotals(60.0, {"direct": float("nan")}, 1.0)])
    with pytest.raises(FitError, match="must not overlap"):
        fit_stage_powers([*windows, WindowTotals(60.0, {"direct": 90.0}, 1.0)])
    with pytest.raises(FitError, match="there are 0"):
        fit_stage_powers([])


def test_stored_powers_come_back_and_bad_ones_are_named() -> None:
    fitted = fit_stage_powers(sweep(np.random.default_rng(2), 16, 0.1))
    again = StagePowerFit.from_json(json.loads(json.dumps(fitted.to_json())))
    assert again == fitted
    assert again.price({"direct": 1.0}, 1.0) == fitted.price({"direct": 1.0}, 1.0)
    with pytest.raises(FitError, match="caustics"):
        fitted.price({"caustics": 1.0}, 1.0)
    with pytest.raises(FitError, match="above 0 s"):
        fitted.price({"direct": 0.0}, 0.0)
    with pytest.raises(FitError, match="Stored stage powers: residual_w"):
        StagePowerFit.from_json({**fitted.to_json(), "residual_w": "much"})
    with pytest.raises(FitError, match="Stored stage powers"):
        StagePowerFit.from_json([1])


NOW = datetime(2026, 3, 1, tzinfo=UTC)
STATE = {"temperature_c": 55.0, "brightness_share": 0.4}


def calibrated(rng: np.random.Generator, noise_w: float = 0.1) -> Calibration:
    rapl_w = np.concatenate([rng.uniform(1.0, 2.0, 6), rng.uniform(9.0, 12.0, 6)])
    battery_w = 4.0 + 1.15 * rapl_w + noise_w * rng.standard_normal(12)
    return Calibration.fit(list(battery_w), list(rapl_w), NOW, STATE, "laptop")


def test_calibration_holds_the_battery_power_of_another_stretch() -> None:
    """1,000 calibrations, one further stretch each: binomial sigma 0.7 %, bounds of 4 sigma."""
    rng = np.random.default_rng(9)
    held = []
    for _ in range(1000):
        found = calibrated(rng).battery_w(6.0)
        held.append(found.low <= 4.0 + 1.15 * 6.0 + 0.1 * rng.standard_normal() <= found.high)
    assert np.mean(held) == pytest.approx(0.95, abs=0.028)


def test_calibration_is_used_only_while_nothing_changed() -> None:
    found = calibrated(np.random.default_rng(1))
    assert Calibration.from_json(json.loads(json.dumps(found.to_json()))) == found
    assert found.valid_reason(NOW + timedelta(days=1), STATE, "laptop") is None
    assert "31 days old" in str(found.valid_reason(NOW + timedelta(days=31), STATE))
    assert "future" in str(found.valid_reason(NOW - timedelta(days=1), STATE))
    assert "temperature was 55" in str(found.valid_reason(NOW, {**STATE, "temperature_c": 75.0}))
    assert "brightness was 0.4" in str(found.valid_reason(NOW, {**STATE, "brightness_share": None}))
    assert "tablet" in str(found.valid_reason(NOW, STATE, "tablet"))
    with pytest.raises(FitError, match="outside what was calibrated"):
        found.battery_w(40.0)


@pytest.mark.parametrize(
    ("battery_w", "rapl_w", "words"),
    [
        ([5.0] * 4, [1.0] * 4, "needs 5 pairs"),
        ([5.0] * 6, [1.0, 1.01, 1.0, 1.0, 1.0, 1.0], "idle and busy"),
        ([9.0, 8.0, 7.0, 6.0, 5.0], [1.0, 2.0, 3.0, 4.0, 5.0], "falls when RAPL's rises"),
        ([9.0, 8.0, float("nan"), 6.0, 5.0], [1.0, 2.0, 3.0, 4.0, 5.0], "finite"),
    ],
)
def test_pairs_that_make_no_line_are_refused(battery_w: list[float], rapl_w: list[float], words: str) -> None:
    with pytest.raises(FitError, match=words):
        Calibration.fit(battery_w, rapl_w, NOW, STATE, "laptop")
