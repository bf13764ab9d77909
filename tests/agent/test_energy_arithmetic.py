"""Energy from gauge readings, and whether the interval covers the truth at its rate. No clock, no sleeping."""

import numpy as np
import pytest
from joulebox_agent.estimates.energies import idle_power, window_energies
from joulebox_agent.estimates.estimate import (
    MOST_NEEDED,
    Interval,
    net_of_idle,
    step_half,
    t_quantile,
    two_stage_interval,
    windows_needed,
)
from joulebox_agent.estimates.windows import Window, stage_energies_j
from joulebox_agent.loop import ImageEvent, StageEvent
from joulebox_agent.measuring.stages import StageEvidence, stage_records
from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.none import NoSource
from joulebox_agent.sources.reading import Reading
from joulebox_agent.sources.replay import Replay, bundled_trace

GAUGE = Replay(bundled_trace())


def gauge(times_s: list[float], power_w: list[float], poll_s: float = 0.5, until_s: float = 100.0) -> PowerSeries:
    """What polling every `poll_s` sees of a gauge that takes these values at these times."""
    polls = np.arange(times_s[0], until_s + 1e-9, poll_s)
    rows = np.searchsorted(times_s, polls + 1e-9, side="right") - 1
    return PowerSeries(
        [Sample(float(t), Reading(power_w=power_w[row], raw=(int(row),))) for t, row in zip(polls, rows, strict=True)]
    )


def windows(count: int, length_s: float, images: int = 10, start_s: float = 0.0) -> list[Window]:
    return [Window(start_s + k * length_s, start_s + (k + 1) * length_s, images=images) for k in range(count)]


def test_constant_power_is_exact_to_both_edges() -> None:
    series = gauge([0.0, 4.0, 8.0, 12.0], [20.0] * 4)
    assert series.energy_j(1.3, 55.7, "power") == pytest.approx(20.0 * 54.4)
    assert series.refresh_s() == 4.0


def test_trapezoid_over_updates_not_over_polls() -> None:
    """10 W at 0 s, 20 W at 4 s, 30 W at 8 s: a ramp of 2.5 W/s; holding each poll's value would give 15 W."""
    series = gauge([0.0, 4.0, 8.0, 12.0], [10.0, 20.0, 30.0, 40.0])
    assert series.energy_j(0.0, 12.0, "power") == pytest.approx(12 * 25.0)
    assert series.energy_j(2.0, 6.0, "power") == pytest.approx(4 * 20.0)
    assert series.update_count(0.0, 12.0) == 3


def test_a_plateau_is_not_read_as_a_ramp() -> None:
    """The same 10 W confirmed from 8 s to 32 s without a visible update, then 30 W."""
    times_s = [0.0, 4.0, 8.0, 32.0, 36.0, 40.0, 44.0]
    series = gauge(times_s, [12.0, 11.0, 10.0, 30.0, 30.5, 30.0, 30.5])
    assert series.energy_j(8.0, 28.0, "power") == pytest.approx(200.0)


def test_a_hole_in_the_samples_makes_the_window_unknown() -> None:
    whole = gauge([0.0, 4.0, 8.0, 12.0], [20.0] * 4)._good
    holed = PowerSeries([s for s in whole if not 30.0 < s.time_s < 60.0])
    assert holed.energy_j(20.0, 70.0, "power") is None
    assert holed.energy_j(61.0, 90.0, "power") == pytest.approx(29 * 20.0)
    bad = Sample(31.0, Reading(problem="EIO"))
    assert PowerSeries([*whole[:60], bad, *whole[64:]]).energy_j(20.0, 70.0, "power") is not None


def test_a_counter_is_interpolated_to_the_edges_and_never_across_an_epoch() -> None:
    samples = [Sample(float(t), Reading(counter_j=7.0 * t, raw=(t,))) for t in range(20)]
    assert PowerSeries(samples).energy_j(2.5, 10.5, "counter") == pytest.approx(56.0)
    broken = [Sample(s.time_s, Reading(counter_j=s.reading.counter_j, raw=s.reading.raw, epoch=int(s.time_s > 6)))
              for s in samples]  # fmt: skip
    assert PowerSeries(broken).energy_j(2.5, 10.5, "counter") is None
    assert PowerSeries(broken).energy_j(8.0, 10.0, "counter") == pytest.approx(14.0)


def test_equation_2_shares_a_window_by_time() -> None:
    window = Window(0.0)
    for k in range(2):
        image = ImageEvent(event="image", image=k, start_s=2.0 * k, end_s=2.0 * k + 1.8, time_s=1.8, cpu_s=3.0,
                           pixel_sha256="a")  # fmt: skip
        stages = [
            StageEvent(event="stage", image=k, name="direct", start_s=2.0 * k, end_s=2.0 * k + 0.5),
            StageEvent(event="stage", image=k, name="indirect", start_s=2.0 * k + 0.5, end_s=2.0 * k + 1.0),
            StageEvent(event="stage", image=k, name="direct", start_s=2.0 * k + 1.0, end_s=2.0 * k + 1.8),
        ]
        window.add(image, stages)
    assert window.images == 2
    assert window.wall_s == pytest.approx(3.8)
    shares = stage_energies_j(window, 76.0)  # 20 W over 3.8 s
    assert shares["direct"] == pytest.approx(20.0 * 2.6)
    assert shares["indirect"] == pytest.approx(20.0 * 1.0)
    assert sum(shares.values()) < 76.0  # the gap between the images keeps its own


def test_a_stage_tells_what_of_it_is_seen_through_mirrors() -> None:
    """Two images a window: direct twice 0.5 s, of which 0.2 s through a mirror; indirect none."""
    window = Window(0.0)
    for k in range(2):
        image = ImageEvent(event="image", image=k, start_s=2.0 * k, end_s=2.0 * k + 1, time_s=1.0, cpu_s=2.0,
                           pixel_sha256="a")  # fmt: skip
        stages = [
            StageEvent(event="stage", image=k, name="direct", start_s=0.0, end_s=0.3, cpu_s=0.6),
            StageEvent(event="stage", image=k, name="indirect", start_s=0.3, end_s=0.8, cpu_s=1.0),
            StageEvent(event="stage", image=k, name="direct", start_s=0.8, end_s=1.0, cpu_s=0.4, through_specular=True),
        ]
        window.add(image, stages)
    records = stage_records(StageEvidence([window], [None], pilot_count=1))
    direct, indirect = records["direct"], records["indirect"]
    assert (direct.time_s, direct.cpu_s) == (pytest.approx(0.5), pytest.approx(1.0))
    assert (direct.specular_time_s, direct.specular_cpu_s) == (pytest.approx(0.2), pytest.approx(0.4))
    assert (indirect.specular_time_s, indirect.specular_cpu_s) == (0.0, 0.0)


def test_no_source_has_no_energy() -> None:
    found = window_energies(gauge([0.0, 4.0], [5.0, 6.0]), NoSource(), windows(3, 10.0), None)
    assert found.gross_j == (None, None, None)


def test_a_gauge_slower_than_the_windows_is_not_resolvable_and_names_a_bound() -> None:
    series = gauge([0.0, 30.0, 60.0, 90.0], [20.0, 22.0, 21.0, 22.0])
    found = window_energies(series, GAUGE, windows(9, 10.0, images=5), None)
    assert found.gross_j == (None,) * 9
    assert "not resolvable" in found.notes[0]
    assert "44 J" in found.notes[0]  # 22 W over the 2 s of an image


@pytest.mark.parametrize("count", [3, 5, 10])
def test_steady_windows_of_a_coarse_counter_are_held_at_their_rate(count: int) -> None:
    """Windows of 30 steps and any fraction of one, told as 30 or 31: by Student's t alone 3 hold 75, 5 hold 83 %.

    20,000 draws: a standard error of 0.15 %.
    """
    rng = np.random.default_rng(count)
    held, plain = [], []
    for _ in range(20_000):
        steps = 30 + rng.uniform()
        told = list(np.floor(steps + rng.uniform(size=count)))
        for into, least in ((held, step_half(count)), (plain, 0.0)):
            interval = two_stage_interval(told, count, least_half=least)
            into.append(interval.low <= steps <= interval.high)
    assert np.mean(held) == pytest.approx(0.95, abs=0.006)
    assert np.mean(plain) < 0.92


def test_a_counter_of_few_steps_is_not_resolvable() -> None:
    class Counter(Replay):
        primary = "counter"

    samples = [Sample(float(t), Reading(counter_j=36.0 * (t // 20), raw=(t // 20,))) for t in range(60)]
    found = window_energies(PowerSeries(samples), Counter(bundled_trace()), windows(3, 15.0), 36.0)
    assert found.gross_j == (None,) * 3
    assert "not resolvable by the counter" in found.notes[0]


@pytest.mark.parametrize(("rate", "noted", "kept"), [(1.02, False, True), (1.2, True, True), (229.0, True, False)])
def test_the_counter_is_checked_against_the_gauge(rate: float, noted: bool, kept: bool) -> None:
    """5 % is noted, a factor of two is rejected: one kernel counted 229 times too fast."""
    samples = [Sample(float(t), Reading(power_w=10.0, counter_j=10.0 * rate * t, raw=(t,))) for t in range(100)]
    found = window_energies(PowerSeries(samples), GAUGE, windows(3, 30.0), None)
    assert found.gross_j == pytest.approx((300.0,) * 3)
    assert any("counter says" in note for note in found.notes) == noted
    assert (found.counter_j[0] is not None) == kept


def test_idle_power_and_net() -> None:
    series = gauge(list(np.arange(0.0, 100.0, 2.0)), [8.0, 9.0] * 25)
    idle = idle_power(series, GAUGE, [(0.0, 30.0), (70.0, 99.0)])
    assert idle is not None
    assert idle.low < 8.5 < idle.high
    assert idle_power(series, GAUGE, [(0.0, 3.0)]) is None  # a third of it holds no update
    times_s = [1.9, 2.0, 2.1]  # images that take longer cost more: 10 W, all of it, 2 W above idle
    net = net_of_idle([19.0, 20.0, 21.0], times_s, Interval(value=8.0, low=7.5, high=8.5), 6, 3)
    assert net.value == pytest.approx(4.0)
    of_windows, of_idle = 0.2**2 / 3, (0.5 / t_quantile(5) * 2.0) ** 2
    freedom = (of_windows + of_idle) ** 2 / (of_windows**2 / 2 + of_idle**2 / 5)  # Welch
    assert net.half_width == pytest.approx(t_quantile(freedom) * (of_windows + of_idle) ** 0.5)


def test_student_quantiles_of_the_tables() -> None:
    assert [round(t_quantile(n), 3) for n in (1, 4, 19)] == [12.706, 2.776, 2.093]


@pytest.mark.parametrize(("cv", "needed"), [(0.01, 4), (0.02, 7), (0.05, 27)])
def test_windows_needed_for_two_percent(cv: float, needed: int) -> None:
    """The table of the method: half-width 2 %; with the pilot's quantile instead of the final one it is never
    fewer, and the pilot is the least there can be."""
    pilot = np.array([-1.0, -1.0, 0.0, 1.0, 1.0])
    pilot = 100.0 * (1 + cv * pilot / pilot.std(ddof=1))
    assert windows_needed(list(pilot), 0.02) >= max(5, needed)
    assert windows_needed([5.0] * 5, 0.02) == 5
    assert windows_needed(list(pilot), 1e-300) == windows_needed([5.0] * 5, 1e-300, least_share=0.1) == MOST_NEEDED


def test_two_stage_interval_covers_at_its_rate() -> None:
    """4,000 two-stage experiments at the spread where the usual interval covers least (92.6 %).

    Binomial sigma 0.34 %; the bound of 4 sigma is false once in 16,000 runs, and the seed is fixed.
    """
    rng = np.random.default_rng(11)
    runs, hits, counts = 4000, 0, []
    for _ in range(runs):
        pilot = 1 + 0.06 * rng.standard_normal(5)
        count = min(20, windows_needed(list(pilot), 0.05))
        values = [*pilot, *(1 + 0.06 * rng.standard_normal(count - 5))]
        interval = two_stage_interval(values, 5)
        hits += interval.low <= 1 <= interval.high
        counts.append(count)
    assert np.mean(counts) > 8  # the second stage is at work
    assert hits / runs == pytest.approx(0.95, abs=0.014)


def scripted_discharge(rng: np.random.Generator, power_w: float, until_s: float) -> PowerSeries:
    """A gauge refreshed every 3 to 5 s: averages of a true power, with 4 % noise, in steps of 10 mW."""
    times_s = np.concatenate([[0.0], np.cumsum(rng.uniform(3.0, 5.0, int(until_s / 3)))])
    shown_w = np.round(power_w * (1 + 0.04 * rng.standard_normal(times_s.size)), 2)
    return gauge(list(times_s), list(shown_w), poll_s=1.0, until_s=until_s)


def test_scripted_discharge_is_covered_at_its_rate() -> None:
    """300 discharges of known watts through gauge, windows and interval: 95 % hold the truth.

    Binomial sigma 1.26 %; two-sided bound of 3.2 sigma.
    """
    rng = np.random.default_rng(5)
    runs, hits = 300, 0
    for _ in range(runs):
        truth_w = float(rng.uniform(8.0, 24.0))
        series = scripted_discharge(rng, truth_w, 330.0)
        found = window_energies(series, GAUGE, windows(5, 60.0, images=40, start_s=10.0), None)
        values = [energy_j / 40 for energy_j in found.gross_j if energy_j is not None]
        assert len(values) == 5
        interval = two_stage_interval(values, 5)
        hits += interval.low <= truth_w * 60 / 40 <= interval.high
    assert hits / runs == pytest.approx(0.95, abs=0.04)
