"""What a report of a sweep needs, asked of a server."""

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from joulebox_server.analysis.documents import Point, Recommendation, Tradeoff
from joulebox_server.errors import InvalidError, NotFoundError

Ask = Callable[[str, Mapping[str, Any]], bytes]
"""GET below /v1 of a server with query parameters: the answer's bytes. Raises ServerError for a bad answer."""
Step = Callable[[str], None]
"""Told what is being asked for."""

PAGE_JOBS = 200
PICTURE_WIDTH = 512
"""Pictures in a report are averaged down to this width [px]."""


@dataclass(frozen=True)
class Asked:
    """What a report is to tell: of which scenes and devices (none: all), and the budget and limit of its answer."""

    scenes: Sequence[str] = ()
    devices: Sequence[str] = ()
    budget_j: float | None = None
    budget_s: float | None = None
    difference_limit: float | None = None


@dataclass(frozen=True)
class Compared:
    """A point's picture and its error map; None for what is not stored any more."""

    point: Point
    picture: bytes | None
    delta: bytes | None


@dataclass(frozen=True)
class View:
    """One scene on one device.

    recommendation  None where nothing can be recommended; then `unanswered` says why
    pictures        by what they are: "recommended", "best", "worst"
    """

    sweep: str
    tradeoff: Tradeoff
    recommendation: Recommendation | None = None
    unanswered: str = ""
    reference: bytes | None = None
    pictures: Mapping[str, Compared] = field(default_factory=dict)


@dataclass(frozen=True)
class Findings:
    """A sweep with all that was found out about it.

    document    of `GET /v1/sweeps/ID`
    failures    (scene, purpose, reason) of every failed job
    results_csv the export of its results
    """

    document: Mapping[str, Any]
    failures: Sequence[tuple[str, str, str]]
    results_csv: bytes
    views: Sequence[View]

    def methods(self) -> dict[str, str]:
        """How each device's energies came about: its methods with their quality. Noise floors are never metered."""
        found: dict[str, dict[str, None]] = {}
        for row in csv.DictReader(io.StringIO(self.results_csv.decode())):
            if row["purpose"] == "noise_floor":
                continue
            told = "time only" if row["quality"] == "none" else f"{row['method']} ({row['quality']})"
            found.setdefault(row["device"], {})[told] = None
        return {device: ", ".join(told) for device, told in found.items()}


def gather(ask: Ask, sweep: str, asked: Asked, step: Step = lambda _: None) -> Findings:
    """Everything a report tells of a sweep. Raises ServerError: a scene or device that is not there, no server."""
    document = json.loads(ask(f"/sweeps/{sweep}", {}))
    sweep_id, name = document["id"], document["name"]
    failures = [
        (job["scene"], job["purpose"], job["reason"] or "no reason was given")
        for job in _jobs(ask, sweep_id)
        if job["state"] == "failed"
    ]
    views = []
    for scene in asked.scenes or document["scenes"]:
        for device in asked.devices or document["devices"] or [None]:
            step(f"{scene} on {device or 'no device yet'}")
            views.append(_view(ask, sweep_id, name, scene, device, asked))
    results_csv = ask("/results", {"format": "csv", "sweep": sweep_id})
    return Findings(document, failures, results_csv, views)


def _jobs(ask: Ask, sweep_id: str) -> Iterator[dict[str, Any]]:
    cursor: dict[str, str] = {}
    while True:
        page = json.loads(ask(f"/sweeps/{sweep_id}/jobs", {"limit": PAGE_JOBS, **cursor}))
        yield from page["items"]
        if page["next"] is None:
            return
        cursor = {"cursor": page["next"]}


def _view(ask: Ask, sweep_id: str, name: str, scene: str, device: str | None, asked: Asked) -> View:
    of = {"scene": scene, **({} if device is None else {"device": device})}
    tradeoff = Tradeoff.model_validate_json(ask(f"/sweeps/{sweep_id}/tradeoff", of))
    compared = [point for point in tradeoff.points if point.difference is not None]
    if not compared:
        return View(name, tradeoff, unanswered="No configuration has been both measured and compared yet.")
    wanted = {"budget_j": asked.budget_j, "budget_s": asked.budget_s, "difference_limit": asked.difference_limit}
    given = {key: value for key, value in wanted.items() if value is not None}
    answer, unanswered = None, ""
    try:
        answer = Recommendation.model_validate_json(ask(f"/sweeps/{sweep_id}/recommendation", of | given))
    except InvalidError as error:  # a budget in joules, and none are known here: the other views have an answer
        unanswered = str(error)
    chosen = answer.configuration_id if answer else None
    pictures = _pictures(ask, tradeoff, compared, chosen)
    return View(name, tradeoff, answer, unanswered, _reference(ask, tradeoff), pictures)


def _pictures(ask: Ask, tradeoff: Tradeoff, compared: Sequence[Point], recommended: str | None) -> dict[str, Compared]:
    """The recommended point and those that differ least and most, each once."""
    ordered = sorted(compared, key=lambda point: point.difference.value if point.difference else 0.0)
    roles = {"best": ordered[0], "worst": ordered[-1]}
    chosen = [point for point in compared if point.configuration_id == recommended]
    if chosen:
        roles = {"recommended": chosen[0], **roles}
    seen: dict[str, str] = {}
    for role, point in roles.items():
        seen.setdefault(point.configuration_id, role)
    return {role: _compared(ask, tradeoff, roles[role]) for role in seen.values()}


def _compared(ask: Ask, tradeoff: Tradeoff, point: Point) -> Compared:
    picture = _png(ask, point.image_sha256, tradeoff.exposure)
    delta = None
    if picture and point.reference_image_sha256:
        pair = {"reference": point.reference_image_sha256, "test": point.image_sha256, "exposure": tradeoff.exposure}
        try:
            found = json.loads(ask("/compare", pair))
            delta = _png(ask, found["delta_sha256"], 1.0)
        except (InvalidError, NotFoundError):  # one of the two is gone, and with it what could be compared
            delta = None
    return Compared(point, picture, delta)


def _reference(ask: Ask, tradeoff: Tradeoff) -> bytes | None:
    shas = [point.reference_image_sha256 for point in tradeoff.points if point.reference_image_sha256]
    return _png(ask, shas[0], tradeoff.exposure) if shas else None


def _png(ask: Ask, sha256: str | None, exposure: float) -> bytes | None:
    if sha256 is None:
        return None
    try:
        return ask(f"/images/{sha256}.png", {"exposure": exposure, "width": PICTURE_WIDTH})
    except NotFoundError:
        return None
