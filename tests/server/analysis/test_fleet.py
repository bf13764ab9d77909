"""What other devices' runs tell of a device with few of its own."""

import pytest
from joulebox_server.analysis.documents import StageCost
from joulebox_server.analysis.fleet import transferred
from joulebox_server.analysis.recommend import recommend
from measured import interval, point, tradeoff_of

SPEED = {"direct": 2.0, "indirect": 3.0}
POWER_W = {"direct": 4.0, "indirect": 6.0}


def their(name, direct_s, indirect_s, difference):
    """A point of the device that ran everything, at 10 W."""
    stages = {"direct": direct_s, "indirect": indirect_s}
    costs = {stage: StageCost(time_s=time_s, energy_j=10 * time_s) for stage, time_s in stages.items()}
    total = direct_s + indirect_s
    return point(name, interval(10 * total), interval(difference), time_s=interval(total), stages=costs)


def mine(theirs):
    """The same configuration on a device that is slower and draws less, by stage."""
    costs = {
        name: StageCost(time_s=SPEED[name] * cost.time_s, energy_j=POWER_W[name] * SPEED[name] * cost.time_s)
        for name, cost in theirs.stages.items()
    }
    energy = sum(cost.energy_j for cost in costs.values())
    time = sum(cost.time_s for cost in costs.values())
    return theirs.model_copy(update={"energy_j": interval(energy), "time_s": interval(time), "stages": costs})


def devices(run_here):
    shelf = [their(f"c{k}", 0.1 + 0.05 * k, 0.5 + 0.2 * k * k, 90 / (1 + k)) for k in range(6)]
    own = tradeoff_of([mine(shelf[k]) for k in run_here], device="handheld")
    return own, tradeoff_of(shelf, device="shelf"), {p.configuration_id: mine(p) for p in shelf}


@pytest.mark.parametrize("axis", ["energy_j", "time_s"])
def test_stage_powers_and_speeds_carry_costs_over(axis):
    """Two shared runs tell the speed and power of both stages exactly, as nothing is noisy here."""
    own, shelf, truth = devices([0, 4])
    found = {c.configuration_id: c for c in transferred(own, [shelf], axis)}
    assert set(found) == {"c1", "c2", "c3", "c5"}
    for name, candidate in found.items():
        assert candidate.cost.value == pytest.approx(truth[name].cost(axis).value)
        assert candidate.difference.value == truth[name].difference.value
        assert candidate.basis == "predicted"
        assert candidate.cost.low < candidate.cost.value < candidate.cost.high


def test_misses_of_shared_runs_widen_the_interval():
    own, shelf, _ = devices([0, 2, 4])
    exact = transferred(own, [shelf], "energy_j")[0]
    odd = own.points[0].model_copy(update={"energy_j": interval(3 * own.points[0].energy_j.value)})
    doubtful = transferred(own.model_copy(update={"points": [odd, *own.points[1:]]}), [shelf], "energy_j")[0]
    assert doubtful.cost.high / doubtful.cost.value > 1.5 * exact.cost.high / exact.cost.value


def test_the_device_that_shares_most_runs_is_asked():
    own, shelf, _ = devices([0, 1, 2])
    few = tradeoff_of([*shelf.points[:2], their("only-there", 1, 1, 5)], device="few")
    assert {c.configuration_id for c in transferred(own, [few, shelf], "energy_j")} == {"c3", "c4", "c5"}


def test_one_shared_run_tells_nothing():
    own, shelf, _ = devices([0])
    assert transferred(own, [shelf], "energy_j") == []
    assert transferred(own, [], "energy_j") == []


def test_a_recommendation_of_the_fleet_is_marked():
    own, shelf, truth = devices([0, 1])
    fleet = transferred(own, [shelf], "energy_j")
    found = recommend(own, difference_limit=20, transferred=fleet)
    assert (found.basis, found.configuration_id) == ("predicted", "c4")
    assert found.energy_j.value == pytest.approx(truth["c4"].energy_j.value)
    assert recommend(own, transferred=fleet).basis == "measured"
