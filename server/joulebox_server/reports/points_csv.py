"""All points of a report's trade-offs as one table of plain values."""

import csv
import io
from collections.abc import Sequence
from typing import Any

from joulebox_server.analysis.documents import Point, Tradeoff
from joulebox_server.analysis.intervals import Interval


def points_csv(tradeoffs: Sequence[tuple[str, Tradeoff]]) -> bytes:
    """One row a configuration, scene and device of (sweep's name, trade-off), references among them.

    Costs are per image with their intervals; settings follow under `set.NAME`, stages under `stage.NAME_s` and `_j`.
    """
    rows = [
        _row(sweep, tradeoff, point)
        for sweep, tradeoff in tradeoffs
        for point in [*tradeoff.points, *([tradeoff.reference] if tradeoff.reference else [])]
    ]
    columns = dict.fromkeys(name for row in rows for name in row if "." not in name)
    columns |= dict.fromkeys(sorted({name for row in rows for name in row if "." in name}))
    out = io.StringIO()
    writer = csv.DictWriter(out, list(columns) or ["sweep"], restval="", lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue().encode()


def _row(sweep: str, tradeoff: Tradeoff, point: Point) -> dict[str, Any]:
    row: dict[str, Any] = {
        "sweep": sweep,
        "scene": tradeoff.scene,
        "device": tradeoff.device,
        "width_px": tradeoff.width,
        "height_px": tradeoff.height,
        "configuration_id": point.configuration_id,
        "label": point.label,
        "quality": "time_only" if point.energy_j is None else point.quality,
        **_interval("energy", "_j", point.energy_j),
        **_interval("time", "_s", point.time_s),
        **_interval("cpu", "_s", point.cpu_s),
        **_interval("difference", "", point.difference),
        "limit": tradeoff.limit,
        "acceptable": point.acceptable,
        "repeats": point.repeats,
        "on_front_energy": point.on_front.energy_j,
        "on_front_time": point.on_front.time_s,
        "confirmed": point.confirmed,
        "fragile": point.fragile,
        "pixel_sha256": point.pixel_sha256,
    }
    for name, stage in point.stages.items():
        row |= {f"stage.{name}_s": stage.time_s, f"stage.{name}_j": stage.energy_j}
    return row | {f"set.{name}": value for name, value in point.settings.items()}


def _interval(name: str, unit: str, interval: Interval | None) -> dict[str, Any]:
    if interval is None:
        return {f"{name}{unit}": None, f"{name}_low{unit}": None, f"{name}_high{unit}": None}
    return {
        f"{name}{unit}": interval.value,
        f"{name}_low{unit}": interval.low,
        f"{name}_high{unit}": interval.high,
    }
