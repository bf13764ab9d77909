"""What repeats have in common, against values drawn with a known scatter, and the intervals made of it."""

import numpy as np
import pytest
from joulebox_server.analysis.intervals import over_values
from joulebox_server.analysis.scatter import Experience, common_scatter, factor, one_sided
from scipy import stats

UNKNOWING = Experience(0.03, 1e-9)
"""No experience: what is shared follows from the repeats alone."""


def drawn(points, repeats, own, shared=0.0, seed=0):
    """Points of mean 1 to 3 whose repeats scatter by themselves and shift together, both in logs."""
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0, np.log(3), points)[:, None]
    logs = levels + own * rng.standard_normal((points, repeats)) + shared * rng.standard_normal(repeats)
    return [dict(enumerate(np.exp(row).tolist())) for row in logs]


def test_own_scatter_is_found():
    """300 points of 3 repeats: 600 degrees of freedom, so 5 % is known to 0.14 %; 4 sigma tolerated (6e-5)."""
    found = common_scatter(drawn(300, 3, 0.05), UNKNOWING)
    assert found.own**0.5 == pytest.approx(0.05, abs=4 * 0.05 / np.sqrt(2 * 600))
    # All alike, so that their log variances scatter by trigamma(1) = 1.64 alone, found to 0.2: 0.5 too much would
    # pass for 5 degrees of freedom.
    assert found.own_freedom > 5


def test_points_that_differ_count_less():
    """Half of the points scatter by 2 %, half by 30 %: one tells little about another."""
    found = common_scatter(drawn(100, 3, 0.02) + drawn(100, 3, 0.3, seed=1), UNKNOWING)
    assert found.own_freedom < 4


def test_shared_shifts_are_told_from_own_scatter():
    """Repeats shifted by ln 1.1, 0 and -ln 1.1, exactly the same for all points."""
    shifts = np.log([1.1, 1.0, 1 / 1.1])
    points = [{r: v * np.exp(s) for (r, v), s in zip(p.items(), shifts, strict=True)} for p in drawn(200, 3, 0.01)]
    found = common_scatter(points, UNKNOWING)
    assert list(found.shifts.values()) == pytest.approx(shifts, abs=4 * 0.01 / np.sqrt(200))
    assert found.own**0.5 == pytest.approx(0.01, rel=0.15)
    assert found.shared == pytest.approx(np.var(shifts, ddof=1), rel=0.05)


def test_experience_holds_where_repeats_agree_by_luck():
    """Three repeats that share nothing: two degrees of freedom of 0 against four of 3 %."""
    found = common_scatter(drawn(200, 3, 1e-4), Experience(0.03, 4.0))
    assert found.shared == pytest.approx(4 / 6 * 0.03**2, rel=1e-3)
    assert found.shared_freedom == 6


@pytest.mark.parametrize("repeats", [1, 3])
def test_intervals_cover_as_they_promise(repeats):
    """40 sweeps of 50 points with 5 % own and 3 % shared scatter: 95 % of the intervals hold the truth, or a few more.

    Two parts, each widened for what is not known of it, are joined as if both erred at once. Over 400 sweeps 96.2 %
    held with three repeats and 97.1 % with one; within a sweep all are off together, and the share over 40 sweeps
    scatters by 0.7 % and 0.5 %. 3.5 sigma below and above (5e-4).
    """
    held = []
    for seed in range(40):
        points = drawn(50, 3, 0.05, 0.03, seed)
        scatter = common_scatter(points, Experience(0.03, 4.0))
        truth = np.exp(np.random.default_rng(seed).uniform(0, np.log(3), 50))
        shown = [{r: p[r] for r in range(repeats)} for p in points]
        intervals = [over_values(each, 0.95, scatter) for each in shown]
        held += [each.low <= t <= each.high for each, t in zip(intervals, truth, strict=True)]
    assert 0.937 < np.mean(held) < 0.99


def test_a_point_that_lacks_repeats_is_told_as_all_would_show_it():
    """The first session read 20 % too much; a point that has it alone is not taken to cost more for that."""
    shifts = np.log([1.2, 1.0, 1 / 1.2])
    points = [{r: v * np.exp(s) for (r, v), s in zip(p.items(), shifts, strict=True)} for p in drawn(100, 3, 0.005)]
    scatter = common_scatter(points, UNKNOWING)
    assert over_values({0: 2.4}, 0.95, scatter).value == pytest.approx(2.0, rel=0.01)
    assert over_values({0: 2.4, 2: 2.4}, 0.95, scatter).value == pytest.approx(2.4, rel=0.01)
    assert over_values(dict.fromkeys(range(3), 2.4), 0.95, scatter).value == pytest.approx(2.4, rel=1e-9)
    assert over_values({9: 2.4}, 0.95, scatter).value == 2.4  # of which nothing is known
    whole, alone = (over_values(each, 0.95, scatter) for each in (dict.fromkeys(range(3), 2.0), {0: 2.0 * 1.2}))
    assert alone.high / alone.value == pytest.approx(whole.high / whole.value, rel=0.05)  # what is shared is the most


def test_one_repeat_has_the_width_that_others_show():
    points = drawn(50, 3, 0.05)
    scatter = common_scatter(points, UNKNOWING)
    found = over_values({0: 2.0}, 0.95, scatter)
    assert found.high - 2 > 2 * factor(0.95, 1000) * 0.04
    assert over_values({0: 2.0}, 0.95).high == 2


def test_too_few_points_teach_nothing():
    assert common_scatter(drawn(4, 3, 0.05), UNKNOWING) is None
    assert common_scatter([{0: 1.0}] * 20, UNKNOWING) is None
    assert common_scatter([{0: 0.0, 1: 0.0}] * 20, UNKNOWING) is None


def test_missing_repeats_are_no_obstacle():
    points = [{r: v for r, v in p.items() if (r + k) % 4} for k, p in enumerate(drawn(200, 4, 0.05))]
    assert common_scatter(points, UNKNOWING).own ** 0.5 == pytest.approx(0.05, rel=0.15)


def test_a_bound_for_itself_is_nearer_than_one_of_two():
    assert one_sided(0.95) == pytest.approx(stats.norm.ppf(0.95) / stats.norm.ppf(0.975))


def own_seeds(points):
    """The same values, each under a number that no other point has."""
    return [{1000 * k + repeat: value for repeat, value in point.items()} for k, point in enumerate(points)]


def test_points_with_seeds_of_their_own_share_nothing():
    """Whatever experience says of luck that is shared: there is none, and all scatter is each point's own."""
    found = common_scatter(own_seeds(drawn(300, 3, 0.05)), Experience(0.2, 4.0))
    assert (found.shared, found.shifts, found.shared_half_width(3, 0.95)) == (0.0, {}, 0.0)
    assert found.own**0.5 == pytest.approx(0.05, abs=4 * 0.05 / np.sqrt(2 * 600))


def test_seeds_that_few_points_have_leave_what_is_shared_as_it_is():
    """Four points were confirmed with seeds of their own later: what the others share is still told."""
    shifts = np.log([1.3, 1.0, 1 / 1.3])
    points = [{r: v * np.exp(s) for (r, v), s in zip(p.items(), shifts, strict=True)} for p in drawn(100, 3, 0.01)]
    more = [point | later for point, later in zip(points[:4], own_seeds(drawn(4, 3, 0.01)), strict=True)]
    found = common_scatter(more + points[4:], UNKNOWING)
    assert list(found.shifts) == [0, 1, 2]
    assert list(found.shifts.values()) == pytest.approx(shifts, abs=0.02)
    assert found.shared == pytest.approx(np.var(shifts, ddof=1), rel=0.1)
