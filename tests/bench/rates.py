"""What stages make of their rays and photons: ratios to bare embreex on the very same rays, and threads."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

from joulebox_render.bench import RATE_SCENE, Query, record_queries, stage_rates
from joulebox_render.pool import usable_cores
from joulebox_render.session import Session
from joulebox_render.settings import Settings, make_settings
from joulebox_render.stages.eye import look

from .table import Row

NO_EMBREE = "embreex is not installed"
# stage, what is compared, least shares of bare embreex
SHARES = (
    ("direct", "shadow rays, whole direct stage, of bare embreex on the same rays", ">= 60 %", 0.60),
    ("indirect", "final gather (trace, lookup, accumulate), of bare closest hits",
     ">= 45 % (with a table)", 0.45),
    ("photon_map, emission", "photon tracing, of bare closest hits", ">= 35 %", 0.35),
)  # fmt: skip
# A cache of irradiance would leave few gather rays to measure.
RATE_SETTINGS = {"threads": 1, "samples_per_pixel": 1, "shadow_rays": 36, "irradiance_cache_tolerance": 0.0}
GATHER_SETTINGS = {
    "threads": 1, "samples_per_pixel": 1, "shadow_rays": 1, "indirect": "direct_visualization",
    "global_photons": 250_000, "gather_count": 100, "gather_distance_m": 0.02, "photon_spacing": 0,
}  # fmt: skip
GATHER_LIMIT_US = 5.0
SCALING_LIMIT = 0.9
SHORTEST_STAGE_S = 0.05
# Pictures by one and by two threads, in turns with bare rays: so many that of each some find both cores undisturbed.
THREAD_TURNS = 40


def known(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values whose settings this version has."""
    return {name: value for name, value in values.items() if name in Settings.model_fields or name == "preset"}


def share_rows(say: Callable[[str], None], size: Mapping[str, Any]) -> list[Row]:
    """A row for each kind of ray."""
    say("stages against bare embreex on the same rays")
    with Session(RATE_SCENE, make_settings(known(RATE_SETTINGS), size)) as session:
        rates = stage_rates(session)
    rows = []
    for stage, what, goal, least in SHARES:
        if stage not in rates:
            rows.append(Row.not_run(what, goal, NO_EMBREE if not rates else f"no rays in {stage}"))
            continue
        share, rays = rates[stage]["share_of_bare"], rates[stage]["rays"] / rates[stage]["cpu_s"]
        rows.append(Row(what, goal, f"{100 * share:.0f} % ({rays / 1e6:.1f} Mray per CPU second)", share >= least))
    return rows


def gather_row(say: Callable[[str], None], size: Mapping[str, Any]) -> Row:
    """CPU time of a density estimate from 100 photons, asked for pixel after pixel."""
    say("gathering 100 of 250,000 photons")
    with Session(RATE_SCENE, make_settings(GATHER_SETTINGS, size)) as session:
        width, height = session.settings.width, session.settings.height
        assert width and height
        sight = look(session.context, session.scene.camera, 0, width * height)
        session.render()
        spent = [session.render().clock.totals()["indirect"]["cpu_s"] for _ in range(3)]
    each_us = 1e6 * statistics.median(spent) / len(sight.direct.owner)
    return Row(
        "100-nearest gather, 250k photons, 0.02 m, coherent queries", f"<= {GATHER_LIMIT_US:g} us CPU a query",
        f"{each_us:.2f} us", each_us <= GATHER_LIMIT_US,
    )  # fmt: skip


def threads_row(say: Callable[[str], None], size: Mapping[str, Any], turns: int = THREAD_TURNS) -> Row:
    """How much faster two threads are than one, stage by stage, over how much faster they make bare embreex."""
    what = f"threads: {RATE_SCENE}, 1 to 2, wall time, stages over {1000 * SHORTEST_STAGE_S:.0f} ms"
    goal = f">= {SCALING_LIMIT} of raw embreex' own scaling in the same run"
    if usable_cores() < 2:
        return Row.not_run(what, goal, "one core")
    say("one thread against two")
    stages: dict[str, dict[int, list[float]]] = {}
    bare: dict[str, dict[int, list[float]]] = {}
    with ExitStack() as opened:
        sessions = {
            threads: opened.enter_context(Session(RATE_SCENE, make_settings({"threads": threads}, size)))
            for threads in (1, 2)
        }
        embree = getattr(sessions[1].context.intersector, "embree", None)
        if embree is None:
            return Row.not_run(what, goal, NO_EMBREE)
        queries = record_queries(sessions[1])
        for threads, session in list(sessions.items()) * turns:
            for name, row in session.render().clock.totals().items():
                stages.setdefault(name, {1: [], 2: []})[threads].append(row["time_s"])
            for name in queries:
                bare.setdefault(name, {1: [], 2: []})[threads].append(bare_time_s(embree, queries[name], threads))
    return scaling_row(what, goal, speedups(stages), speedups(bare))


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


def speedups(times: Mapping[str, Mapping[int, Sequence[float]]]) -> dict[str, float]:
    """Time on one thread over time on two, of whatever takes long enough; the least of the turns, for noise adds."""
    least = {name: (min(row[1]), min(row[2])) for name, row in times.items()}
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
