"""CPU time to a given error: ours, over the candidates, beside Mitsuba's path tracing in the same run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

from joulebox_render.records import F4

from . import mitsuba_side
from .candidates import NAMED, Measured
from .picture_error import brightness_error, cost_at, flip, relative_mse
from .table import Row

# Squares, so that multijitter's strata are square; about twice the samples from one to the next.
SAMPLES = (4, 9, 16, 36, 64, 144, 256, 576, 1024, 2304, 4096, 9216)
# Renders cheaper than this are made twice, so that no kernel is compiled in the one that counts.
WARM_BELOW_CPU_S = 5.0


class Goal(NamedTuple):
    """A ratio of CPU seconds to reach; `it_took` is what the rival needed when the goal was set."""

    scene: str
    flip: float
    ratio: float
    it_took: str


GOALS = (
    Goal("cornell-boxes", 0.05, 6, "5.2 s"),
    Goal("cornell-boxes", 0.03, 6, "16.6 s"),
    Goal("cornell-spheres", 0.05, 30, "141 s; pbrt's SPPM about 97 s"),
)
# scene, relMSE, CPU seconds, what POV-Ray takes
RELMSE_GOALS = (("cornell-boxes", 0.0024, 0.6, 3.6), ("cornell-spheres", 0.0052, 1.2, 4.7))
# A preset lies on the front unless something at most this share of its cost has at most this share of its error.
FRONT_MARGIN = 0.95


def mitsuba_curve(
    scene: str, reference: F4, until_flip: float, say: Callable[[str], None], size: int = 0
) -> list[Measured]:
    """Mitsuba's `path` with growing samples a pixel, cheapest first, until its FLIP is at most `until_flip`."""
    theirs = mitsuba_side.load(scene, sampler="multijitter", size=size)
    curve = []
    for spp in SAMPLES:
        rendered = mitsuba_side.render(theirs, spp, seed=spp)
        if rendered.cpu_s < WARM_BELOW_CPU_S:
            rendered = mitsuba_side.render(theirs, spp, seed=spp + 1)
        pixels = rendered.pixels
        curve.append(
            Measured(
                scene, f"Mitsuba path, {spp} samples a pixel", rendered.cpu_s, relative_mse(pixels, reference),
                flip(pixels, reference), brightness_error(pixels, reference),
            )
        )  # fmt: skip
        say(f"{scene}: {curve[-1].name}: {rendered.cpu_s:.2f} CPU s, FLIP {curve[-1].flip:.4f}")
        if curve[-1].flip <= until_flip:
            break
    return curve


def cheapest(candidates: Sequence[Measured], error: str, limit: float) -> Measured | None:
    """The candidate of least CPU time whose `error` is at most `limit`."""
    good = [each for each in candidates if getattr(each, error) <= limit]
    return min(good, key=lambda each: each.cpu_s, default=None)


def best(candidates: Sequence[Measured], error: str) -> str:
    """The smallest error in words, for when no candidate meets a limit."""
    nearest = min(candidates, key=lambda each: float(getattr(each, error)))
    return f"no candidate gets there; the nearest is {nearest.name} ({getattr(nearest, error):.4f})"


def ratio_row(goal: Goal, ours: Sequence[Measured], theirs: Sequence[Measured]) -> Row:
    """Mitsuba's CPU seconds to a FLIP over ours."""
    what = f"{goal.scene} to FLIP {goal.flip} against converged, CPU time"
    wanted = f">= {goal.ratio:g}x less than Mitsuba 3 LLVM `path`, multijitter (it took {goal.it_took})"
    winner = cheapest(ours, "flip", goal.flip)
    if winner is None:
        return Row(what, wanted, best(ours, "flip"), False)
    told = f"{winner.cpu_s:.2f} s ({winner.name})"
    needed = cost_at([(each.cpu_s, each.flip) for each in theirs], goal.flip)
    if needed is None:
        why = f"Mitsuba not there at {theirs[-1].cpu_s:.0f} s" if theirs else "Mitsuba's LLVM variant cannot run here"
        return Row.not_run(what, wanted, f"{told}; {why}")
    ratio = needed / winner.cpu_s
    return Row(what, wanted, f"{ratio:.1f}x: Mitsuba {needed:.2f} s, ours {told}", ratio >= goal.ratio)


def relmse_row(scene: str, limit: float, budget_s: float, pov_s: float, ours: Sequence[Measured]) -> Row:
    """CPU seconds to a relMSE."""
    what, goal = f"{scene} to relMSE {limit}", f"< {budget_s} CPU s (POV-Ray: {pov_s})"
    winner = cheapest(ours, "relmse", limit)
    if winner is None:
        return Row(what, goal, best(ours, "relmse"), False)
    return Row(what, goal, f"{winner.cpu_s:.2f} s ({winner.name})", winner.cpu_s < budget_s)


def front_row(scene: str, ours: Sequence[Measured], cost_ratio: Callable[[str, str], float]) -> Row:
    """Whether any candidate is both cheaper and nearer to the truth than a named preset.

    What looks so by the costs measured one after another is asked again of `cost_ratio` (candidate, preset), which
    renders both in turns: noise must not decide.
    """
    beaten = []
    for preset, other in itertools.product((each for each in ours if each.name in NAMED), ours):
        nearer = [
            f"{error} {getattr(other, error):.4f} for {getattr(preset, error):.4f}"
            for error in ("relmse", "flip")
            if getattr(other, error) <= FRONT_MARGIN * getattr(preset, error)
        ]
        if not nearer or other.cpu_s > FRONT_MARGIN * preset.cpu_s:
            continue
        ratio = cost_ratio(other.name, preset.name)
        if ratio <= FRONT_MARGIN:
            beaten.append(f"{preset.name} is beaten by {other.name} ({ratio:.2f} of its CPU time, {', '.join(nearer)})")
    measured = "; ".join(beaten) or f"{len(ours)} candidates, none cheaper and better by 5 % each"
    return Row(f"{scene}: {', '.join(NAMED)}", "on the measured front of error against CPU time", measured, not beaten)
