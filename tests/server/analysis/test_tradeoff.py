"""Means, intervals and fronts, against values worked out by hand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.intervals import exactly, over_repeats, over_values, t_factor
from joulebox_server.analysis.pareto import standings
from joulebox_server.analysis.points import Subject
from joulebox_server.analysis.tradeoff import build_tradeoff
from measured import SUBJECT, interval, observation, repeats, small_sweep
from scipy import stats

WIDE = st.floats(0.1, 100)


def numbered(values):
    """Values by repeat."""
    return dict(enumerate(values))


def test_repeats_give_a_student_interval():
    """Mean 11, standard deviation 1, t(0.975, 2) = 4.3027: 11 +- 4.3027 / sqrt(3)."""
    found = over_values(numbered([10, 11, 12]), 0.95)
    assert found.value == 11
    assert found.high - 11 == pytest.approx(4.302653 / math.sqrt(3), rel=1e-6)
    assert 11 - found.low == pytest.approx(found.high - 11)


def test_repeats_that_agree_by_luck_keep_their_windows_error():
    """Three repeats of 10 +- 0.6: sqrt(3 x 0.36) / 3 is left, not 0."""
    found = over_repeats(numbered([interval(10, 0.6)] * 3), [5] * 3, [0.95] * 3, 0.95)
    assert found.high - 10 == pytest.approx(0.6 / math.sqrt(3))


def test_scatter_between_repeats_rules_where_it_is_larger():
    found = over_repeats(numbered(interval(v, 0.01) for v in (10, 11, 12)), [5] * 3, [0.95] * 3, 0.95)
    assert found == over_values(numbered([10, 11, 12]), 0.95)


def test_one_repeat_has_its_windows_interval_restated():
    found = over_repeats(numbered([interval(10, 1)]), [5], [0.95], 0.99)
    expected = stats.t.ppf(0.995, 4) / stats.t.ppf(0.975, 4)
    assert found.high - 10 == pytest.approx(expected)


def test_interval_covers_as_it_promises():
    """Of 2,000 means of four normal values 95 % hold the truth; sigma is 0.5 %, 4 sigma tolerated (6e-5)."""
    draws = stats.norm.rvs(10, 1, size=(2000, 4), random_state=5)
    held = sum(found.low <= 10 <= found.high for found in (over_values(numbered(row), 0.95) for row in draws))
    assert held / 2000 == pytest.approx(0.95, abs=0.02)


def test_intervals_do_not_reach_below_zero():
    assert over_values(numbered([0.1, 5]), 0.95).low == 0
    assert t_factor(0.95, 2) == pytest.approx(12.7062, rel=1e-4)


def test_point_of_repeats():
    made = build_tradeoff(SUBJECT, repeats("a", [10, 11, 12], [80, 90, 100]))
    (point,) = made.points
    assert (point.energy_j.value, point.time_s.value, point.cpu_s.value) == pytest.approx((11, 1.1, 2.2))
    assert point.difference == over_values(numbered([80, 90, 100]), 0.95)
    assert point.difference_per_pixel.value == pytest.approx(90 / 65536)
    assert (point.repeats, point.acceptable, point.quality) == (3, True, "measured")
    assert point.stages["indirect"].time_s == pytest.approx(0.55)
    assert point.stages["indirect"].energy_j == pytest.approx(5.5)
    assert (point.label, point.image_sha256) == ("photons=1000", "image-a")


def test_one_repeat_is_never_confirmed_and_its_difference_has_no_width():
    made = build_tradeoff(SUBJECT, [observation("a", 10, 80), observation("b", 20, 90)])
    assert [p.difference for p in made.points] == [exactly(80), exactly(90)]
    assert [(p.on_front.energy_j, p.confirmed) for p in made.points] == [(True, False), (False, False)]


def test_repeats_are_counted_where_there_is_a_difference():
    made = build_tradeoff(SUBJECT, [*repeats("a", [10, 11], [80, 90]), observation("a", 12, None, repeat=2)])
    assert made.points[0].repeats == 2
    assert made.points[0].energy_j.value == 11


def test_changed_is_what_differs_from_the_reference_but_the_seed():
    made = small_sweep()
    assert made.points[0].changed == {"photons": 1000, "rays": 16}
    assert made.points[3].changed == {"rays": 16}
    assert made.points[3].label == "photons=10000"
    assert (made.reference.label, made.reference.changed) == ("reference", {})
    assert made.reference.difference == exactly(0)


def test_without_a_reference_the_axes_are_told():
    made = build_tradeoff(SUBJECT, [observation("a", 10, None)])
    assert (made.reference, made.points[0].changed) == (None, {"photons": 1000})
    assert (made.points[0].difference, made.points[0].acceptable) == (None, None)


def test_limit_and_noise_floor_go_with_the_size():
    subject = Subject("s", "box", "laptop", 128, 64, limit_at_256=80)
    made = build_tradeoff(subject, [observation("a", 1, 9)], noise_floor=1.01)
    assert made.limit == pytest.approx(80 * 128 * 64 / 65536)
    assert made.limit_per_pixel == pytest.approx(80 / 65536)
    assert made.noise_floor.share_of_limit == pytest.approx(0.101)
    assert made.noise_floor.too_noisy
    assert not build_tradeoff(subject, [], noise_floor=0.99).noise_floor.too_noisy
    assert made.points[0].acceptable


def test_qualities_are_not_mixed_in_a_point_and_the_weakest_labels_the_chart():
    mixed = [observation("a", 10, 1), observation("a", 99, 1, repeat=1, quality="replayed")]
    assert build_tradeoff(SUBJECT, mixed).points[0].energy_j.value == 10
    assert build_tradeoff(SUBJECT, mixed).energy_quality == "measured"
    more = [*mixed, observation("b", 20, 1, quality="replayed")]
    assert build_tradeoff(SUBJECT, more).energy_quality == "replayed"
    assert build_tradeoff(SUBJECT, [observation("a", None, 1)]).energy_quality == "time_only"


def test_time_only_ranks_and_confirms_by_time():
    made = small_sweep("time_only")
    assert made.main_axis == "time_s"
    assert [p.energy_j for p in made.points] == [None] * 4
    assert all(p.on_front.time_s and p.confirmed and not p.on_front.energy_j for p in made.points)


def test_wrong_terms_are_refused():
    with pytest.raises(AnalysisError, match=r"confidence is 1\.0, it must be from 0\.5 to 0\.999"):
        build_tradeoff(SUBJECT, [], confidence=1.0)
    with pytest.raises(AnalysisError, match="limit is 0, it must be a number above 0"):
        build_tradeoff(Subject("s", "b", "l", 8, 8, limit_at_256=0), [])


def test_front_by_hand():
    """a and c are on the front; b is surely dominated by a; d is dominated by c, but within the intervals."""
    costs = [interval(1, 0.1), interval(2, 0.1), interval(3, 0.1), interval(3.1, 0.1)]
    differences = [interval(50, 2), interval(60, 2), interval(20, 2), interval(21, 2)]
    found = [(s.on_front, s.confirmed) for s in standings(costs, differences, [3] * 4)]
    assert found == [(True, True), (False, True), (True, False), (False, False)]


def test_equal_points_share_the_front():
    found = standings([exactly(1), exactly(1)], [exactly(5), exactly(5)], [2, 2])
    assert [s.on_front for s in found] == [True, True]


def test_a_point_without_coordinates_is_on_no_front_and_dominates_nothing():
    found = standings([None, exactly(2)], [exactly(0), exactly(5)], [3, 3])
    assert [(s.on_front, s.confirmed) for s in found] == [(False, False), (True, True)]


@given(st.lists(st.tuples(WIDE, WIDE, st.floats(0, 10)), min_size=1, max_size=12))
def test_front_holds_wherever_the_values_are_in_confirmed_intervals(drawn):
    """Move every value to the end of its interval that speaks against a point: confirmed ones stay put."""
    costs = [interval(x, w * x / 40) for x, _, w in drawn]
    differences = [interval(y, w * y / 40) for _, y, w in drawn]
    found = standings(costs, differences, [3] * len(drawn))
    assert any(s.on_front for s in found)
    for index, standing in enumerate(found):
        if not standing.confirmed:
            continue

        def moved(intervals, index=index, standing=standing):
            ends = [("high", "low") if standing.on_front else ("low", "high")] * len(intervals)
            return [
                exactly(getattr(it, here if place == index else other))
                for place, (it, (here, other)) in enumerate(zip(intervals, ends, strict=True))
            ]

        worst = standings(moved(costs), moved(differences), [3] * len(drawn))
        assert worst[index].on_front == standing.on_front
