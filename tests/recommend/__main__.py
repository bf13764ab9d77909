"""`make test-recommend`: the recommendation's goals with what was measured, as tables.

Scored on seeds, and on a scene, that nothing was tuned on; the rules are those of rules.toml. Nothing here tunes
anything.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices of a few hundred rows: threads only wait for each other

import argparse
import statistics
import sys
import time
from collections.abc import Sequence
from functools import partial

import numpy as np
from joulebox_server.analysis.recommend import recommend
from joulebox_server.analysis.surrogate import Surrogate

from tests.bench.table import Row, goals, markdown_table

from .grids import GRIDS, SEEDS, Grid, is_complete, read_reference
from .proof import PER_CAMPAIGN, QUESTIONS, Score, budget_question, campaigns, judge, limit_question, oracle, score
from .scoring import Known, campaign, known
from .strategies import (
    CONFIRM_ROUNDS,
    CONFIRMED_AT_ONCE,
    OPTUNA_TRIALS,
    joulebox,
    joulebox_confirming,
    joulebox_predicting,
    joulebox_told_costs,
    joulebox_told_differences,
    mean_of_three,
    measured_once,
    optuna_best,
)  # fmt: skip

SEED = 20261122
OPTUNA_QUESTIONS = 30
SHARE = 0.1
FIRST_SHARE = SHARE - CONFIRM_ROUNDS * CONFIRMED_AT_ONCE / 324
"""Measured before anything is asked, where the rest of the tenth goes to what the question makes worth measuring."""
BROKEN_GOAL, REGRET_GOAL, PREDICTED_REGRET_GOAL = 0.03, 0.35, 0.25
COVERAGE_GOAL = (0.90, 0.98)
SAVING_GOAL = 0.9
HEAD = ("scene", "question", "choice by", "questions", "broken", "none though some fit", "regret p50", "p90")


def table_row(scene: str, question: str, name: str, found: Score) -> tuple[str, ...]:
    """One strategy on one scene."""
    return (
        scene, question, name, str(found.asked), f"{found.broken_share:.1%}", str(found.refused),
        f"{found.regret(50):.0%}", f"{found.regret(90):.0%}",
    )  # fmt: skip


def complete_grids(scenes: Sequence[Known], questions: int) -> tuple[list[tuple[str, ...]], list[Row]]:
    """Every configuration measured: ours beside what people do instead."""
    strategies = {
        "joulebox": joulebox,
        "joulebox, told true costs": joulebox_told_costs,
        "joulebox, told true differences": joulebox_told_differences,
        "mean of 3": mean_of_three,
        "measured once": measured_once,
    }
    lines, rows = [], []
    for held in scenes:
        scene = held.grid.scene
        for ask, words in ((budget_question, "best for a budget"), (limit_question, "cheapest within a limit")):
            found = score(held, strategies, ask, SEED, questions)
            found["oracle of half the hidden seeds"] = oracle(held, ask, SEED, questions)
            lines += [table_row(scene, words, name, each) for name, each in found.items()]
            rows += goal_rows(scene, words, found["joulebox"])
        lines.append(table_row(scene, "best for a budget", f"Optuna, {OPTUNA_TRIALS} trials", with_optuna(held)))
        fewer = max(questions // 3, PER_CAMPAIGN)
        worse = score(held, {"joulebox": joulebox}, budget_question, SEED + 1, fewer, one_session=True)
        lines.append(table_row(scene, "best for a budget, all in one session", "joulebox", worse["joulebox"]))
    return lines, rows


def goal_rows(scene: str, words: str, found: Score) -> list[Row]:
    """Goals of one kind of question on one scene."""
    broken, regret = found.broken_share, found.regret(90)
    return [
        Row(f"{scene}: {words}: budget or limit broken", f"<= {BROKEN_GOAL:.0%}", f"{broken:.1%} of {found.asked}",
            broken <= BROKEN_GOAL),
        Row(f"{scene}: {words}: worse than the best that fits, p90", f"<= {REGRET_GOAL:.0%}", f"{regret:.0%}",
            regret <= REGRET_GOAL),
    ]  # fmt: skip


def with_optuna(held: Known) -> Score:
    """Fewer questions: each takes a study of its own."""
    found = Score()
    for number, (measured, rng) in enumerate(campaigns(held, SEED, OPTUNA_QUESTIONS // PER_CAMPAIGN)):
        for turn in range(PER_CAMPAIGN):
            question = budget_question(held, rng)
            judge(held, question, optuna_best(measured, question, seed=PER_CAMPAIGN * number + turn), found)
    return found


def sparse_grids(scenes: Sequence[Known], questions: int) -> tuple[list[tuple[str, ...]], list[Row]]:
    """A tenth measured: what predictions are worth."""
    lines, rows = [], []
    for held in scenes:
        scene, words = held.grid.scene, f"best for a budget, {SHARE:.0%} measured"
        strategies = {"joulebox --predict": joulebox_predicting, "joulebox": joulebox}
        found = score(held, strategies, budget_question, SEED + 2, questions, SHARE)
        confirming = {f"joulebox --confirm {CONFIRMED_AT_ONCE}, {CONFIRM_ROUNDS} times": joulebox_confirming}
        fewer = max(questions // 5, PER_CAMPAIGN)  # each question measures more for itself
        found |= score(held, confirming, budget_question, SEED + 2, fewer, FIRST_SHARE)
        lines += [table_row(scene, words, name, each) for name, each in found.items()]
        for name in ("joulebox --predict", *confirming):
            regret, goal = found[name].regret(50), f"<= {PREDICTED_REGRET_GOAL:.0%}"
            what = f"{scene}: {SHARE:.0%} measured: median regret of {name}"
            rows.append(Row(what, goal, f"{regret:.0%}", regret <= PREDICTED_REGRET_GOAL))
        low, high = COVERAGE_GOAL
        for quantity, share in coverage(held, max(questions // 15, 2)).items():
            rows.append(Row(f"{scene}: {SHARE:.0%} measured: 95 % intervals of {quantity} that hold the truth",
                            f"{low:.0%} to {high:.0%}", f"{share:.1%}", low <= share <= high))  # fmt: skip
    return lines, rows


def coverage(held: Known, count: int) -> dict[str, float]:
    """Share of the predictions whose interval holds what is true."""
    inside: dict[str, list[bool]] = {"cost": [], "difference": []}
    places = {tuple(settings.values()): place for place, settings in enumerate(held.grid.configurations)}
    for measured, _ in campaigns(held, SEED + 3, count, SHARE):
        surrogate = Surrogate(measured.tradeoff(), "energy_j")
        for each in surrogate.forecasts(surrogate.never_run()):
            place = places[tuple(each.settings[name] for name in held.grid.axes)]
            inside["cost"].append(each.cost.low <= held.cost[place] <= each.cost.high)
            inside["difference"].append(each.difference.low <= held.difference[place] <= each.difference.high)
    return {quantity: float(np.mean(each)) for quantity, each in inside.items()}


def savings(scenes: Sequence[Known]) -> list[Row]:
    """The cheapest acceptable settings against the preset `reference`: true costs of what campaigns choose."""
    rows = []
    for held in scenes:
        reference = read_reference(held.grid)
        full = statistics.median(render["cpu_s"] for render in reference["preset_reference"])
        differs = statistics.fmean(render["difference"] for render in reference["preset_reference"])
        chosen = []
        for number in range(10):
            answer = recommend(campaign(held, np.random.default_rng([SEED, 4, number])).tradeoff(), proposals=0)
            if answer.configuration_id is not None:
                chosen.append(1 - float(held.cost[int(answer.configuration_id)]) / full)
        what = f"{held.grid.scene}: saved against preset `reference` at difference <= 100 (at 256x256)"
        if not chosen:
            rows.append(Row(what, f">= {SAVING_GOAL:.0%}", "no campaign found acceptable settings", False))
            continue
        told = f"{min(chosen):.1%} to {max(chosen):.1%} in {len(chosen)} of 10 campaigns; "
        told += f"the preset takes {full:.1f} CPU s and differs by {100 * differs / held.grid.limit:.0f} itself"
        rows.append(Row(what, f">= {SAVING_GOAL:.0%}", told, min(chosen) >= SAVING_GOAL and len(chosen) == 10))
    return rows


def _is_asked(grid: Grid, name: str, tuning: str | None) -> bool:
    return name in grid.scored if tuning is None else name == tuning and name in grid.tuned


def main() -> int:
    """Score and print."""
    parser = argparse.ArgumentParser(prog="test-recommend", description=__doc__.splitlines()[0])
    parser.add_argument("--questions", type=int, default=QUESTIONS, help=f"to each strategy (default {QUESTIONS})")
    parser.add_argument("--scene", nargs="+", choices=GRIDS, default=list(GRIDS), help="all unless named")
    parser.add_argument(
        "--tuning", choices=SEEDS, metavar="SET", help="score seeds that served to choose rules: D, E or F"
    )
    given = parser.parse_args()
    if given.questions < PER_CAMPAIGN:
        parser.error(f"--questions must be at least {PER_CAMPAIGN}")
    start = time.monotonic()
    grids = [GRIDS[name] for name in given.scene]
    sets = [(grid, name) for grid in grids for name in grid.sets if _is_asked(grid, name, given.tuning)]
    scenes = [known(grid, name) for grid, name in sets if is_complete(grid, name)]
    missing = [grid.scene for grid, name in sets if not is_complete(grid, name)]
    parts = [partial(complete_grids, scenes, given.questions), partial(sparse_grids, scenes, given.questions)]
    lines: list[tuple[str, ...]] = []
    why = "its renders are not complete; `make study` renders what is missing"
    rows = [Row.not_run(f"{scene}: all goals", "", why) for scene in missing]
    for part in parts:
        more_lines, more_rows = part()
        lines += more_lines
        rows += more_rows
    rows += savings(scenes)
    print("\n".join([*markdown_table(HEAD, lines), "", *goals(rows)]))
    print(f"[{time.monotonic() - start:.0f} s]", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
