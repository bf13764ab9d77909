"""Ratings, cliffs, fragility and slopes on lines made by hand."""

import math

import pytest
from joulebox_server.analysis.lines import lines, steps_from
from joulebox_server.analysis.ratings import fragility, rate, why_fragile
from joulebox_server.analysis.recommend import recommend
from measured import interval, point, tradeoff_of

LIMIT = 100.0


def line(name, values, costs, differences, **others):
    """Points along one setting."""
    return [
        point(f"{name}={value}", interval(cost), interval(difference), settings={name: value, **others})
        for value, cost, difference in zip(values, costs, differences, strict=True)
    ]


def rated(points, reference=None):
    (found,) = rate(points, reference, "energy_j", LIMIT)
    return found


@pytest.mark.parametrize(
    ("costs", "elasticity", "impact"),
    [
        ([10, 10.5, 11], math.log(10.5 / 10) / math.log(2), "low"),
        ([10, 12, 15], math.log(15 / 12) / math.log(2), "medium"),
        ([10, 11, 20], math.log(20 / 11) / math.log(2), "high"),  # the steepest step decides
    ],
)
def test_energy_impact_is_the_steepest_elasticity(costs, elasticity, impact):
    found = rated(line("rays", [16, 32, 64], costs, [50, 40, 30]))
    assert (found.elasticity, found.energy_impact) == (pytest.approx(elasticity), impact)


@pytest.mark.parametrize(
    ("differences", "sensitivity"),
    [
        ([100, 60, 0], "low"),  # at the limit is within it
        ([500, 300, 0], "medium"),  # the first step from 64 leads to 32: three limits are not exceeded
        ([500, 301, 0], "high"),
        ([900, 50, 0], "medium"),  # far beyond, but not with the first step
    ],
)
def test_image_sensitivity_looks_at_the_first_step_from_the_reference(differences, sensitivity):
    reference = point("reference", interval(40), interval(0), settings={"rays": 64})
    assert rated(line("rays", [16, 32, 64], [1, 2, 3], differences), reference).image_sensitivity == sensitivity


def test_a_reference_beside_the_axis_makes_its_nearest_point_the_first_step():
    beside = point("reference", interval(40), interval(0), settings={"rays": 256})
    assert rated(line("rays", [16, 32, 64], [1, 2, 3], [900, 500, 310]), beside).image_sensitivity == "high"
    assert rated(line("rays", [16, 32, 64], [1, 2, 3], [900, 500, 290]), beside).image_sensitivity == "medium"


def test_words_have_no_order_and_count_as_a_doubling():
    found = rated(line("indirect", ["none", "gather", "path"], [1, 2, 8], [500, 20, 0]))
    assert found.elasticity == pytest.approx(3)  # from none to path is one step, of 8 = 2^3
    assert len(found.steps) == 3


def test_a_cliff_multiplies_by_three_and_ends_beyond_the_limit():
    edge = line("rays", [16, 32, 64, 128], [1, 2, 3, 4], [300, 100, 33.3, 10])
    (cliff,) = rated(edge).cliffs
    assert (cliff.start, cliff.end, cliff.difference_start, cliff.difference_end) == (32, 16, 100, 300)
    assert rated(line("rays", [16, 32], [1, 2], [299, 100])).cliffs == []
    assert rated(line("rays", [16, 32], [1, 2], [100, 20])).cliffs == []  # fivefold, but still acceptable


def test_a_setting_one_step_from_a_cliff_is_fragile_and_says_so():
    edge = line("rays", [16, 32, 64], [1, 2, 3], [300, 100, 33])
    told = fragility(edge, LIMIT)
    assert set(told) == {"rays=32"}
    assert "rays 16 instead of 32 multiplies its difference by 3, to 300, beyond the limit 100" in told["rays=32"]
    known = [p.model_copy(update={"fragile": told.get(p.configuration_id)}) for p in edge]
    chosen = recommend(tradeoff_of(known, axes=["rays"]))
    assert chosen.configuration_id == "rays=32"
    assert "one step away is a cliff" in chosen.fragile
    assert why_fragile(tradeoff_of(known), known[2], LIMIT) is None
    assert "beyond the limit 60" in why_fragile(tradeoff_of(known), known[2], 60)  # with another limit, another cliff


def test_the_line_with_most_values_and_least_other_error_is_rated():
    short = line("rays", [16, 32], [1, 100], [20, 10], spp=9)
    hidden = line("rays", [16, 32, 64], [1, 2, 4], [90, 89, 88], spp=1)
    clear = line("rays", [16, 32, 64], [1, 1.01, 1.02], [30, 20, 10], spp=4)
    found = next(r for r in rate([*short, *hidden, *clear], None, "energy_j", LIMIT) if r.setting == "rays")
    assert (found.energy_impact, len(found.steps)) == ("low", 2)


def test_steps_tell_slopes_and_pictures_that_stay_the_same():
    same = {"pixel_sha256": "aa"}
    points = [
        point("here", interval(10), interval(40), settings={"rays": 32, "caustics": False}, **same),
        point("more", interval(20), interval(10), settings={"rays": 64, "caustics": False}, pixel_sha256="bb"),
        point("inert", interval(11), interval(40), settings={"rays": 32, "caustics": True}, **same),
    ]
    found = {step.setting: step for step in steps_from(tradeoff_of(points), points[0], "energy_j")}
    assert found["rays"].cost_ratio == pytest.approx(2)
    assert found["rays"].slope == pytest.approx(-2)  # a quarter of the difference for twice the cost
    assert not found["rays"].same_picture
    assert found["caustics"].same_picture
    told = " ".join(recommend(tradeoff_of(points), budget_j=15).why)
    assert "for the very same picture" in told


def test_lines_hold_points_that_differ_in_one_setting_alone():
    points = [
        point(f"{a}{b}", interval(1), interval(1), settings={"a": a, "b": b, "seed": a})
        for a in (1, 2)
        for b in (1, 2, 3)
    ]
    found = [(each.setting, [p.configuration_id for p in each.points]) for each in lines(points)]
    along_a = [("a", ["11", "21"]), ("a", ["12", "22"]), ("a", ["13", "23"])]
    assert sorted(found) == [*along_a, ("b", ["11", "12", "13"]), ("b", ["21", "22", "23"])]


def test_stages_that_were_not_worth_it_and_stages_that_the_scene_leaves_out():
    without = {"caustics": "caustics=false", "shadow_photons": "no area light"}
    points = [
        point("off", interval(10), interval(40), settings={"caustics": False}, left_out=without),
        point(
            "on", interval(14), interval(38), settings={"caustics": True}, left_out={"shadow_photons": "no area light"}
        ),
    ]
    found = recommend(tradeoff_of(points), budget_j=12)
    told = " ".join(found.why)
    assert found.stages_left_out == without
    assert "No configuration runs shadow_photons (no area light)." in told
    assert (
        "caustics was not worth its cost here: with it (caustics on) an image costs 4 J (40 %) more, "
        "and the difference goes from 40 to 38."
    ) in told
