"""Render the grids into tests/recommend/data: `make study`, or `python -m tests.recommend.study [SCENE ...]`.

A run that was interrupted goes on where it stopped. CPU time stands for energy: it is taken in one thread, warm,
and every configuration is met again with each seed, so that a slow minute of the machine falls on all of them.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from joulebox_render.errors import RenderError
from joulebox_render.plan import make_plan
from joulebox_render.session import Image, Session
from joulebox_render.settings import make_settings
from joulebox_server.analysis.difference import Display, compare

from .grids import (
    DATA,
    GRIDS,
    REPEATS,
    SEEDS,
    SIDE,
    STAGES,
    TRUTH_SEEDS,
    Grid,
    Render,
    columns,
    is_complete,
    read_renders,
    table,
)  # fmt: skip

SCENES = Path(__file__).resolve().parents[2] / "scenes"
FILM = {"width": SIDE, "height": SIDE, "threads": 1}
REFERENCE = {
    "samples_per_pixel": 64, "shadow_rays": 8, "final_gather_rays": 1024, "irradiance_cache_tolerance": 0.3,
    "global_photons": 400_000, "caustic_photons": 400_000, "gather_distance_m": 0.015,
    "caustic_gather_distance_m": 0.004,
}  # fmt: skip
REFERENCE_SEEDS = range(1000, 1006)
PRESET_SEEDS = (0, 1)
FAR = 4.0
"""A configuration whose first two seeds differ by more than this many limits is known well enough."""
KNOWN_ENOUGH = 2
NEAR_LIMITS = 2.5
"""What its own set's seeds show to be within so many limits is rendered with hidden seeds: any question may name it.

Whether it is near the front does not matter: what is judged by the seeds that campaigns draw from shares their luck,
and settings without hidden seeds came out as the best, or broke limits, by that alone."""


class Painter:
    """Renders one scene again and again; loads and compiles once."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._session = Session(SCENES / grid.scene / "scene.xml", make_settings({"preset": "fine"}, FILM))

    def paint(self, settings: dict[str, Any], seed: int) -> Image:
        """A picture with these settings beside the grid's own."""
        complete = make_settings(settings, FILM, {"seed": seed})
        plan = make_plan(self._session.scene, complete)
        self._session.context = replace(self._session.context, settings=complete, plan=plan)
        return self._session.render()


def reference_picture(grid: Grid, painter: Painter) -> tuple[np.ndarray, float]:
    """Mean of renders that are better than any of the grid, and how far the means of its halves differ.

    Kept in a file beside the table while the study is unfinished: it takes as long as a hundred configurations.
    """
    kept = DATA / f"{grid.scene}.reference.npy"
    if kept.is_file():
        renders = np.load(kept)
    else:
        renders = np.stack([painter.paint(REFERENCE, seed).pixels for seed in REFERENCE_SEEDS])
        np.save(kept, renders)
    halves = [half.mean(axis=0) for half in np.split(renders, 2)]
    return renders.mean(axis=0), compare(*halves, Display(exposure=grid.exposure)).value


def row_of(image: Image, difference: float) -> dict[str, Any]:
    """What the tables keep of a picture."""
    stages = image.clock.totals()
    return {
        "cpu_s": round(image.cpu_s, 5),
        **{f"{name}_cpu_s": round(stages[name]["cpu_s"], 5) if name in stages else "" for name in STAGES},
        "difference": float(f"{difference:.6g}"),
        "pixels": image.pixel_sha256[:12],
    }


def write_reference(grid: Grid, painter: Painter, picture: np.ndarray, floor: float) -> None:
    """The preset `reference` on this scene: what it takes, and how far it is from the better one."""
    target = DATA / f"{grid.scene}.json"
    if target.is_file():
        return
    renders = []
    for seed in PRESET_SEEDS:
        image = painter.paint({"preset": "reference", **FILM}, seed)
        difference = compare(picture, image.pixels, Display(exposure=grid.exposure)).value
        renders.append({"seed": seed, **row_of(image, difference)})
    document = {
        "scene": grid.scene, "width": SIDE, "height": SIDE, "exposure": grid.exposure, "limit": grid.limit,
        "reference_settings": REFERENCE, "reference_seeds": list(REFERENCE_SEEDS),
        "noise_floor_of_half": floor, "preset_reference": renders,
    }  # fmt: skip
    target.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def study(grid: Grid) -> None:
    """Render whatever is missing of a grid."""
    start = time.monotonic()
    painter = Painter(grid)
    painter.paint(grid.configurations[0] | dict(grid.fixed), 0)
    picture, floor = reference_picture(grid, painter)
    write_reference(grid, painter, picture, floor)
    kept = Kept(grid)
    for name in grid.sets:
        if is_complete(grid, name):
            continue
        for seed in SEEDS[name]:
            kept.complete(painter, picture, [c for c in grid.configurations if not kept.far_off(c, seed)], seed)
            print(f"[{time.monotonic() - start:5.0f} s] {grid.scene}: seed {seed} done", file=sys.stderr, flush=True)
        near = kept.near(name)
        for seed in TRUTH_SEEDS[name]:
            judged = [settings for settings in near if seed in grid.truth_seeds(name, settings)]
            kept.complete(painter, picture, judged, seed)
            print(
                f"[{time.monotonic() - start:5.0f} s] {grid.scene}: hidden seed {seed} done",
                file=sys.stderr,
                flush=True,
            )
    (DATA / f"{grid.scene}.reference.npy").unlink()


class Kept:
    """The table of a grid: what it holds, and what is still worth rendering."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._renders: dict[tuple[Any, ...], dict[int, Render]] = {}
        for render in read_renders(grid):
            self._renders.setdefault(tuple(render.settings.values()), {})[render.seed] = render

    def complete(self, painter: Painter, picture: np.ndarray, wanted: list[dict[str, Any]], seed: int) -> None:
        """Render those of the wanted configurations that are missing with this seed; each is kept at once."""
        is_new = not table(self._grid).is_file()
        with table(self._grid).open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns(self._grid), lineterminator="\n")
            if is_new:
                writer.writeheader()
            for settings in wanted:
                known = self._renders.setdefault(tuple(settings.values()), {})
                if seed in known:
                    continue
                image = painter.paint(settings | dict(self._grid.fixed), self._grid.seed_of(settings, seed))
                difference = compare(picture, image.pixels, Display(exposure=self._grid.exposure)).value
                writer.writerow({**settings, "seed": seed, **row_of(image, difference)})
                file.flush()
                known[seed] = Render(settings, seed, image.cpu_s, {}, difference, "")

    def far_off(self, settings: dict[str, Any], seed: int) -> bool:
        """Whether more seeds would teach nothing: far beyond the limit with the first two of its own set.

        Other sets may be of another build of the renderer, whose pictures differ more or less.
        """
        known = self._renders.get(tuple(settings.values()), {})
        own = next(seeds for seeds in SEEDS.values() if seed in seeds)
        first = [known[s].difference for s in own[:KNOWN_ENOUGH] if s in known and s != seed]
        return len(first) == KNOWN_ENOUGH and sum(first) / KNOWN_ENOUGH > FAR * self._grid.limit

    def near(self, name: str) -> list[dict[str, Any]]:
        """Configurations that may be within a limit that is asked for, as the seeds of a set show them."""
        means = [
            np.mean([each.difference for seed, each in self._renders[tuple(c.values())].items() if seed in SEEDS[name]])
            for c in self._grid.configurations
        ]
        is_near = np.array(means) <= NEAR_LIMITS * self._grid.limit
        return [c for c, near in zip(self._grid.configurations, is_near, strict=True) if near]


def main() -> int:
    """Render the grids that are named, or all."""
    parser = argparse.ArgumentParser(prog="study", description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="*", choices=[*GRIDS, []], help="all unless named")
    given = parser.parse_args()
    assert min(len(seeds) for seeds in SEEDS.values()) >= REPEATS
    DATA.mkdir(exist_ok=True)
    try:
        for scene in given.scene or GRIDS:
            study(GRIDS[scene])
    except RenderError as error:
        print(f"study: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("study: interrupted; the next run goes on from here", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
