"""The part of a report that sets devices side by side, scene by scene."""

import math
from collections.abc import Sequence

from joulebox_server.analysis.device_charts import devices_chart, shared_axis
from joulebox_server.analysis.documents import UNITS, Axis, Point, Tradeoff
from joulebox_server.analysis.frame import spread
from joulebox_server.analysis.words import figure
from joulebox_server.reports.document import Block, Chart, Section, Table, Words
from joulebox_server.reports.gathering import View
from joulebox_server.reports.wording import count_of, listed, quality_label


def comparable(views: Sequence[View]) -> dict[str, list[View]]:
    """Views by scene, of scenes that two devices or more have measured and compared, at one picture size."""
    scenes: dict[tuple[str, int, int], list[View]] = {}
    for view in views:
        tradeoff = view.tradeoff
        if any(point.difference is not None for point in tradeoff.points):
            scenes.setdefault((tradeoff.scene, tradeoff.width, tradeoff.height), []).append(view)
    sized = {key: found for key, found in scenes.items() if len({v.tradeoff.device for v in found}) > 1}
    several = len({scene for scene, _, _ in sized}) < len(sized)
    return {f"{scene} at {w} x {h}" if several else scene: found for (scene, w, h), found in sized.items()}


def comparison_section(label: str, views: Sequence[View], name: str) -> Section:
    """One scene on several devices: their trade-offs in one chart, and what each costs beside the first."""
    tradeoffs = [view.tradeoff for view in views]
    axis = shared_axis(tradeoffs)
    qualities = {quality_label(tradeoff.energy_quality) for tradeoff in tradeoffs}
    blocks: list[Block] = []
    if axis == "time_s" and any(tradeoff.main_axis == "energy_j" for tradeoff in tradeoffs):
        blocks.append(Words("Not every device knows its joules, so times are compared.", "notice"))
    elif len(qualities) > 1:
        told = listed(sorted(qualities))
        blocks.append(Words(f"These are {told}: they do not compare in size, only each within itself.", "notice"))
    caption = (
        "Each colour is one device; the lines join its front. The same configuration has the same difference on every "
        "device as far as the pictures agree, so a device that costs less lies further left at the same height."
    )
    alt = f"Trade-off of {label} on {listed([tradeoff.device for tradeoff in tradeoffs])} in one chart."
    blocks.append(Chart(name, devices_chart(tradeoffs, axis), caption, alt))
    blocks.append(_beside_first(views, axis))
    return Section(f"{label}: devices side by side", name, blocks, label=listed(sorted(qualities)))


def _beside_first(views: Sequence[View], axis: Axis) -> Table:
    first = views[0].tradeoff
    rows = [_row(view, first, axis) for view in views]
    columns = (
        "device",
        "basis",
        "reference costs",
        "recommended",
        "it costs",
        f"cost beside {first.device}",
        "pictures that agree to the bit",
    )
    return Table(columns, rows, "Costs are per image.")


def _row(view: View, first: Tradeoff, axis: Axis) -> tuple[str, ...]:
    tradeoff, found = view.tradeoff, view.recommendation
    unit = UNITS[axis]
    reference = tradeoff.reference.cost(axis) if tradeoff.reference else None
    answer = found if found and found.answer == "settings" else None
    cost = (answer.energy_j if axis == "energy_j" else answer.time_s) if answer else None
    pairs = _pairs(tradeoff, first)
    same = sum(mine.pixel_sha256 == theirs.pixel_sha256 for mine, theirs in pairs)
    return (
        tradeoff.device,
        quality_label(tradeoff.energy_quality),
        spread(reference, unit),
        (answer.label if answer else None) or "none fits",
        spread(cost, unit) if cost else "",
        _ratio(pairs, axis),
        f"{same} of {count_of(len(pairs), 'configuration')}" if pairs else "none in common",
    )


def _pairs(own: Tradeoff, first: Tradeoff) -> list[tuple[Point, Point]]:
    """The configurations that both have run: this device's point, the first one's."""
    theirs = {point.configuration_id: point for point in first.points}
    return [(point, theirs[point.configuration_id]) for point in own.points if point.configuration_id in theirs]


def _ratio(pairs: Sequence[tuple[Point, Point]], axis: Axis) -> str:
    """Geometric mean of this device's costs over the first one's, with the range, over what both have run."""
    costs = [(mine.cost(axis), theirs.cost(axis)) for mine, theirs in pairs]
    ratios = [mine.value / theirs.value for mine, theirs in costs if mine and theirs and theirs.value > 0]
    if not ratios or min(ratios) <= 0:
        return "unknown"
    mean = math.exp(math.fsum(map(math.log, ratios)) / len(ratios))
    return f"{figure(mean)} ({figure(min(ratios))} to {figure(max(ratios))})"
