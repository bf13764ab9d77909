"""Budgets in every unit, and what is refused."""

import pytest
from joulebox_server.analysis.budgets import make_budget
from joulebox_server.errors import ServerError


def test_every_kind():
    assert (make_budget().joules, make_budget().seconds) == (None, None)
    assert make_budget(joules=5).joules == 5
    assert make_budget(seconds=2).seconds == 2
    assert make_budget(watt_hours=50, images=1000).joules == pytest.approx(180)  # 180 kJ shared
    tenth = make_budget(battery_percent=10, images=100, battery_full_j=48 * 3600)
    assert tenth.joules == pytest.approx(0.1 * 48 * 3600 / 100)
    assert tenth.told == "10 % of a battery of 48.0 Wh for 100 images"
    assert make_budget(battery_percent=1, battery_full_j=36_000).joules == pytest.approx(360)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"joules": 0}, "budget_j is 0, it must be a number above 0"),
        ({"seconds": float("nan")}, "budget_s is nan"),
        ({"joules": 1, "seconds": 1}, "give one budget, not budget_j and budget_s"),
        ({"watt_hours": 1}, "budget_wh and images belong together"),
        ({"watt_hours": 1, "images": 0}, "0 images, it must be for at least 1"),
        ({"images": 5}, "images goes with budget_wh or battery_percent"),
        ({"joules": 1, "images": 5}, "images goes with budget_wh or battery_percent"),
        ({"battery_percent": 101, "battery_full_j": 1.0}, "at most 100"),
        ({"battery_percent": 5}, "the capacity of this device's battery is not known"),
    ],
)
def test_what_makes_no_sense_is_refused(given, sentence):
    with pytest.raises(ServerError, match=sentence):
        make_budget(**given)
