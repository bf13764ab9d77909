"""What the stages of a recommendation earn: what the scene leaves out, and what was not worth its joules."""

from collections.abc import Sequence

from joulebox_server.analysis.candidates import Candidate
from joulebox_server.analysis.documents import UNITS, Axis, Point
from joulebox_server.analysis.lines import NO_SETTINGS
from joulebox_server.analysis.words import figure, setting, share

MAX_STAGES = 3
"""Most stages of a kind that are told of."""


def stage_reasons(chosen: Candidate, measured: Sequence[Candidate], axis: Axis) -> list[str]:
    """Sentences on stages that the scene has no use for, and on stages that the chosen settings do without.

    A stage that no measured configuration runs is one that the scene does not need, or that the sweep never
    asked for: the renderer's own reason is given. Of a stage that others run, the one among them that is most
    like the chosen tells what it would cost and change.
    """
    if chosen.point is None:
        return []
    others = [candidate for candidate in measured if candidate.point is not None]
    never, unworthy = [], []
    for stage, why in chosen.point.left_out.items():
        running = [c for c in others if c.point and c.point.left_out and stage not in c.point.left_out]
        if running:
            unworthy.append(_not_worth(stage, chosen, _most_alike(chosen, running), UNITS[axis]))
        else:
            never.append(f"{stage} ({why})")
    told = [f"No configuration runs {', '.join(never)}."] if never else []
    return told + unworthy[:MAX_STAGES] + _largest(chosen.point, axis)


def _most_alike(chosen: Candidate, running: Sequence[Candidate]) -> Candidate:
    """The one that fewest settings tell from the chosen; of several the one with the smallest difference."""
    return min(running, key=lambda other: (len(_apart(chosen, other)), other.difference.value, other.key))


def _not_worth(stage: str, chosen: Candidate, other: Candidate, unit: str) -> str:
    with_it = ", ".join(f"{name} {setting(other.settings.get(name))}" for name in _apart(chosen, other))
    more = other.cost.value - chosen.cost.value
    cost = f"{figure(abs(more))} {unit} ({share(abs(more) / chosen.cost.value)}) {'more' if more >= 0 else 'less'}"
    change = f"{figure(chosen.difference.value)} to {figure(other.difference.value)}"
    return (
        f"{stage} was not worth its cost here: with it ({with_it}) an image costs {cost}, "
        f"and the difference goes from {change}."
    )


def _apart(one: Candidate, other: Candidate) -> list[str]:
    names = dict.fromkeys([*one.settings, *other.settings])
    return [n for n in names if n not in NO_SETTINGS and one.settings.get(n) != other.settings.get(n)]


def _largest(point: Point, axis: Axis) -> list[str]:
    """Where the cost goes."""
    costs = {name: stage.energy_j if axis == "energy_j" else stage.time_s for name, stage in point.stages.items()}
    known = {name: cost for name, cost in costs.items() if cost is not None and cost > 0}
    total = point.cost(axis)
    if not known or total is None or total.value <= 0:
        return []
    name = max(known, key=lambda stage: known[stage])
    what = "energy" if axis == "energy_j" else "time"
    return [f"The largest part of its {what}, {share(known[name] / total.value)}, goes to {name}."]
