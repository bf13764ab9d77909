"""What only the series of samples shows: repeated values, lag, torn reads, a frozen gauge, gaps, a broken counter."""

from collections.abc import Callable

import numpy as np
import pytest
from joulebox_agent.estimates.energies import idle_power, integrated_stage_energies, window_energies
from joulebox_agent.estimates.windows import Window
from joulebox_agent.sampling.faults import stretch_fault
from joulebox_agent.sampling.lag import fit_lag
from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.reading import Reading
from joulebox_agent.sources.replay import Replay, bundled_trace

GAUGE = Replay(bundled_trace())
RNG = np.random.default_rng


def polled(
    updates_s: np.ndarray, power_w: np.ndarray, counter_w: float | None = None, step_j: float = 3.6, poll_s: float = 0.5
) -> list[Sample]:
    """Samples of a gauge that shows power_w from updates_s on; its counter uses counter_w in steps, at each update."""
    polls_s = np.arange(updates_s[0], updates_s[-1] + 1e-9, poll_s)
    rows = np.searchsorted(updates_s, polls_s + 1e-9, side="right") - 1
    samples = []
    for poll, row in zip(polls_s, rows, strict=True):
        counter_j = None if counter_w is None else float(step_j * np.floor(counter_w * updates_s[row] / step_j))
        raw = (float(power_w[row]), *([] if counter_j is None else [counter_j]))
        samples.append(Sample(float(poll), Reading(power_w=float(power_w[row]), counter_j=counter_j, raw=raw)))
    return samples


def noisy(refresh_s: float, until_s: float, mean_w: float = 17.0, sigma_w: float = 0.4, step_w: float = 0.001,
          seed: int = 0) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    times_s = np.arange(0.0, until_s, refresh_s)
    watts = mean_w + sigma_w * RNG(seed).standard_normal(times_s.size)
    return times_s, np.round(watts / step_w) * step_w


@pytest.mark.parametrize("refresh_s", [1.0, 4.0, 30.0])
@pytest.mark.parametrize("step_w", [0.001, 0.5])
def test_refresh_is_measured_although_coarse_values_repeat(refresh_s: float, step_w: float) -> None:
    """Steps of 0.5 W repeat a third of all values; each repeat is inferred, and counted as the update it is."""
    series = PowerSeries(polled(*noisy(refresh_s, 100 * refresh_s, step_w=step_w)))
    assert series.refresh_s() == pytest.approx(refresh_s, rel=0.02)
    assert series.update_count(0.0, 90 * refresh_s) == pytest.approx(90, abs=1)


def test_looks_out_of_turn_do_not_shorten_the_refresh() -> None:
    """A dozen updates of a gauge that refreshes at every poll, and four looks at windows' edges. Two looks within one
    refresh were taken for updates 0.1 s apart. Each of the four looks splits one of 11 spacings: one more is counted
    at the most (15 of 5.5 s), or one less (7)."""
    for seed in range(40):
        phase_s, *looks_s = RNG(seed).uniform(0.0, 0.5, 5)
        polls_s = np.sort([*np.arange(0.0, 6.0, 0.5), *(1.5 * k + look_s for k, look_s in enumerate(looks_s))])
        power_w = 17.0 + 0.4 * RNG(100 + seed).standard_normal(20)
        shown = [float(power_w[int((poll_s + phase_s) / 0.5)]) for poll_s in polls_s]
        samples = [Sample(float(t), Reading(power_w=w, raw=(w,))) for t, w in zip(polls_s, shown, strict=True)]
        assert 5.5 / 15 <= (PowerSeries(samples).refresh_s() or 0.0) <= 5.5 / 7


def test_a_counter_that_moves_at_every_poll_does_not_hide_the_gauge_s_refresh() -> None:
    times_s, power_w = noisy(4.0, 200.0)
    samples = [Sample(s.time_s, Reading(power_w=s.reading.power_w, counter_j=17.0 * s.time_s,
                                        raw=(s.reading.power_w or 0.0, s.time_s)))
               for s in polled(times_s, power_w)]  # fmt: skip
    assert PowerSeries(samples).refresh_s() == 4.0


def test_a_power_read_while_one_pack_was_ahead_of_the_other_is_dropped() -> None:
    """BAT0 stops and BAT1 takes over at 40 s; for half a second both, or neither, are seen to supply."""
    times_s, power_w = noisy(4.0, 100.0)
    samples = polled(times_s, power_w)
    torn = [Sample(s.time_s, Reading(power_w=34.0 if s.time_s == 40.0 else s.reading.power_w, raw=(s.time_s,)))
            for s in samples]  # fmt: skip
    assert PowerSeries(torn).highest_w(0.0, 100.0) == 34.0  # it was read
    assert PowerSeries(torn).energy_j(20.0, 80.0, "power") == pytest.approx(
        PowerSeries(samples).energy_j(20.0, 80.0, "power") or 0.0, rel=0.002
    )


@pytest.mark.parametrize(("refresh_s", "lag_s"), [(1.0, 1.0), (1.0, 10.0), (4.0, 4.0), (4.0, 30.0), (2.0, 20.0)])
def test_the_first_window_is_not_billed_for_the_idle_time_before_it(refresh_s: float, lag_s: float) -> None:
    """8 W until 100 s, then 17 W, shown as the mean of the last lag_s: unshifted, a lag of 30 s takes 13 % off.

    The step of 9 W is placed within an eighth of a refresh by interpolating between updates, the blur of a lag
    undone within a quarter of its eighth by the grid of lags; four standard errors of a mean of 15 updates are 3 J.
    """
    times_s = np.arange(lag_s, 500.0, refresh_s) + 0.1
    share = np.clip((times_s - 100.0) / lag_s, 0.0, 1.0)
    power_w = 8.0 + 9.0 * share + 0.05 * RNG(1).standard_normal(times_s.size)
    series = PowerSeries(polled(times_s, power_w))
    windows = [Window(100.0 + 60.0 * k, 160.0 + 60.0 * k, images=40) for k in range(5)]
    found = window_energies(series, GAUGE, windows, None)
    assert found.gross_j[0] == pytest.approx(17.0 * 60.0, abs=9.0 * (refresh_s / 8 + lag_s / 32) + 3.0)
    assert found.gross_j[1:] == pytest.approx((17.0 * 60.0,) * 4, rel=0.003)


def test_the_lag_is_found_from_the_step_where_the_load_began_before_the_window() -> None:
    """Five blocks: 5 s of set-up at 12 W, 90 s at 17 W, of which the window is the middle 60 s, 30 s of idling.

    Told where the load began, the fit finds the mean of 30 s, and the windows read true. Not told, it takes the
    ramp for what the windows drew: with the step 15 s before a window the mean begins to rise before it does.
    """
    pieces = [(60.0, 8.0)] + 5 * [(5.0, 12.0), (90.0, 17.0), (30.0, 8.0)]
    lengths_s, watts = np.array(pieces).T
    edges_s = np.concatenate([[0.0], np.cumsum(lengths_s)])
    used_j = np.concatenate([[0.0], np.cumsum(lengths_s * watts)])
    times_s = np.arange(30.0, edges_s[-1], 4.0) + 0.1
    shown_w = (np.interp(times_s, edges_s, used_j) - np.interp(times_s - 30.0, edges_s, used_j)) / 30.0
    series = PowerSeries(polled(times_s, shown_w + 0.05 * RNG(3).standard_normal(times_s.size)))
    starts_s = [float(edges_s[2 + 3 * block]) + 15.0 for block in range(5)]
    told = [Window(s, s + 60.0, images=40, lead_s=15.0, trail_s=15.0) for s in starts_s]
    found = window_energies(series, GAUGE, told, None)
    assert found.lag_s == pytest.approx(30.0, abs=3.0)  # the set-up is shorter than what is told apart
    assert found.gross_j == pytest.approx((17.0 * 60.0,) * 5, rel=0.004)
    untold = window_energies(series, GAUGE, [Window(s, s + 60.0, images=40) for s in starts_s], None)
    assert abs(untold.lag_s - 30.0) > 5.0


def test_the_counter_s_step_is_what_all_its_movements_are_multiples_of() -> None:
    """1 mWh, though it moves by 18 or 19 of them at a time and its last value is carried on; of a charge: not told."""

    def series(unit_j: float) -> PowerSeries:
        return PowerSeries([Sample(t / 2, Reading(counter_j=unit_j * (17.6 * (t // 8 * 4.0) // unit_j), raw=(t // 8,)))
                            for t in range(99)])  # fmt: skip

    assert series(3.6).counter_quantum_j() == pytest.approx(3.6)
    assert series(36.0).counter_quantum_j() == pytest.approx(36.0)
    assert series(1.1134).counter_quantum_j() is None


def test_without_a_step_no_lag_is_invented() -> None:
    series = PowerSeries(polled(*noisy(4.0, 400.0)))
    lag = fit_lag(series, [(50.0 + 60.0 * k, 110.0 + 60.0 * k) for k in range(5)])
    assert lag.lag_s <= 8.0
    assert np.abs(lag.edges_j).max() < 2.0  # of 1,020 J


def frozen(sigma_w: float = 0.4, step_w: float = 0.001, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A gauge of 4 s that stands still from 100 s to 160 s."""
    times_s, power_w = noisy(4.0, 300.0, sigma_w=sigma_w, step_w=step_w, seed=seed)
    power_w[25:40] = power_w[25]
    return times_s, power_w


def test_a_gauge_that_stands_still_is_frozen_when_it_never_repeats_itself_elsewhere() -> None:
    series = PowerSeries(polled(*frozen()))
    fault = stretch_fault(series, 90.0, 150.0, "power")
    assert fault is not None
    assert "the gauge froze at" in fault
    assert "60.0 s (15 refreshes)" in fault
    assert stretch_fault(series, 170.0, 230.0, "power") is None
    assert stretch_fault(series, 20.0, 90.0, "power") is None


def test_a_coarse_gauge_that_repeats_itself_is_not_frozen_but_a_load_that_stepped_proves_it() -> None:
    """Steps of 2 W at 17 W: most values repeat, runs of 60 s are nothing unusual."""
    times_s, power_w = noisy(4.0, 1200.0, sigma_w=0.5, step_w=2.0, mean_w=16.9, seed=4)
    power_w[25:40] = power_w[25]
    series = PowerSeries(polled(times_s, power_w))
    assert stretch_fault(series, 90.0, 150.0, "power") is None
    assert "load changed" in str(stretch_fault(series, 90.0, 150.0, "power", load_changes_s=[130.0]))


def test_the_counter_clears_or_convicts_a_value_that_is_held() -> None:
    """At a truly constant 17 W the counter agrees and nothing is wrong; at another power, or not moving, it is."""
    times_s, power_w = noisy(4.0, 1200.0, sigma_w=0.5, step_w=2.0, mean_w=16.9, seed=4)
    power_w[25:40] = 16.0
    agrees = PowerSeries(polled(times_s, power_w, counter_w=16.1))
    assert stretch_fault(agrees, 90.0, 150.0, "power") is None
    convicts = PowerSeries(polled(times_s, power_w, counter_w=24.0))
    assert "the counter says" in str(stretch_fault(convicts, 90.0, 150.0, "power"))
    stopped = [
        Sample(s.time_s, Reading(power_w=s.reading.power_w, raw=s.reading.raw,
                                 counter_j=36.0 * np.floor(16.0 * min(s.time_s, 100.0) / 36.0)))
        for s in polled(times_s, power_w) if s.time_s <= 158.0
    ]  # fmt: skip
    assert "stood still as well" in str(stretch_fault(PowerSeries(stopped), 90.0, 150.0, "power"))


def test_no_ordinary_gauge_is_called_frozen() -> None:
    """300 discharges of 300 s at three quantisations: a false alarm is rarer than one in ten thousand holds."""
    alarms = sum(
        bool(stretch_fault(PowerSeries(polled(*noisy(4.0, 300.0, step_w=step_w, seed=seed))), 20.0, 280.0, "power"))
        for step_w in (0.001, 0.5, 1.0)
        for seed in range(100)
    )
    assert alarms == 0


def test_gaps_and_a_broken_counter_are_named() -> None:
    times_s, power_w = noisy(1.0, 200.0)
    samples = [s for s in polled(times_s, power_w, counter_w=17.0) if not 50.0 < s.time_s < 80.0]
    assert stretch_fault(PowerSeries(samples), 40.0, 100.0, "power") == "no good sample for 30.0 s"
    assert stretch_fault(PowerSeries([]), 40.0, 100.0, "power") == "no good sample at all"


@pytest.mark.parametrize(("length_s", "gap_s", "void"), [(60.0, 5.0, False), (60.0, 7.0, True), (2.0, 2.5, True)])
def test_a_tenth_of_a_window_may_pass_without_a_good_sample(length_s: float, gap_s: float, void: bool) -> None:
    """Short windows too: one that holds no good sample at all was once read from the last value held before it."""
    samples = [s for s in polled(*noisy(4.0, 120.0)) if not 50.0 < s.time_s < 50.0 + gap_s]
    series, end_s = PowerSeries(samples), 50.2 + length_s
    assert (stretch_fault(series, 50.2, end_s, "power") is not None) is void
    assert (series.energy_j(50.2, end_s, "power") is None) is void


def test_a_counter_that_runs_backwards_beside_a_gauge_is_named() -> None:
    samples = [
        Sample(s.time_s, Reading(power_w=s.reading.power_w, counter_j=17.0 * s.time_s, epoch=int(s.time_s // 50),
                                 raw=(s.reading.power_w or 0.0, s.time_s)))
        for s in polled(*noisy(4.0, 200.0))
    ]  # fmt: skip
    windows = [Window(start_s, start_s + 60.0, images=20) for start_s in (5.0, 65.0)]
    found = window_energies(PowerSeries(samples), GAUGE, windows, 0.1)
    assert found.gross_j[0] == pytest.approx(17.0 * 60, rel=0.05)
    assert found.counter_j == (None, None)
    assert any("ran backwards" in note for note in found.notes)
    backwards = [Sample(s.time_s, Reading(counter_j=s.reading.counter_j, raw=s.reading.raw, epoch=int(s.time_s > 120)))
                 for s in samples]  # fmt: skip
    assert "ran backwards" in str(stretch_fault(PowerSeries(backwards), 90.0, 150.0, "counter"))
    assert stretch_fault(PowerSeries(backwards), 130.0, 190.0, "counter") is None


def test_a_counter_read_between_its_steps_is_carried_on_at_its_rate() -> None:
    """17 W in steps of 36 J refreshed every 4 s: what it says at the end is up to 4 s and a step too old."""
    times_s = np.arange(0.0, 121.0, 4.0)
    samples = polled(times_s, np.full(times_s.size, 17.0), counter_w=17.0, step_j=36.0)
    samples = [s for s in samples if s.time_s <= 119.5]
    assert PowerSeries(samples).energy_j(20.0, 119.5, "counter") == pytest.approx(17.0 * 99.5, abs=36.0)
    errors_j = []
    for end_s in np.arange(100.0, 119.0, 0.5):
        cut = PowerSeries([s for s in samples if s.time_s <= end_s])
        errors_j.append((cut.energy_j(20.0, end_s, "counter") or 0.0) - 17.0 * (end_s - 20.0))
    assert abs(np.mean(errors_j)) < 8.0  # holding the last value would be 17 W x 2 s too low


def fast_counter(power_at: Callable[[float], float], until_s: float, poll_s: float = 0.02) -> PowerSeries:
    polls_s = np.arange(0.0, until_s, poll_s)
    watts = np.array([power_at(t) for t in polls_s])
    used_j = np.concatenate([[0.0], np.cumsum(watts[:-1]) * poll_s])
    return PowerSeries([Sample(float(t), Reading(counter_j=float(j), raw=(float(j),)))
                        for t, j in zip(polls_s, used_j, strict=True)])  # fmt: skip


def test_a_fast_counter_is_integrated_over_each_stage_and_scaled_to_the_battery() -> None:
    """24 and 14 W in turns of half a second; the battery says half as much again in total."""
    series = fast_counter(lambda t: 24.0 if t % 1.0 < 0.5 else 14.0, 20.0)
    stages = {"photon_map": [(k + 0.0, k + 0.5) for k in range(1, 19)],
              "indirect": [(k + 0.5, k + 1.0) for k in range(1, 19)]}  # fmt: skip
    found = integrated_stage_energies(series, stages, 1.5 * 19.0 * 18, [(1.0, 19.0)])
    assert found is not None
    assert sum(found.values()) == pytest.approx(1.5 * 19.0 * 18)
    assert found["photon_map"] == pytest.approx(1.5 * 12.0 * 18, rel=0.01)
    slow = fast_counter(lambda t: 24.0 if t % 1.0 < 0.5 else 14.0, 20.0, poll_s=0.25)
    assert integrated_stage_energies(slow, stages, 1.0, [(1.0, 19.0)]) is None


@pytest.mark.parametrize("ends_s", [[], [15.0, 31.0, 44.0, 61.0, 75.0]])
def test_pieces_of_a_window_hold_all_of_it_and_end_with_images(ends_s: list[float]) -> None:
    window = Window(0.0, 75.0, images=5, image_ends_s=ends_s)
    for count in (2, 3, 5):
        pieces = window.pieces(count)
        assert pieces[0][0] == 0.0
        assert pieces[-1][1] == 75.0
        assert [end_s for _, end_s, _ in pieces[:-1]] == [start_s for start_s, _, _ in pieces[1:]]
        assert sum(images for _, _, images in pieces) == pytest.approx(5.0)
        assert all(images > 0 for _, _, images in pieces)
        assert not ends_s or {end_s for _, end_s, _ in pieces} <= set(ends_s)


def test_idle_power_leaves_out_what_the_gauge_still_shows_of_the_rendering() -> None:
    """Idle at 8 W after rendering at 17 W, shown as the mean of 20 s: taken whole, the block would say 9.5 W."""
    times_s = np.arange(0.1, 161.0, 4.0)
    power_w = 8.0 + 9.0 * np.clip(1.0 - (times_s - 100.0) / 20.0, 0.0, 1.0) + 0.1 * RNG(3).standard_normal(times_s.size)
    found = idle_power(PowerSeries(polled(times_s, power_w)), GAUGE, [(100.0, 160.0)], lag_s=20.0)
    assert found is not None
    assert found.value == pytest.approx(8.0, abs=0.13)  # four standard errors of ten updates
    assert found.low <= 8.0 <= found.high


def test_blocks_that_drift_apart_widen_idle_power() -> None:
    times_s = np.arange(0.0, 600.0, 2.0)
    steady = 8.0 + 0.2 * RNG(5).standard_normal(times_s.size)
    apart = steady + np.where(times_s > 300.0, 1.0, 0.0)
    halves = []
    for power_w in (steady, apart):
        found = idle_power(PowerSeries(polled(times_s, power_w)), GAUGE, [(10.0, 70.0), (530.0, 590.0)])
        assert found is not None
        halves.append(found.half_width)
    assert halves[1] > 3 * halves[0]
    assert halves[1] > 0.5  # the two blocks are 1 W apart
