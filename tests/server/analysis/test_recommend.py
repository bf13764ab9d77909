"""Recommendations on cases decided by hand, and two laws that hold for any points."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joulebox_server.analysis.budgets import budget_per_image_j
from joulebox_server.analysis.documents import NoiseFloor
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.recommend import recommend
from joulebox_server.analysis.tradeoff import build_tradeoff
from measured import SUBJECT, interval, observation, point, small_sweep, tradeoff_of
from scipy import stats

KEYS = {
    *("answer", "basis", "energy_quality", "settings", "energy_j", "difference", "limit", "budget_j", "saves_j"),
    *("saves_share", "fragile", "why", "runner_up", "nearest"),
}


def by_hand():
    """Upper bounds of cost and difference, each of 95 % for itself (1.645 / 1.96 = 0.839 of the half-widths):

    cheap 11.68, 92.6; middle 21.68, 58.4; dear 31.68, 29.2; rough 5.84, 204.2.
    """
    points = [
        point("cheap", interval(10, 2), interval(80, 15)),
        point("middle", interval(20, 2), interval(50, 10)),
        point("dear", interval(30, 2), interval(25, 5)),
        point("rough", interval(5, 1), interval(200, 5)),
    ]
    return tradeoff_of(points, reference=point("reference", interval(40, 1), interval(0)))


@pytest.mark.parametrize(
    ("terms", "chosen", "second"),
    [
        ({}, "cheap", "middle"),
        ({"budget_j": 25}, "middle", "cheap"),
        ({"budget_j": 21.6}, "cheap", None),  # middle costs 20, but up to 21.7
        ({"budget_j": 100}, "dear", "middle"),
        ({"difference_limit": 90}, "middle", "dear"),  # cheap differs by 80, but up to 92.6
        ({"budget_s": 25}, "middle", "cheap"),
        ({"budget_j": 10, "difference_limit": 300}, "rough", None),
    ],
)
def test_upper_bounds_decide(terms, chosen, second):
    found = recommend(by_hand(), **terms)
    assert (found.answer, found.configuration_id) == ("settings", chosen)
    assert (found.runner_up and found.runner_up.configuration_id) == second
    assert found.nearest == []


def test_the_cheapest_has_to_be_surer_the_more_cheaper_ones_are_undecided():
    """Ten that may stay within 100 each have their chance to seem to; one that just does at 95 % is not taken then."""
    undecided = [point(f"u{i}", interval(1 + 0.1 * i), interval(120 - i, 30 - i / 2)) for i in range(10)]
    just, surely = point("just", interval(3), interval(85, 17)), point("surely", interval(4), interval(50, 5))
    assert recommend(tradeoff_of([just, surely])).configuration_id == "just"
    found = recommend(tradeoff_of([*undecided, just, surely]))
    assert found.configuration_id == "surely"
    assert recommend(tradeoff_of([*undecided, just])).configuration_id == "just"  # nothing is surer


def test_document_says_what_is_saved_and_why():
    found = recommend(by_hand(), budget_j=25)
    assert set(found.model_dump()) >= KEYS
    assert (found.saves_j, found.saves_share) == pytest.approx((20, 0.5))
    assert (found.budget_j, found.budget_s, found.limit, found.basis) == (25, None, 100, "measured")
    assert found.settings == {"name": "middle"}
    told = " ".join(found.why)
    assert "at most 58.4 with 95% confidence, within the limit of 100" in told
    assert "it costs 20 J an image, at most 21.7 J, within the budget of 25 J" in told
    assert "the smallest difference of the 2 that fit, out of 4 measured configurations" in told
    assert "it saves 20 J (50 %)" in told


def test_nothing_fits():
    found = recommend(by_hand(), budget_j=11)
    assert (found.answer, found.settings, found.runner_up) == ("none", None, None)
    assert [near.configuration_id for near in found.nearest] == ["cheap", "middle"]
    assert found.nearest[0].misses == "it costs 10 J (up to 11.7), the budget is 11 J"
    assert "None of the 4 measured configurations stays within a budget of 11 J" in found.why[0]


def test_nearest_tells_both_that_it_misses():
    points = [point("only", interval(10, 2), interval(150, 15))]
    found = recommend(tradeoff_of(points), budget_j=4)
    assert found.nearest[0].misses == (
        "it costs 10 J (up to 11.7), the budget is 4 J; its difference is 150 (up to 163), the limit is 100"
    )
    assert found.nearest[0].fragile is None  # beyond the limit for certain, which is no question of luck


def test_fragile_is_said():
    once = recommend(tradeoff_of([point("a", interval(10), interval(50), repeats=1)]))
    assert "one seed only" in once.fragile
    crossing = recommend(tradeoff_of([point("a", interval(10), interval(95, 10))]))
    assert crossing.answer == "none"
    assert "reaches 105, beyond the limit 100" in crossing.nearest[0].fragile
    assert recommend(by_hand()).fragile is None


def test_a_setting_that_paid_is_named_with_figures():
    """c2 (5,000 photons) against c3, which differs from it in photons alone: 20.2 J and 25.25 J."""
    found = recommend(small_sweep(), budget_j=23)
    assert found.configuration_id == "c2"
    told = " ".join(found.why)
    assert "photons 5,000 instead of 10,000 saves 5.05 J (20 %); the difference goes from 30.6 to 47.1" in told
    assert found.saves_share == pytest.approx((60 - 20.2) / 60)


def test_close_calls_are_admitted():
    points = [point("a", interval(10), interval(50, 10)), point("b", interval(10), interval(52, 10))]
    assert any("cannot be told from it by difference" in why for why in recommend(tradeoff_of(points), budget_j=20).why)
    assert not any("cannot be told" in why for why in recommend(by_hand(), budget_j=100).why)


def test_replayed_and_noisy_references_are_said():
    replayed = recommend(small_sweep("replayed"), budget_j=23)
    assert replayed.energy_quality == "replayed"
    assert any("replayed from a trace" in why for why in replayed.why)
    floor = NoiseFloor(value=12, share_of_limit=0.12, too_noisy=True)
    noisy = small_sweep().model_copy(update={"noise_floor": floor})
    assert any("too noisy to judge by" in why and "12 %" in why for why in recommend(noisy, budget_j=23).why)


def test_without_energy_the_budget_is_in_seconds():
    made = small_sweep("time_only")
    found = recommend(made, budget_s=2.3)
    assert (found.configuration_id, found.energy_j, found.energy_quality) == ("c2", None, "time_only")
    assert found.saves_s == pytest.approx(6 - 2.02)
    assert found.saves_share == pytest.approx((6 - 2.02) / 6)
    assert any("no energy source" in why for why in found.why)
    with pytest.raises(AnalysisError, match="the budget must be in seconds"):
        recommend(made, budget_j=5)


def test_without_a_reference_nothing_is_said_to_be_saved():
    found = recommend(tradeoff_of([point("a", interval(10), interval(5))]))
    assert (found.saves_j, found.saves_s, found.saves_share) == (None, None, None)
    assert any("no measured reference" in why for why in found.why)


@pytest.mark.parametrize(
    ("terms", "sentence"),
    [
        ({"budget_j": 0}, "budget_j is 0, it must be a number above 0"),
        ({"budget_s": float("nan")}, "budget_s is nan"),
        ({"difference_limit": -1}, "difference_limit is -1"),
        ({"budget_j": 1, "budget_s": 1}, "it must be one of them"),
        ({"confidence": 0.9}, "the trade-off was built at 0.95"),
    ],
)
def test_wrong_terms_are_refused(terms, sentence):
    with pytest.raises(AnalysisError, match=sentence):
        recommend(by_hand(), **terms)


@pytest.mark.parametrize("confidence", [0.5, 0.501, 0.999])
@pytest.mark.parametrize(
    "terms", [{}, {"budget_j": 60}, {"budget_j": 60, "predict": True}, {"difference_limit": 5e-324}]
)
def test_the_least_and_the_greatest_confidence_have_answers(confidence, terms):
    """At even odds a bound is the value itself, and a deviation that would be told from it is not."""
    grid = [(photons, rays) for photons in (1000, 2000, 5000, 10000) for rays in (8, 16, 32)]
    found = [
        observation(
            f"c{photons}-{rays}", (10 + photons / 1000) * rays**0.5 * (1 + 0.01 * repeat),
            4e5 / photons / rays**0.5 * (1 + 0.1 * ((repeat + rays) % 3)),
            settings={"photons": photons, "rays": rays}, repeat=repeat,
        )
        for photons, rays in grid
        if (photons, rays) != (5000, 16)
        for repeat in range(3)
    ]  # fmt: skip
    answer = recommend(build_tradeoff(SUBJECT, found, confidence=confidence), **terms)
    assert answer.answer == ("none" if "difference_limit" in terms else "settings")
    if answer.energy_j is not None:
        assert answer.energy_j.high <= terms.get("budget_j", 1e9)
        assert (answer.energy_j.high > answer.energy_j.value) == (confidence > 0.5)


def test_nothing_to_judge_is_an_error():
    with pytest.raises(AnalysisError, match="has been both measured and compared"):
        recommend(tradeoff_of([point("a", interval(1), None)]))
    with pytest.raises(AnalysisError, match="compared to the reference yet; 2 configurations were measured"):
        recommend(tradeoff_of([point("a", interval(1), None), point("b", interval(2), None)]), budget_j=1)
    one = tradeoff_of([point("a", interval(1), None)])
    empty = one.model_copy(update={"points": [], "energy_quality": "time_only"})
    with pytest.raises(AnalysisError, match=r"on laptop has been both measured and compared to the reference yet$"):
        recommend(empty, budget_j=1)  # and not that its energy is not known
    with pytest.raises(AnalysisError, match="no device works on this sweep of cornell-boxes yet"):
        recommend(empty.model_copy(update={"device": ""}))


def test_watt_hours_for_images():
    """50 Wh are 180 kJ; a thousand images may use 180 J each."""
    assert budget_per_image_j(50, 1000) == pytest.approx(180)
    with pytest.raises(AnalysisError, match="0 images, it must be for at least 1"):
        budget_per_image_j(50, 0)
    with pytest.raises(AnalysisError, match="-1 Wh, it must be above 0"):
        budget_per_image_j(-1, 10)


POINTS = st.lists(
    st.tuples(*[st.floats(0.5, 60), st.floats(0, 10), st.floats(0, 200), st.floats(0, 40)]), min_size=1, max_size=10
)
BUDGETS = st.none() | st.floats(1, 80)


def upper(interval):
    """The bound of 95 %: the two-sided interval holds that and the lower one with 95 % together."""
    return interval.value + stats.norm.ppf(0.95) / stats.norm.ppf(0.975) * (interval.high - interval.value)


def drawn(values):
    return [
        point(f"p{i:02}", interval(cost, width), interval(difference, spread))
        for i, (cost, width, difference, spread) in enumerate(values)
    ]


@settings(deadline=None)
@given(POINTS, BUDGETS, st.floats(5, 200))
def test_a_recommended_point_never_breaks_a_bound(values, budget, limit):
    points = drawn(values)
    found = recommend(tradeoff_of(points), budget_j=budget, difference_limit=limit)
    inside = [p for p in points if upper(p.energy_j) <= (budget or 1e9) and upper(p.difference) <= limit]
    assert (found.answer == "settings") == bool(inside)
    if inside:
        chosen = next(p for p in points if p.configuration_id == found.configuration_id)
        assert chosen in inside
        if budget:
            assert upper(chosen.difference) == pytest.approx(min(upper(p.difference) for p in inside))
        else:  # a cheaper one was passed over only where others might have seemed acceptable as well
            cheaper = [p for p in points if upper(p.energy_j) < upper(chosen.energy_j)]
            assert not set(map(id, inside)) & set(map(id, cheaper)) or len(cheaper) > 1
    else:
        assert len(found.nearest) == min(2, len(points))
        assert all(near.misses for near in found.nearest)


@settings(deadline=None)
@given(POINTS, BUDGETS, st.integers(0, 9), st.floats(0, 5), st.floats(0.01, 5))
def test_a_dominated_point_never_changes_the_answer(values, budget, which, dearer, worse):
    points = drawn(values)
    cost, width, difference, spread = values[which % len(values)]
    # "a" sorts before every other name: only being worse keeps it from being chosen
    beaten = point("a", interval(cost + dearer, width), interval(difference + worse, spread))
    before, after = (recommend(tradeoff_of(ps), budget_j=budget) for ps in (points, [beaten, *points]))
    assert (before.answer, before.configuration_id) == (after.answer, after.configuration_id)
