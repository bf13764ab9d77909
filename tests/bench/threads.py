"""What two threads make of a picture's stages, over what they make of bare embreex on the same rays."""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from joulebox_render.bench import RATE_SCENE, Query, record_queries
from joulebox_render.pool import usable_cores
from joulebox_render.session import Session
from joulebox_render.settings import make_settings

from .growth import run_python
from .rates import NO_EMBREE
from .table import Row

SCALING_LIMIT = 0.9
SHORTEST_STAGE_S = 0.05
# Where a process happens to lie in memory shifts the times of threads for as long as it lives, by up to a tenth; and
# others on the machine disturb them for seconds. Of so many processes and turns some are undisturbed.
PROCESSES, TURNS = 3, 12
CHILD = "import sys; sys.path.insert(0, sys.argv[1]); from tests.bench.threads import tell_times; tell_times()"
ROOT = Path(__file__).resolve().parents[2]

Least = dict[str, tuple[float, float]]
"""The least time [s] of one thread and of two, by stage or kind of ray."""


def threads_row(
    say: Callable[[str], None], size: Mapping[str, Any], processes: int = PROCESSES, turns: int = TURNS
) -> Row:
    """How much faster two threads are than one, stage by stage, over how much faster they make bare embreex."""
    what = f"threads: {RATE_SCENE}, 1 to 2, wall time, stages over {1000 * SHORTEST_STAGE_S:.0f} ms"
    goal = f">= {SCALING_LIMIT} of raw embreex' own scaling in the same run"
    if usable_cores() < 2:
        return Row.not_run(what, goal, "one core")
    stages: Least = {}
    bare: Least = {}
    for number in range(processes):
        say(f"one thread against two, process {number + 1} of {processes}")
        told = json.loads(run_python(CHILD, str(ROOT), json.dumps(dict(size)), str(turns)))
        if told is None:
            return Row.not_run(what, goal, NO_EMBREE)
        for least, times in zip((stages, bare), told, strict=True):
            for name, (one, two) in times.items():
                known = least.get(name, (one, two))
                least[name] = min(known[0], one), min(known[1], two)
    return scaling_row(what, goal, speedups(stages), speedups(bare))


def tell_times() -> None:
    """Print `times` of the film and the turns that the command line gives, as JSON."""
    print(json.dumps(times(json.loads(sys.argv[2]), int(sys.argv[3]))))


def times(size: Mapping[str, Any], turns: int) -> tuple[Least, Least] | None:
    """Of the stages of a picture, and of bare embreex on their rays; None without embreex.

    Pictures by one and by two threads are made in turns, each followed by its bare rays; twice, for the first one finds
    caches and memory as bare rays left them, and warm pictures are compared.
    """
    stages: dict[str, dict[int, list[float]]] = {}
    bare: dict[str, dict[int, list[float]]] = {}
    with ExitStack() as opened:
        sessions = {
            threads: opened.enter_context(Session(RATE_SCENE, make_settings({"threads": threads}, size)))
            for threads in (1, 2)
        }
        embree = getattr(sessions[1].context.intersector, "embree", None)
        if embree is None:
            return None
        queries = record_queries(sessions[1])
        for threads, session in list(sessions.items()) * turns:
            for image in (session.render(), session.render()):
                for name, row in image.clock.totals().items():
                    stages.setdefault(name, {1: [], 2: []})[threads].append(row["time_s"])
            for name in queries:
                bare.setdefault(name, {1: [], 2: []})[threads].append(bare_time_s(embree, queries[name], threads))
    return _least(stages), _least(bare)


def _least(taken: Mapping[str, Mapping[int, Sequence[float]]]) -> Least:
    """Of the turns, for noise adds."""
    return {name: (min(row[1]), min(row[2])) for name, row in taken.items()}


def bare_time_s(embree: Any, queries: Sequence[Query], threads: int) -> float:
    """Wall time of bare embreex calls of the queries, spread over threads batch by batch [s]."""

    def ask(query: Query) -> None:
        if query.limit is None:
            embree.run(query.origin, query.direction, query="INTERSECT", output=True)
        else:
            embree.run(query.origin, query.direction, dists=query.limit.copy(), query="OCCLUDED")

    with ThreadPoolExecutor(threads) as pool:
        start = time.perf_counter()
        list(pool.map(ask, queries))
        return time.perf_counter() - start


def speedups(least: Least) -> dict[str, float]:
    """Time on one thread over time on two, of whatever takes long enough."""
    return {name: one / two for name, (one, two) in least.items() if one > SHORTEST_STAGE_S}


def scaling_row(what: str, goal: str, stages: Mapping[str, float], bare: Mapping[str, float]) -> Row:
    """Each stage's speed-up over that of its own rays in bare embreex, or of all rays where it traces too few."""
    if not stages or not bare:
        return Row.not_run(what, goal, "no stage takes long enough")
    common = statistics.median(bare.values())
    by_stage = {name.partition(",")[0]: value for name, value in bare.items()}
    shares = {name: value / by_stage.get(name, common) for name, value in stages.items()}
    told = ", ".join(f"{name} {share:.2f}" for name, share in shares.items())
    return Row(what, goal, f"{told} (bare embreex {common:.2f}x)", min(shares.values()) >= SCALING_LIMIT)
