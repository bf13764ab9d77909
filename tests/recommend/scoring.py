"""Simulated campaigns over a grid that was really rendered: what a meter would show, and what is true.

A campaign measures configurations REPEATS times each, with REPEATS seeds drawn from a set of five. A meter's noise is
drawn anew for every measurement, its drift once for a session: a block of the sweep, in which every configuration is
measured once, or, worse, all blocks. What is true of a configuration is the median of its CPU seconds and the mean of
its difference over seeds that no campaign sees; what is nowhere near the front has none of those, and its mean over
the set decides nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from joulebox_server.analysis.documents import StageCost, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.points import Observation, Subject
from joulebox_server.analysis.tradeoff import build_tradeoff

from .grids import COST_SEEDS, REPEATS, SEEDS, SIDE, TRUTH_SEEDS, Grid, Render, read_renders

NOISE_SHARE = 0.05
DRIFT_SHARE = 0.03
POLISHES = 10
"""Turns of alternating medians; they settle within a few."""
FAR_OFF = 1e6
"""Stands for a difference that is known to be far beyond every limit."""


@dataclass(frozen=True, eq=False)
class Known:
    """A grid with one set of seeds: what is measured, and what is true, by place in `grid.configurations`.

    repeats         (n, 5) difference with each seed of the set; NaN where a configuration is known to be far off
    cost            (n,) true cost of an image, in CPU seconds standing for joules
    difference      (n,) true difference
    """

    grid: Grid
    repeats: np.ndarray
    cost: np.ndarray
    difference: np.ndarray
    pixels: list[str]

    @cached_property
    def ids(self) -> list[str]:
        return [f"{place:03}" for place in range(len(self.cost))]

    def best(self, budget: float, limit: float) -> float | None:
        """The smallest true difference that truly fits."""
        fits = (self.cost <= budget) & (self.difference <= limit)
        return float(self.difference[fits].min()) if fits.any() else None

    def cheapest(self, limit: float) -> float | None:
        """The lowest true cost of what is truly within the limit."""
        fits = self.difference <= limit
        return float(self.cost[fits].min()) if fits.any() else None


def known(grid: Grid, seeds: str) -> Known:
    """A grid as the renders with seeds A or B show it."""
    renders = read_renders(grid)
    by_place: dict[tuple[Any, ...], dict[int, Render]] = {}
    for render in renders:
        by_place.setdefault(tuple(render.settings.values()), {})[render.seed] = render
    found = [by_place[tuple(settings.values())] for settings in grid.configurations]
    repeats = [_of_set(each, SEEDS[seeds]) for each in found]
    hidden = [[each[s].difference for s in TRUTH_SEEDS[seeds] if s in each] for each in found]
    true = [np.mean(unseen) if unseen else np.nanmean(seen) for unseen, seen in zip(hidden, repeats, strict=True)]
    pixels = [min(each.items())[1].pixels for each in found]
    return Known(grid, np.array(repeats), _costs(found), np.array(true), pixels)


def _costs(found: Sequence[Mapping[int, Render]]) -> np.ndarray:
    """Median CPU seconds of each configuration, what a seed's renders took longer for all of them taken off.

    All renders with one seed follow each other, so that this is how slow the machine was at that time.
    """
    logs = np.log([[each[s].cpu_s if s in each else np.nan for s in COST_SEEDS] for each in found])
    logs = logs[:, np.isfinite(logs).any(axis=0)]
    shifts = np.zeros(logs.shape[1])
    for _ in range(POLISHES):
        own = np.nanmedian(logs - shifts, axis=1)
        shifts = np.nanmedian(logs - own[:, None], axis=0)
        shifts -= np.median(shifts)
    return np.asarray(np.exp(np.nanmedian(logs - shifts, axis=1)))


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

    seeds   (3,) places of the repeats' seeds in their set
    number  what the noise of later measurements is drawn by
    """

    known: Known
    places: np.ndarray
    energy: np.ndarray
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

    def _observation(self, row: int, place: int, repeat: int) -> Observation:
        cost = float(self.energy[row, repeat])
        exact = Interval(value=cost, low=cost, high=cost)
        return Observation(
            configuration_id=self.known.ids[place],
            settings={**self.known.grid.configurations[place], "seed": repeat},
            repeat=repeat,
            seed=repeat,
            time_s=exact,
            cpu_s=exact,
            energy_j=exact,
            quality="measured",
            windows=1,
            difference=float(self.difference[row, repeat]),
            pixel_sha256=self.known.pixels[place],
            stages={"image": StageCost(time_s=cost, energy_j=cost)},
        )


def campaign(
    known: Known, rng: np.random.Generator, places: Sequence[int] | None = None, one_session: bool = False
) -> Campaign:
    """Measure all configurations, or those at `places`: each repeat is a session, or all are one."""
    chosen = np.arange(len(known.cost)) if places is None else np.asarray(places)
    seeds = rng.choice(known.repeats.shape[1], REPEATS, replace=False)
    return _measured(known, chosen, seeds, rng, sessions=1 if one_session else REPEATS)


def _measured(known: Known, places: np.ndarray, seeds: np.ndarray, rng: np.random.Generator, sessions: int) -> Campaign:
    noise = 1 + NOISE_SHARE * rng.standard_normal((len(places), REPEATS))
    drift = 1 + DRIFT_SHARE * rng.standard_normal(sessions)
    return Campaign(
        known,
        places,
        known.cost[places, None] * drift * noise,
        known.repeats[np.ix_(places, seeds)],
        seeds,
        int(rng.integers(2**32)),
    )
