"""What is worth measuring: expected improvements against draws, and cases decided by hand."""

import math

import numpy as np
import pytest
from joulebox_server.analysis.candidates import Candidate
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.proposals import _gain, worth_measuring
from joulebox_server.analysis.terms import Terms
from measured import interval, point

REACH = 1.6448536  # standard deviations that 95 % are below
DRAWS = 200_000


def bounded(value, deviation):
    """Whose upper bound is where a normal logarithm stays below with 95 %."""
    return Interval(value=value, low=value * math.exp(-REACH * deviation), high=value * math.exp(REACH * deviation))


def candidate(name, cost, difference, measured=False):
    of = point(name, interval(cost.value), interval(difference.value)) if measured else None
    return Candidate(name if measured else None, name, {"name": name}, {}, cost, difference, of)


@pytest.mark.parametrize("worth", [0.0, 1.0])
@pytest.mark.parametrize("budget", [10.0, None])
@pytest.mark.parametrize(("cost", "difference"), [(9.5, 40.0), (10.5, 30.0), (8.0, 55.0)])
def test_gain_is_the_mean_over_draws(worth, budget, cost, difference):
    """Monte Carlo error of a mean of DRAWS: its own standard deviation by sqrt(DRAWS), 5 of them tolerated."""
    terms, margins = Terms("energy_j", budget, 80.0), (0.05, 0.1)
    level = math.log(50.0 if budget else 10.0)
    found = _gain(terms, candidate("a", bounded(cost, 0.1), bounded(difference, 0.4)), level, margins, 0.95, worth)
    rng = np.random.default_rng(3)
    costs = math.log(cost) + 0.1 * rng.standard_normal(DRAWS)
    differences = math.log(difference) + 0.4 * rng.standard_normal(DRAWS)
    sought, held = (differences, costs) if budget else (costs, differences)
    allowed = math.log(budget) - margins[0] if budget else math.log(80.0) - margins[1]
    better = (level - sought + worth) * (sought <= level) * (held <= allowed)
    assert found == pytest.approx(better.mean(), abs=5 * better.std() / math.sqrt(DRAWS))


def test_a_little_too_dear_may_be_worth_it_and_surely_worse_is_not():
    terms = Terms("energy_j", 10.0, 100.0)
    chosen = candidate("chosen", bounded(9.0, 0.02), bounded(50.0, 0.1), measured=True)
    maybe = candidate("maybe", bounded(10.2, 0.1), bounded(20.0, 0.3))
    worse = candidate("worse", bounded(5.0, 0.1), bounded(500.0, 0.1))
    far = candidate("far", bounded(30.0, 0.1), bounded(5.0, 0.1))
    known = [chosen, maybe, worse, far]
    assert worth_measuring(terms, chosen, known, 0.95, 3) == [maybe]
    assert worth_measuring(terms, chosen, known, 0.95, 0) == []


def test_more_improvement_comes_first_and_what_fits_already_is_left_out():
    terms = Terms("energy_j", 10.0, 100.0)
    chosen = candidate("chosen", bounded(9.0, 0.02), bounded(50.0, 0.1), measured=True)
    known_fits = candidate("known", bounded(8.0, 0.02), bounded(52.0, 0.1), measured=True)
    loose = candidate("loose", bounded(9.9, 0.05), bounded(30.0, 0.1), measured=True)
    good = candidate("good", bounded(7.0, 0.1), bounded(20.0, 0.3))
    fair = candidate("fair", bounded(7.0, 0.1), bounded(40.0, 0.3))
    assert worth_measuring(terms, chosen, [fair, chosen, loose, known_fits, good], 0.95, 9) == [good, fair, loose]


@pytest.mark.parametrize("budget", [10.0, None])
def test_without_an_answer_what_may_fit_is_proposed(budget):
    terms = Terms("energy_j", budget, 100.0)
    near = candidate("near", bounded(9.8, 0.05), bounded(95.0, 0.1), measured=True)
    hopeless = candidate("hopeless", bounded(9.0, 0.05), bounded(900.0, 0.1), measured=True)
    hopeful = candidate("hopeful", bounded(9.0, 0.1), bounded(80.0, 0.3))
    found = worth_measuring(terms, None, [near, hopeless, hopeful], 0.95, 5)
    assert found[0] is hopeful
    assert hopeless not in found


@pytest.mark.parametrize("budget", [10.0, None])
@pytest.mark.parametrize("difference", [95.0, 101.0])
def test_without_an_answer_what_is_just_above_the_limit_is_measured_again(budget, difference):
    """By deviations so small that no improvement of MIN_GAIN is to be expected of the value itself."""
    terms = Terms("energy_j", budget, 100.0)
    near = candidate("near", bounded(9.0, 0.02), bounded(difference, 0.06), measured=True)
    far = candidate("far", bounded(9.0, 0.02), bounded(200.0, 0.06), measured=True)
    assert not terms.fits(near)
    assert worth_measuring(terms, None, [far, near], 0.95, 5) == [near]
