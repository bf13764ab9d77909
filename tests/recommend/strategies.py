"""Ways to choose settings from what a campaign measured: ours, and those that people use instead.

Each takes a campaign and a question and gives the place of a configuration in its grid, or None for "none fits".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from joulebox_server.analysis.candidates import Known, candidates
from joulebox_server.analysis.documents import Recommendation, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.recommend import recommend

from .scoring import Campaign

OPTUNA_TRIALS = 100
CONFIRM_ROUNDS, CONFIRMED_AT_ONCE = 2, 4


@dataclass(frozen=True)
class Question:
    """The best picture for a budget [J], or, where it is None, the cheapest one; always within a limit."""

    budget: float | None
    limit: float


@lru_cache(maxsize=64)
def found_by(campaign: Campaign) -> tuple[Tradeoff, Known]:
    """Built once for all questions to a campaign; a proof has 60 of them."""
    tradeoff = campaign.tradeoff()
    return tradeoff, candidates(tradeoff, "energy_j")


def joulebox(campaign: Campaign, question: Question) -> int | None:
    """As `joulebox recommend`: by the upper confidence bounds; predictions answer where nothing measured fits."""
    tradeoff, known = found_by(campaign)
    answer = recommend(tradeoff, question.budget, difference_limit=question.limit, proposals=0, known=known)
    return _place(campaign, answer)


def joulebox_predicting(campaign: Campaign, question: Question) -> int | None:
    """As `joulebox recommend --predict`: combinations that the campaign did not measure are candidates too."""
    tradeoff, known = found_by(campaign)
    answer = recommend(
        tradeoff, question.budget, difference_limit=question.limit, predict=True, proposals=0, known=known
    )
    return _place(campaign, answer)


def joulebox_confirming(campaign: Campaign, question: Question) -> int | None:
    """As `joulebox recommend --confirm`, asked again each time that what it proposed was measured.

    What was measured already is not measured again here, as it could be with new seeds.
    """
    grid, held = campaign.known.grid, campaign
    for _ in range(CONFIRM_ROUNDS):
        tradeoff, known = found_by(held)
        answer = recommend(
            tradeoff, question.budget, difference_limit=question.limit, proposals=CONFIRMED_AT_ONCE, known=known
        )
        wanted = [grid.configurations.index({name: c.settings[name] for name in grid.axes}) for c in answer.proposals]
        new = [place for place in wanted if place not in held.places]
        if not new:
            break
        held = held.extended(new)
    return joulebox(held, question)


def joulebox_told_costs(campaign: Campaign, question: Question) -> int | None:
    """As `joulebox`, who knows every true cost: what is lost through differences."""
    return _told(campaign, question, cost=campaign.known.cost)


def joulebox_told_differences(campaign: Campaign, question: Question) -> int | None:
    """As `joulebox`, who knows every true difference: what is lost through costs."""
    return _told(campaign, question, difference=campaign.known.difference)


def _told(campaign: Campaign, question: Question, **truth: np.ndarray) -> int | None:
    tradeoff, (measured, _) = found_by(campaign)
    told = [
        replace(
            candidate,
            **{name: _exactly(values[campaign.known.ids.index(candidate.key)]) for name, values in truth.items()},
        )
        for candidate in measured
    ]
    answer = recommend(tradeoff, question.budget, difference_limit=question.limit, proposals=0, known=(told, []))
    return _place(campaign, answer)


def _exactly(value: float) -> Interval:
    return Interval(low=value, value=value, high=value)


def _place(campaign: Campaign, answer: Recommendation) -> int | None:
    if answer.settings is None:
        return None
    grid = campaign.known.grid
    return grid.configurations.index({name: answer.settings[name] for name in grid.axes})


def mean_of_three(campaign: Campaign, question: Question) -> int | None:
    """By the means of the repeats, as if they were exact."""
    return _by_values(campaign, question, campaign.energy.mean(axis=1), campaign.mean_difference)


def measured_once(campaign: Campaign, question: Question) -> int | None:
    """By the first repeat alone."""
    return _by_values(campaign, question, campaign.energy[:, 0], campaign.first_difference)


def _by_values(campaign: Campaign, question: Question, energy: np.ndarray, difference: np.ndarray) -> int | None:
    fits = difference <= question.limit
    if question.budget is not None:
        fits &= energy <= question.budget
    if not fits.any():
        return None
    sought = energy if question.budget is None else difference
    return int(campaign.places[np.argmin(np.where(fits, sought, np.inf))])


def optuna_best(campaign: Campaign, question: Question, seed: int) -> int | None:
    """Optuna's best feasible trial: constrained TPE, every trial measured once."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    grid = campaign.known.grid
    places = {tuple(settings.values()): place for place, settings in enumerate(grid.configurations)}

    def objective(trial: optuna.Trial) -> float:
        place = places[tuple(trial.suggest_categorical(name, list(values)) for name, values in grid.axes.items())]
        energy, difference = campaign.energy[place, 0], campaign.first_difference[place]
        trial.set_user_attr("place", place)
        trial.set_constraint("budget", -1.0 if question.budget is None else float(energy - question.budget))
        trial.set_constraint("limit", float(difference - question.limit))
        return float(energy if question.budget is None else np.log(difference))

    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    study.optimize(objective, n_trials=OPTUNA_TRIALS)
    feasible = [trial for trial in study.trials if max(trial.constraints.values()) <= 0]
    if not feasible:
        return None
    return int(min(feasible, key=lambda trial: np.inf if trial.value is None else trial.value).user_attrs["place"])
