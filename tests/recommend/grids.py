"""The grids that the recommendation is tuned and scored on, and the renders of them that are kept.

A grid is complete: every combination of its axes is rendered with several seeds. Each grid names the sets of seeds
that the rules were tuned on and those that they are scored on; of the scenes that are held out nothing was tuned on.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, product
from pathlib import Path
from typing import Any

from joulebox_server.sweeps.seeds import own_seed

DATA = Path(__file__).parent / "data"
SIDE = 96
"""Pixels of a side: as small as keeps the scenes recognisable, so that thousands of renders take minutes."""

SEEDS = {
    "B": (5, 6, 7, 8, 9),
    "D": (60, 61, 62, 63, 64),
    "E": (90, 91, 92, 93, 94),
    "F": tuple(range(200, 208)),
    "G": tuple(range(400, 408)),
}
"""Of each set that campaigns draw from. B are those of the held-out scenes; see `Grid.seed_of`."""
TRUTH_SEEDS = {
    "B": tuple(range(20, 28)),
    "D": tuple(range(70, 86)),
    "E": tuple(range(100, 116)),
    "F": tuple(range(300, 332)),
    "G": tuple(range(500, 596)),
}
"""More seeds for configurations that may be within a limit; see `Grid.truth_seeds`.

Up to set F, for those alone that were near the front."""
TRUTH_AT_LEAST = 32
FIRST_LOOK = (0, 1)
"""Seeds with which each configuration of boxes and spheres was rendered first, by an earlier build of the renderer.

What they showed to be far off was not rendered with the seeds of sets D to F: its differences, and its costs brought to
the set's pace, are those of the first look."""
COST_SEEDS = {name: (*SEEDS[name], *TRUTH_SEEDS[name]) for name in SEEDS} | {"B": SEEDS["B"]}
"""Whose CPU seconds tell what is true of costs, by set: these renders are of one build of the renderer.

Some with hidden seeds B were rendered by a later, faster one; their pictures differ from the reference alike."""
REPEATS = 3
"""Measurements of a configuration in a campaign, each with another seed of the set."""
STAGES = ("photon_map", "precomputed_irradiance", "direct", "indirect", "caustics")

Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Grid:
    """A scene, how it is shown, the settings that all of its renders share, the axes, and its sets of seeds.

    tuned, scored   sets of seeds that rules were tuned on, and that the present rules are scored on
    noisy           settings with which one seed in twenty is so bad that it takes all hidden seeds to know the mean
    own_from        the first seed of the tables that each configuration has for itself
    """

    scene: str
    exposure: float
    fixed: Settings
    axes: Mapping[str, tuple[Any, ...]]
    tuned: tuple[str, ...] = ("D", "E", "F")
    scored: tuple[str, ...] = ("G",)
    noisy: Settings | None = None
    own_from: float = SEEDS["D"][0]

    def seed_of(self, settings: Settings, number: int) -> int:
        """What the renderer is given for a seed of the tables: itself, or from `own_from` on one of its own."""
        return number if number < self.own_from else own_seed(0, settings, number)

    def truth_seeds(self, name: str, settings: Settings) -> tuple[int, ...]:
        """Hidden seeds of a set that a configuration is judged by."""
        is_noisy = self.noisy is not None and self.noisy.items() <= settings.items()
        return TRUTH_SEEDS[name] if is_noisy else TRUTH_SEEDS[name][:TRUTH_AT_LEAST]

    def has_own_seeds(self, name: str) -> bool:
        """Whether each configuration has seeds of its own in a set."""
        return min(SEEDS[name]) >= self.own_from

    @cached_property
    def configurations(self) -> list[dict[str, Any]]:
        """Every combination of the axes, in their order."""
        return [dict(zip(self.axes, values, strict=True)) for values in product(*self.axes.values())]

    @property
    def held_out(self) -> bool:
        """Whether nothing was tuned on it."""
        return not self.tuned

    @property
    def sets(self) -> tuple[str, ...]:
        """The sets of seeds that are rendered."""
        return (*self.tuned, *self.scored)

    @property
    def limit(self) -> float:
        """Acceptable difference: 100 at 256x256, scaled to this size."""
        return 100.0 * SIDE * SIDE / 65536


GRIDS = {
    grid.scene: grid
    for grid in (
        Grid(
            "cornell-boxes", 3.0, {"gather_distance_m": 0.03},
            {"samples_per_pixel": (2, 4, 9), "shadow_rays": (1, 2, 4, 9), "global_photons": (5_000, 20_000, 60_000),
             "final_gather_rays": (36, 100, 256), "irradiance_cache_tolerance": (0.4, 0.8, 1.6)},
            noisy={"global_photons": 5_000},
        ),
        Grid(
            "cornell-spheres", 3.0, {"gather_distance_m": 0.03},
            {"samples_per_pixel": (2, 4, 9), "shadow_rays": (1, 4), "caustic_photons": (10_000, 30_000, 100_000),
             "global_photons": (5_000, 20_000, 60_000), "final_gather_rays": (36, 100, 256),
             "irradiance_cache_tolerance": (0.5, 1.0)},
        ),
        Grid(
            "thin-wall", 1.0, {},
            {"samples_per_pixel": (2, 4, 9), "shadow_rays": (1, 4), "gather_distance_m": (0.01, 0.03, 0.09),
             "global_photons": (5_000, 20_000, 60_000), "final_gather_rays": (64, 144, 324),
             "irradiance_cache_tolerance": (0.5, 1.0)},
            tuned=(), scored=("B",), own_from=math.inf,
        ),
        Grid(
            "corner-light", 1.0, {},
            {"samples_per_pixel": (2, 4, 9), "shadow_rays": (1, 4), "gather_distance_m": (0.015, 0.045),
             "global_photons": (5_000, 20_000, 60_000), "final_gather_rays": (36, 100, 256),
             "irradiance_cache_tolerance": (0.4, 0.8, 1.6)},
            tuned=(), scored=("B",), own_from=0,
        ),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Render:
    """One picture: what it took and how far it is from the reference.

    cpu_s       CPU seconds over all threads, the stand-in for energy
    stages_s    CPU seconds of each stage that ran
    pixels      beginning of the pixel hash: equal where a setting changed nothing
    in_a_row    renders with this seed that followed each other, this one among them
    """

    settings: dict[str, Any]
    seed: int
    cpu_s: float
    stages_s: dict[str, float]
    difference: float
    pixels: str
    in_a_row: int = 1


def columns(grid: Grid) -> list[str]:
    """Of a grid's table."""
    return [*grid.axes, "seed", "cpu_s", *(f"{stage}_cpu_s" for stage in STAGES), "difference", "pixels"]


def table(grid: Grid) -> Path:
    """The file of a grid's renders."""
    return DATA / f"{grid.scene}.csv"


def read_renders(grid: Grid) -> list[Render]:
    """The renders of a grid that are kept; none where there is no file yet."""
    if not table(grid).is_file():
        return []
    with table(grid).open(newline="", encoding="utf-8") as file:
        runs = [list(rows) for _, rows in groupby(csv.DictReader(file), key=lambda row: row["seed"])]
    return [_render(grid, row, len(run)) for run in runs for row in run]


def _render(grid: Grid, row: Mapping[str, str], in_a_row: int) -> Render:
    return Render(
        {name: type(values[0])(row[name]) for name, values in grid.axes.items()},
        int(row["seed"]),
        float(row["cpu_s"]),
        {stage: float(row[f"{stage}_cpu_s"]) for stage in STAGES if row[f"{stage}_cpu_s"]},
        float(row["difference"]),
        row["pixels"],
        in_a_row,
    )


def read_reference(grid: Grid) -> dict[str, Any]:
    """How the reference of a grid was made, its noise floor, and what the preset `reference` takes and reaches."""
    found: dict[str, Any] = json.loads((DATA / f"{grid.scene}.json").read_text(encoding="utf-8"))
    return found


def is_complete(grid: Grid, name: str) -> bool:
    """Whether the study of a set of seeds was finished: its last seed is there as often as the one before it."""
    seeds = [render.seed for render in read_renders(grid)]
    before, last = (seeds.count(seed) for seed in grid.truth_seeds(name, grid.noisy or {})[-2:])
    return SEEDS[name][-1] in seeds and 0 < before == last
