"""Simulated campaigns over a grid that was really rendered: what a meter would show, and what is true.

A campaign measures configurations REPEATS times each, with REPEATS seeds drawn from a set: for each configuration by
itself, or the same ones for all. A meter's noise is drawn anew for every measurement, its drift once for a session: a
block of the sweep, in which every configuration is measured once, or, worse, all blocks.

What is true of a cost is the sum of what its stages take; see `_stage_costs`. What is true of a difference is its mean
over seeds that no campaign sees; what is far beyond the limit has none of those, and its mean over the set decides
nothing. Other sets tell nothing of it where another build of the renderer made their pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from joulebox_server.analysis.documents import StageCost, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.points import Observation, Subject
from joulebox_server.analysis.tradeoff import build_tradeoff

from .grids import COST_SEEDS, FIRST_LOOK, REPEATS, SEEDS, SIDE, STAGES, TRUTH_SEEDS, Grid, Render, read_renders

NOISE_SHARE = 0.05
DRIFT_SHARE = 0.03
CLOCK_SHARE = 0.02
"""Noise of how a measurement's energy is told apart by stages: their times are known better than joules."""
READS = {
    "photon_map": ("global_photons", "caustic_photons"),
    "precomputed_irradiance": ("global_photons", "gather_distance_m"),
    "direct": ("samples_per_pixel", "shadow_rays"),
    "indirect": ("samples_per_pixel", "gather_distance_m", "caustic_photons", "global_photons", "final_gather_rays",
                 "irradiance_cache_tolerance"),
    "caustics": ("samples_per_pixel", "caustic_photons"),
}  # fmt: skip
"""The settings that a stage's work depends on."""
FEWEST_IN_A_ROW = 30
"""Renders with one seed that followed each other, from which the machine's pace at that time is told."""
POLISHES = 10
"""Turns of alternating medians; they settle within a few."""
FAR_OFF = 1e6
"""Stands for a difference that is known to be far beyond every limit."""


@dataclass(frozen=True, eq=False)
class Known:
    """A grid with one set of seeds: what is measured, and what is true, by place in `grid.configurations`.

    repeats         (n, seeds) difference with each seed of the set; NaN where a configuration is known to be far off
    cost            (n,) true cost of an image, in CPU seconds standing for joules
    stages          (n,) true cost of each stage, 0 where it does not run; their sum is the cost
    own_seeds       whether each configuration has seeds of its own, or all have the same
    difference      (n,) true difference
    hidden          of each the differences, (seeds,) or none, whose mean is what is true
    """

    grid: Grid
    repeats: np.ndarray
    cost: np.ndarray
    difference: np.ndarray
    pixels: list[str]
    stages: dict[str, np.ndarray]
    own_seeds: bool
    hidden: list[list[float]]

    @cached_property
    def ids(self) -> list[str]:
        return [f"{place:03}" for place in range(len(self.cost))]

    def halves(self, rng: np.random.Generator) -> tuple[Known, Known]:
        """As one half of the hidden seeds, drawn at random, shows what is true, and as the other does."""
        drawn = [rng.permutation(each) for each in self.hidden]
        means = [[float(np.mean(part)) if len(part) else np.nan for part in np.array_split(each, 2)] for each in drawn]
        told = np.where(np.isfinite(means), means, self.difference[:, None])
        first, second = (replace(self, difference=half) for half in told.T)
        return first, second

    def best(self, budget: float, limit: float) -> float | None:
        """The smallest true difference that truly fits."""
        fits = (self.cost <= budget) & (self.difference <= limit)
        return float(self.difference[fits].min()) if fits.any() else None

    def cheapest(self, limit: float) -> float | None:
        """The lowest true cost of what is truly within the limit."""
        fits = self.difference <= limit
        return float(self.cost[fits].min()) if fits.any() else None


def known(grid: Grid, seeds: str) -> Known:
    """A grid as the renders with a set of seeds show it."""
    found = _by_place(grid)
    repeats = [_of_set(each, SEEDS[seeds]) for each in found]
    hidden = [[each[s].difference for s in TRUTH_SEEDS[seeds] if s in each] for each in found]
    true = [np.mean(unseen) if unseen else np.nanmean(seen) for unseen, seen in zip(hidden, repeats, strict=True)]
    pixels = [min(each.items())[1].pixels for each in found]
    stages = _stage_costs(grid, seeds)
    cost = np.sum(list(stages.values()), axis=0)
    return Known(grid, np.array(repeats), cost, np.array(true), pixels, stages, grid.has_own_seeds(seeds), hidden)


def _by_place(grid: Grid) -> list[dict[int, Render]]:
    """The renders of each configuration by seed."""
    found: dict[tuple[Any, ...], dict[int, Render]] = {}
    for render in read_renders(grid):
        found.setdefault(tuple(render.settings.values()), {})[render.seed] = render
    return [found[tuple(settings.values())] for settings in grid.configurations]


def _stage_costs(grid: Grid, seeds: str) -> dict[str, np.ndarray]:
    """CPU seconds of each configuration's stages: the median over a set's renders that do the same work.

    A render's CPU seconds scatter by 10 % for the machine's own reasons, so that a median of ten renders is off by 4 %;
    but a stage does the same work in all configurations that agree in the settings which it reads. That they do is
    tested. Where a set has none, what the first look took stands in.
    """
    stages = {stage: np.zeros(len(grid.configurations)) for stage in STAGES}
    for stage, cost in stages.items():
        logs = own_stage_logs(grid, stage, (*COST_SEEDS[seeds], *FIRST_LOOK))
        for places in same_work(grid, stage):
            of_set, first_look = np.split(logs[places], [len(COST_SEEDS[seeds])], axis=1)
            told = of_set if np.isfinite(of_set).any() else first_look
            if np.isfinite(told).any():
                cost[places] = np.exp(np.nanmedian(told))
    return {stage: cost for stage, cost in stages.items() if cost.any()}


def own_stage_logs(grid: Grid, stage: str, seeds: Sequence[int]) -> np.ndarray:
    """(n, seeds) logs of what a stage took in each render with one of these seeds; NaN where it did not run.

    What a seed's renders took longer for all is taken off: they follow each other, so that this is how slow the
    machine was at that time. A few that were rendered later do not tell that, and are left out.
    """
    found = [{s: r for s, r in each.items() if r.in_a_row >= FEWEST_IN_A_ROW} for each in _by_place(grid)]
    whole = np.log([[each[s].cpu_s if s in each else np.nan for s in seeds] for each in found])
    took = [[each[s].stages_s.get(stage, np.nan) if s in each else np.nan for s in seeds] for each in found]
    return np.asarray(np.log(took) - _slowness(whole))


def same_work(grid: Grid, stage: str) -> list[list[int]]:
    """Places of the configurations that agree in all settings which a stage reads."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for place, settings in enumerate(grid.configurations):
        groups.setdefault(tuple(settings.get(name) for name in READS[stage]), []).append(place)
    return list(groups.values())


def _slowness(logs: np.ndarray) -> np.ndarray:
    """(seeds,) by how much, in logs, the renders with each seed took longer than others; NaN where there are none."""
    logs = logs[np.isfinite(logs).any(axis=1)]
    shifts = np.where(np.isfinite(logs).any(axis=0), 0.0, np.nan)
    there = np.isfinite(shifts)
    for _ in range(POLISHES):
        own = np.nanmedian(logs[:, there] - shifts[there], axis=1)
        shifts[there] = np.nanmedian(logs[:, there] - own[:, None], axis=0)
        shifts[there] -= np.median(shifts[there])
    return shifts


def _of_set(renders: dict[int, Render], seeds: Sequence[int]) -> list[float]:
    """Differences with the seeds of a set. One that another set showed to be far off stands in by that set's."""
    shown = [renders[s].difference if s in renders else np.nan for s in seeds]
    if not np.isfinite(shown).any():
        others = [render.difference for render in renders.values()]
        shown[: len(others)] = others[: len(seeds)]
    return shown


@dataclass(frozen=True, eq=False)
class Campaign:
    """What was measured: energies and differences of some configurations, (k, 3); `places` says which.

    stages  energy of each stage, (k, 3); their sum is the whole energy
    seeds   (n, 3) places in their set of the seeds that each configuration of the grid is or would be rendered with
    number  what the noise of later measurements is drawn by
    """

    known: Known
    places: np.ndarray
    energy: np.ndarray
    stages: dict[str, np.ndarray]
    difference: np.ndarray
    seeds: np.ndarray
    number: int

    def extended(self, places: Sequence[int]) -> Campaign:
        """With more configurations, measured later in sessions of their own, with the same seeds."""
        rng = np.random.default_rng([self.number, len(self.places)])
        later = _measured(self.known, np.asarray(places), self.seeds, rng, sessions=REPEATS)
        return Campaign(
            self.known,
            np.concatenate([self.places, later.places]),
            np.concatenate([self.energy, later.energy]),
            {name: np.concatenate([cost, later.stages[name]]) for name, cost in self.stages.items()},
            np.concatenate([self.difference, later.difference]),
            self.seeds,
            self.number,
        )

    @property
    def mean_difference(self) -> np.ndarray:
        """(k,) mean over the repeats; a large one where a far-off configuration was rendered with none of the seeds."""
        count = np.isfinite(self.difference).sum(axis=1)
        return np.where(count > 0, np.nansum(self.difference, axis=1) / np.maximum(count, 1), FAR_OFF)

    @property
    def first_difference(self) -> np.ndarray:
        """(k,) of the first repeat; the mean stands in where a far-off configuration was not rendered with its seed."""
        first = self.difference[:, 0]
        return np.where(np.isfinite(first), first, self.mean_difference)

    def tradeoff(self) -> Tradeoff:
        """As the server builds it from results."""
        grid = self.known.grid
        subject = Subject("study", grid.scene, "simulated", SIDE, SIDE, axes=list(grid.axes), exposure=grid.exposure)
        observations = [
            self._observation(row, place, repeat)
            for row, place in enumerate(self.places)
            for repeat in range(REPEATS)
            if np.isfinite(self.difference[row, repeat])
        ]
        return build_tradeoff(subject, observations)

    def _seed(self, place: int, repeat: int) -> int:
        """A number that stands for the seed: no two configurations have one in common unless they share all."""
        seed = int(self.seeds[place, repeat])
        return seed * len(self.known.cost) + int(place) if self.known.own_seeds else seed

    def _observation(self, row: int, place: int, repeat: int) -> Observation:
        cost = float(self.energy[row, repeat])
        exact = Interval(value=cost, low=cost, high=cost)
        return Observation(
            configuration_id=self.known.ids[place],
            settings={**self.known.grid.configurations[place], "seed": repeat},
            repeat=repeat,
            seed=self._seed(place, repeat),
            time_s=exact,
            cpu_s=exact,
            energy_j=exact,
            quality="measured",
            windows=1,
            difference=float(self.difference[row, repeat]),
            pixel_sha256=self.known.pixels[place],
            stages={
                name: StageCost(time_s=float(taken[row, repeat]), energy_j=float(taken[row, repeat]))
                for name, taken in self.stages.items()
                if taken[row, repeat] > 0
            },
        )


def campaign(
    known: Known, rng: np.random.Generator, places: Sequence[int] | None = None, one_session: bool = False
) -> Campaign:
    """Measure all configurations, or those at `places`: each repeat is a session, or all are one."""
    chosen = np.arange(len(known.cost)) if places is None else np.asarray(places)
    seeds = _own_seeds(known, rng) if known.own_seeds else _shared_seeds(known, rng)
    return _measured(known, chosen, seeds, rng, sessions=1 if one_session else REPEATS)


def _own_seeds(known: Known, rng: np.random.Generator) -> np.ndarray:
    """Drawn for each configuration from the seeds that it was rendered with, as far as there are enough."""
    order = rng.random(known.repeats.shape)
    order[~np.isfinite(known.repeats)] = np.inf
    return np.argsort(order, axis=1)[:, :REPEATS]


def _shared_seeds(known: Known, rng: np.random.Generator) -> np.ndarray:
    return np.tile(rng.choice(known.repeats.shape[1], REPEATS, replace=False), (len(known.cost), 1))


def _measured(known: Known, places: np.ndarray, seeds: np.ndarray, rng: np.random.Generator, sessions: int) -> Campaign:
    noise = 1 + NOISE_SHARE * rng.standard_normal((len(places), REPEATS))
    drift = 1 + DRIFT_SHARE * rng.standard_normal(sessions)
    energy = known.cost[places, None] * drift * noise
    return Campaign(
        known,
        places,
        energy,
        _told_apart(known, places, energy, rng),
        np.take_along_axis(known.repeats[places], seeds[places], axis=1),
        seeds,
        int(rng.integers(2**32)),
    )


def _told_apart(
    known: Known, places: np.ndarray, energy: np.ndarray, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """An energy's stages: each with a clock's noise of its own, then brought to the sum."""
    shown = {
        name: cost[places, None] * (1 + CLOCK_SHARE * rng.standard_normal(energy.shape))
        for name, cost in known.stages.items()
    }
    total = np.sum(list(shown.values()), axis=0)
    return {name: each / total * energy for name, each in shown.items()}
