"""What was found out about a sweep: trade-off and charts."""

import gzip
import hashlib
import json
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from typing import Annotated, Any, Literal

from fastapi import Query, Request, Response
from pydantic import Field
from sqlite_utils import Database

from joulebox_server import observations
from joulebox_server.analysis import charts
from joulebox_server.analysis.candidates import Candidate, candidates, worth_showing
from joulebox_server.analysis.documents import Point, Tradeoff
from joulebox_server.analysis.drawing import render
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.frame import ScaleName, View, XName, YName
from joulebox_server.analysis.trace import read_trace
from joulebox_server.errors import NotFoundError, UnavailableError
from joulebox_server.kept import Kept
from joulebox_server.problems import told
from joulebox_server.routes.paging import Id, Key
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.base import Document
from joulebox_server.services import Services, ServicesOf, Viewer
from joulebox_server.store import blobs, sweeps, traces

Positive = Annotated[float | None, Query(gt=0, allow_inf_nan=False)]
Confidence = Annotated[float, Query(ge=0.5, le=0.999)]
ChartFormat = Literal["vl.json", "svg", "png"]
MEDIA_TYPES: dict[ChartFormat, str] = {"vl.json": "application/json", "svg": "image/svg+xml", "png": "image/png"}

LONGEST_DRAWING_S = 60.0
"""With those that were asked for before it."""

DRAWN: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {"application/json": {"schema": {"type": "object"}}, "image/svg+xml": {}, "image/png": {}},
        "description": "The chart.",
    },
    **told(404, 409),
}

router = versioned("findings")


@router.get("/sweeps/{sweep}/tradeoff", responses=told(404, 409))
def get_tradeoff(
    services: ServicesOf,
    _: Viewer,
    sweep: Key,
    scene: str | None = None,
    device: str | None = None,
    confidence: Confidence = 0.95,
) -> Tradeoff:
    """Points, intervals, front and limit of one scene on one device; without them, of the first."""
    return services.store.read(observations.tradeoff, sweep, scene, device, confidence)


@router.get("/sweeps/{sweep}/points/{configuration_id}", responses=told(404, 409))
def get_point(
    services: ServicesOf,
    _: Viewer,
    sweep: Key,
    configuration_id: Id,
    scene: str | None = None,
    device: str | None = None,
) -> Point:
    """One point of the trade-off with all its settings, stages and pictures."""
    found = services.store.read(observations.tradeoff, sweep, scene, device, 0.95)
    return _point(found, configuration_id)


def _point(found: Tradeoff, configuration_id: str) -> Point:
    for point in (*found.points, *([found.reference] if found.reference else [])):
        if point.configuration_id == configuration_id:
            return point
    raise NotFoundError(
        f"the configuration {configuration_id!r} has no result on {found.device} for {found.scene}; "
        "the sweep's trade-off lists those that have"
    )


class TradeoffQuery(Document):
    """How the trade-off is looked at; see `frame.View`. `only` is `name:value`, and may repeat."""

    scene: str | None = None
    device: str | None = None
    x: XName | None = None
    y: YName = "difference"
    scale: ScaleName = "auto"
    budget: Positive = None
    limit: Positive = None
    colour_by: str | None = None
    only: list[Annotated[str, Field(pattern=r"^[^:]+:")]] = Field(default_factory=list)
    predicted: bool = False
    width: Annotated[int, Query(ge=200, le=4000)] = 800

    def view(self, found: Tradeoff) -> View:
        """The same, for a trade-off: `x` is energy unless no energy is known."""
        only: dict[str, list[str]] = {}
        for name, _, value in (chosen.partition(":") for chosen in self.only):
            only.setdefault(name, []).append(value)
        x = self.x or found.main_axis
        return View(x, self.y, self.scale, self.budget, self.limit, self.colour_by, only)


@router.get("/sweeps/{sweep}/charts/tradeoff.{form}", response_class=Response, responses=DRAWN)
def tradeoff_chart(
    services: ServicesOf,
    _: Viewer,
    request: Request,
    sweep: Key,
    form: ChartFormat,
    asked: Annotated[TradeoffQuery, Query()],
) -> Response:
    """Cost against difference. The specification's `usermeta` says what the trade-off is."""

    def drawn(found: Tradeoff) -> dict[str, Any]:
        view = asked.view(found)
        predictions: list[Candidate] = []
        if asked.predicted and found.points:
            predictions = worth_showing(*candidates(found, "time_s" if view.x == "time_s" else "energy_j"))
        return charts.tradeoff_chart(found, view, predictions)

    return _answered(services, request, sweep, asked.scene, asked.device, form, asked.width, drawn)


@router.get("/sweeps/{sweep}/charts/stages.{form}", response_class=Response, responses=DRAWN)
def stages_chart(
    services: ServicesOf,
    _: Viewer,
    request: Request,
    sweep: Key,
    form: ChartFormat,
    scene: str | None = None,
    device: str | None = None,
    point: str | None = None,
    width: Annotated[int, Query(ge=200, le=4000)] = 800,
) -> Response:
    """What each stage of each configuration costs; of many those on the front, and `point`."""

    def drawn(found: Tradeoff) -> dict[str, Any]:
        return charts.stages_chart(found, chosen=point)

    return _answered(services, request, sweep, scene, device, form, width, drawn)


@router.get("/sweeps/{sweep}/charts/trace.{form}", response_class=Response, responses=DRAWN)
def trace_chart(
    services: ServicesOf,
    _: Viewer,
    request: Request,
    sweep: Key,
    form: ChartFormat,
    point: str,
    scene: str | None = None,
    device: str | None = None,
    width: Annotated[int, Query(ge=200, le=4000)] = 800,
) -> Response:
    """The discharge trace of a configuration's first repeat that has one: power and windows against time."""

    def drawn(found: Tradeoff) -> dict[str, Any]:
        shown = _point(found, point)
        results = services.store.read(traces.of_configuration, found.sweep_id, found.device, found.scene, point)
        sampled = [result for result in results if result["samples_sha256"]]
        if not sampled:
            raise AnalysisError("this configuration was timed without a meter, so there is no discharge trace of it")
        samples = services.store.read(blobs.find, services.store.blob_dir, sampled[0]["samples_sha256"]).read_bytes()
        return charts.trace_chart(found, shown.label, read_trace(samples, json.loads(sampled[0]["document"])))

    return _answered(services, request, sweep, scene, device, form, width, drawn)


_drawn_before: Kept[bytes] = Kept(64)


def _answered(
    services: Services,
    request: Request,
    sweep: str,
    scene: str | None,
    device: str | None,
    form: ChartFormat,
    width: int,
    drawn: Callable[[Tradeoff], dict[str, Any]],
) -> Response:
    """A chart, drawn anew only when the sweep's results changed, and sent only when the asker has another one."""
    state = services.store.read(_mark, sweep)
    packed = form == "vl.json" and "gzip" in request.headers.get("accept-encoding", "")
    question = (*state, request.url.path, request.url.query, packed)
    tag = f'"{hashlib.sha256(repr(question).encode()).hexdigest()[:32]}"'
    headers = {"Cache-Control": "private, no-cache", "ETag": tag, "Vary": "Accept-Encoding, Authorization"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)

    def body() -> bytes:
        spec = drawn(services.store.read(observations.tradeoff, sweep, scene, device, 0.95))
        if form != "vl.json":
            return _picture(services, spec, form, width)
        text = json.dumps(spec, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
        return gzip.compress(text, 6, mtime=0) if packed else text

    content = _drawn_before.get(question, body)
    if packed:
        headers["Content-Encoding"] = "gzip"
    return Response(content, media_type=MEDIA_TYPES[form], headers=headers)


def _picture(services: Services, spec: dict[str, Any], form: Literal["svg", "png"], width: int) -> bytes:
    """A chart as a picture, drawn elsewhere: Vega holds Python's lock for as long as a second and more."""
    drawing = services.drawing.submit(render, spec, form, width)
    try:
        return drawing.result(LONGEST_DRAWING_S)
    except TimeoutError:
        drawing.cancel()
        raise UnavailableError("too many charts are being drawn; ask again, or for the chart's vl.json") from None
    except BrokenExecutor:
        raise UnavailableError("the process that draws charts ended unexpectedly; ask again") from None


def _mark(db: Database, sweep: str) -> tuple[str, ...]:
    return observations.mark(db, str(sweeps.find(db, sweep)["id"]))
