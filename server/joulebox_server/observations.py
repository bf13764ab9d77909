"""From stored results to the analysis: a sweep's trade-off for one scene and device."""

import json
from typing import Any

from sqlite_utils import Database

from joulebox_server.analysis.documents import StageCost, Tradeoff
from joulebox_server.analysis.intervals import Interval
from joulebox_server.analysis.points import Observation, Subject
from joulebox_server.analysis.tradeoff import build_tradeoff
from joulebox_server.errors import NotFoundError
from joulebox_server.kept import Kept
from joulebox_server.schemas.measure import MeasureDocument
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.store import results, sweeps
from joulebox_server.store.database import Row, row
from joulebox_server.sweeps.expansion import axis_names

NOMINAL_SIDE = 256
"""The size that limits are stated for; stands in until a first picture tells the sweep's own."""
OPINIONS = ("flip_mean", "ssim", "rmse_srgb", "relmse")

_kept: Kept[Tradeoff] = Kept(8)
"""Thousands of results take seconds to read, and every view of a sweep asks for the same ones."""


def tradeoff(db: Database, sweep_key: str, scene: str | None, device: str | None, confidence: float) -> Tradeoff:
    """The trade-off as measured so far; without a scene or device, of the sweep's first.

    Raises NotFoundError for a sweep, scene or device that is not there, AnalysisError for a confidence out of
    range.
    """
    sweep = sweeps.find(db, sweep_key)
    question = (mark(db, sweep["id"]), scene, device, confidence)
    return _kept.get(question, lambda: _tradeoff(db, sweep, scene, device, confidence))


def mark(db: Database, sweep_id: str) -> tuple[str, ...]:
    """Names the state of a sweep's results: another whenever its trade-off may be another.

    Results are only ever added, and a comparison changes when it is done or asked for anew.
    """
    found = row(
        db,
        """SELECT (SELECT count(*) || ' ' || coalesce(max(id), '') FROM result WHERE sweep_id = ?) AS results,
        (SELECT count(*) || ' ' || coalesce(sum(d.state = 'done'), 0) || ' ' || coalesce(max(d.id), '')
            FROM comparison JOIN image_difference AS d ON d.id = difference_id WHERE sweep_id = ?) AS compared,
        (SELECT group_concat(coalesce(device_id, '')) FROM target WHERE sweep_id = ?) AS devices""",
        (sweep_id, sweep_id, sweep_id),
    )
    assert found is not None, "a SELECT without FROM has one row"
    return (sweep_id, *(str(found[part]) for part in ("results", "compared", "devices")))


def _tradeoff(db: Database, sweep: Row, scene: str | None, device: str | None, confidence: float) -> Tradeoff:
    definition = sweeps.definition_of(sweep)
    label = _scene(db, sweep, definition, scene)
    devices = sweeps.target_devices(db, sweep["id"])
    chosen = _device(sweep, devices, device)
    found = [] if chosen is None else results.of_target(db, sweep["id"], chosen["id"], label)
    observed = {purpose: _observations(found, purpose) for purpose in ("measure", "reference")}
    floor = [float(r["difference"]) for r in found if r["purpose"] == "noise_floor" and r["difference"] is not None]
    width, height = _size(definition, found)
    subject = Subject(
        sweep_id=sweep["id"],
        scene=label,
        device="" if chosen is None else str(chosen["name"]),
        width=width,
        height=height,
        scenes=sweeps.scene_labels(db, sweep["id"]),
        devices=[str(known["name"]) for known in devices],
        axes=axis_names(definition),
        exposure=definition.picture_exposure,
        seed_policy=definition.reference.seed_policy,
        limit_at_256=definition.limit,
    )
    return build_tradeoff(subject, observed["measure"], observed["reference"], floor[-1] if floor else None, confidence)


def others(db: Database, sweep_key: str, scene: str, device: str, confidence: float) -> list[Tradeoff]:
    """The trade-offs of a sweep's other devices for one scene."""
    names = [str(known["name"]) for known in sweeps.target_devices(db, sweeps.find(db, sweep_key)["id"])]
    return [tradeoff(db, sweep_key, scene, name, confidence) for name in names if name != device]


def battery_full_j(db: Database, device: str) -> float | None:
    """What a full battery of a device holds [J], as the newest of its results that tells it."""
    for document in results.newest_documents(db, device):
        conditions: dict[str, Any] = json.loads(document).get("conditions") or {}
        for told in (conditions.get("after"), conditions.get("before")):
            full_j = told.get("battery_full_j") if isinstance(told, dict) else None
            if isinstance(full_j, int | float) and full_j > 0:
                return float(full_j)
    return None


def _scene(db: Database, sweep: Row, definition: SweepDefinition, wanted: str | None) -> str:
    labels = sweeps.scene_labels(db, sweep["id"])
    if wanted is None:
        return labels[0]
    named = [entry.label for entry in definition.scenes if wanted in (entry.label, entry.name)]
    if wanted in labels:
        return wanted
    if len(named) != 1:
        raise NotFoundError(f"the sweep {sweep['name']!r} has no scene {wanted!r}; it has {', '.join(labels)}")
    return named[0]


def _device(sweep: Row, devices: list[Row], wanted: str | None) -> Row | None:
    if wanted is None:
        return devices[0] if devices else None
    for device in devices:
        if wanted in (device["id"], device["name"]):
            return device
    known = ", ".join(str(device["name"]) for device in devices)
    raise NotFoundError(
        f"the sweep {sweep['name']!r} has no device {wanted!r}; "
        + (f"it has {known}" if known else "none has taken a job yet")
    )


def _size(definition: SweepDefinition, found: list[Row]) -> tuple[int, int]:
    """Width and height in pixels: of the reference, else of any picture, else as the sweep asks."""
    ordered = sorted(found, key=lambda result: bool(result["purpose"] != "reference"))
    known: list[dict[str, Any]] = [json.loads(result["document"])["settings"] for result in ordered[:1]]
    for settings in [*known, definition.settings]:
        width, height = settings.get("width"), settings.get("height")
        if isinstance(width, int) and isinstance(height, int) and width > 0 and height > 0:
            return width, height
    return NOMINAL_SIDE, NOMINAL_SIDE


def _observations(found: list[Row], purpose: str) -> list[Observation]:
    return [_observation(result) for result in found if result["purpose"] == purpose]


def _observation(result: Row) -> Observation:
    document = MeasureDocument.model_validate_json(result["document"])
    assert document.time_s_per_image is not None
    assert document.cpu_s_per_image is not None
    gross = document.energy_j_per_image.gross
    outcome = json.loads(result["outcome"]) if result["outcome"] else None
    return Observation(
        configuration_id=result["configuration_id"],
        settings=document.settings,
        repeat=result["repeat"],
        seed=result["seed"],
        time_s=_interval(document.time_s_per_image),
        cpu_s=_interval(document.cpu_s_per_image),
        energy_j=None if gross is None else _interval(gross),
        quality=document.quality,
        windows=document.windows,
        difference=result["difference"],
        confidence=document.confidence,
        image_sha256=document.image_blob,
        reference_image_sha256=result["reference_sha256"],
        pixel_sha256=document.pixel_sha256,
        stages={
            name: StageCost(time_s=stage.time_s, energy_j=stage.energy_j.equation_2)
            for name, stage in document.stages.items()
        },
        left_out=_left_out(document),
        opinions=outcome and {name: outcome[name] for name in OPINIONS},
    )


def _left_out(document: MeasureDocument) -> dict[str, str]:
    """The reasons that the renderer's plan gives; none from a renderer that tells none."""
    told = (document.plan or {}).get("left_out")
    return {str(name): str(why) for name, why in told.items()} if isinstance(told, dict) else {}


def _interval(given: Any) -> Interval:
    return Interval(value=given.value, low=given.low, high=given.high)
