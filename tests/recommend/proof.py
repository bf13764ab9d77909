"""How often advice holds: random questions to simulated campaigns, judged by what is true."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.sweeps.drawing import drawn

from .grids import Grid
from .scoring import Campaign, Known, campaign
from .strategies import Question

QUESTIONS = 300
PER_CAMPAIGN = 10
"""Questions to one campaign, which share its session's drift and the luck of its noise."""
LIMITS_SPAN = (0.5, 2.0)
"""Where limits are random: this share to this multiple of the acceptable difference."""

Strategy = Callable[[Campaign, Question], int | None]


@dataclass
class Score:
    """What became of a strategy's answers.

    broken      answers whose true cost exceeds the budget or whose true difference exceeds the limit
    regrets     of the others: how much worse than the best that truly fits, 0.35 for 35 %
    refused     questions that something truly fits and that were answered by "none"
    """

    asked: int = 0
    answered: int = 0
    broken: int = 0
    refused: int = 0
    regrets: list[float] = field(default_factory=list)

    @property
    def broken_share(self) -> float:
        """Of the questions asked."""
        return self.broken / max(self.asked, 1)

    def regret(self, percentile: float) -> float:
        """Over the answers that hold."""
        return float(np.percentile(self.regrets, percentile)) if self.regrets else float("nan")


def campaigns(
    known: Known, seed: int, count: int, share: float = 1.0, one_session: bool = False
) -> Iterator[tuple[Campaign, np.random.Generator]]:
    """Campaigns that measure the whole grid or a share of it, each with a generator for its questions."""
    for number in range(count):
        yield _campaign(known, seed, number, share, one_session), np.random.default_rng([seed, number, 1])


@lru_cache(maxsize=QUESTIONS // PER_CAMPAIGN)
def _campaign(known: Known, seed: int, number: int, share: float, one_session: bool) -> Campaign:
    """The same one for every kind of question, as what is learnt from it takes longest."""
    rng = np.random.default_rng([seed, number, 0])
    places = None if share == 1 else _drawn(known.grid, round(share * len(known.cost)), seed=seed + number)
    return campaign(known, rng, places, one_session)


def _drawn(grid: Grid, count: int, seed: int) -> list[int]:
    """Places of the configurations that a sweep of so many samples draws from the axes by `rule = "sobol"`."""
    axes = {name: list(values) for name, values in grid.axes.items()}
    scenes = {"name": "study", "scenes": [grid.scene], "axes": axes}
    sweep = SweepDefinition.model_validate({**scenes, "rule": "sobol", "samples": count, "sample_seed": seed})
    return [grid.configurations.index(settings) for settings in drawn(sweep)]


def budget_question(known: Known, rng: np.random.Generator) -> Question:
    """A budget from a little below the cheapest acceptable configuration to the dearest; the acceptable limit."""
    limit = known.grid.limit
    cheapest = known.cheapest(limit) or float(known.cost.min())
    return Question(float(np.exp(rng.uniform(np.log(0.9 * cheapest), np.log(known.cost.max())))), limit)


def limit_question(known: Known, rng: np.random.Generator) -> Question:
    """No budget, and a limit around the acceptable one."""
    low, high = (share * known.grid.limit for share in LIMITS_SPAN)
    return Question(None, float(np.exp(rng.uniform(np.log(low), np.log(high)))))


def judge(known: Known, question: Question, place: int | None, score: Score) -> None:
    """Add one answer to a score."""
    score.asked += 1
    best = known.cheapest(question.limit) if question.budget is None else known.best(question.budget, question.limit)
    if place is None:
        score.refused += best is not None
        return
    score.answered += 1
    cost, difference = float(known.cost[place]), float(known.difference[place])
    if difference > question.limit or (question.budget is not None and cost > question.budget):
        score.broken += 1
    elif best is not None:
        score.regrets.append((cost if question.budget is None else difference) / best - 1)


def score(
    known: Known,
    strategies: dict[str, Strategy],
    ask: Callable[[Known, np.random.Generator], Question],
    seed: int,
    questions: int = QUESTIONS,
    share: float = 1.0,
    one_session: bool = False,
) -> dict[str, Score]:
    """Every strategy on the same campaigns and questions."""
    scores = {name: Score() for name in strategies}
    for held, rng in campaigns(known, seed, -(-questions // PER_CAMPAIGN), share, one_session):
        for question in [ask(known, rng) for _ in range(PER_CAMPAIGN)]:
            for name, strategy in strategies.items():
                judge(known, question, strategy(held, question), scores[name])
    return scores


def oracle(
    known: Known, ask: Callable[[Known, np.random.Generator], Question], seed: int, questions: int = QUESTIONS
) -> Score:
    """Who knows every cost, and every mean over half of the hidden seeds, judged by the other half.

    What is true is known no better than that: nobody who has not seen the seeds that judge can be asked for more.
    """
    found = Score()
    for number in range(-(-questions // PER_CAMPAIGN)):
        rng = np.random.default_rng([seed, number, 2])
        told, judging = known.halves(rng)
        for _ in range(PER_CAMPAIGN):
            question = ask(judging, rng)
            judge(judging, question, _knowing(told, question), found)
    return found


def _knowing(told: Known, question: Question) -> int | None:
    """The best as it is told, without any margin."""
    fits = told.difference <= question.limit
    if question.budget is not None:
        fits &= told.cost <= question.budget
    sought = told.cost if question.budget is None else told.difference
    return int(np.argmin(np.where(fits, sought, np.inf))) if fits.any() else None
