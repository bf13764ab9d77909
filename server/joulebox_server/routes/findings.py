"""What was found out about a sweep: trade-off and charts."""

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse

from joulebox_server import observations
from joulebox_server.analysis import charts
from joulebox_server.analysis.documents import Tradeoff
from joulebox_server.analysis.frame import ScaleName, XName, YName
from joulebox_server.problems import told
from joulebox_server.routes.paging import Key
from joulebox_server.services import ServicesOf, Viewer

Positive = Annotated[float | None, Query(gt=0, allow_inf_nan=False)]
Confidence = Annotated[float, Query(ge=0.5, le=0.999)]
ChartFormat = Literal["vl.json", "svg", "png"]

DRAWN: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {"application/json": {"schema": {"type": "object"}}, "image/svg+xml": {}, "image/png": {}},
        "description": "The chart.",
    },
    **told(404, 409),
}

router = APIRouter(tags=["findings"])


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


@router.get("/sweeps/{sweep}/charts/tradeoff.{form}", response_class=Response, responses=DRAWN)
def tradeoff_chart(
    services: ServicesOf,
    _: Viewer,
    sweep: Key,
    form: ChartFormat,
    scene: str | None = None,
    device: str | None = None,
    x: XName | None = None,
    y: YName = "difference",
    scale: ScaleName = "auto",
    budget: Positive = None,
    width: Annotated[int, Query(ge=200, le=4000)] = 800,
) -> Response:
    """Cost against difference; `x` is energy unless no energy is known."""
    found = services.store.read(observations.tradeoff, sweep, scene, device, 0.95)
    spec = charts.tradeoff_chart(found, x=x or found.main_axis, y=y, scale=scale, budget=budget)
    return _drawn(spec, form, width)


@router.get("/sweeps/{sweep}/charts/stages.{form}", response_class=Response, responses=DRAWN)
def stages_chart(
    services: ServicesOf,
    _: Viewer,
    sweep: Key,
    form: ChartFormat,
    scene: str | None = None,
    device: str | None = None,
    width: Annotated[int, Query(ge=200, le=4000)] = 800,
) -> Response:
    """What each stage of each configuration costs."""
    found = services.store.read(observations.tradeoff, sweep, scene, device, 0.95)
    return _drawn(charts.stages_chart(found), form, width)


def _drawn(spec: dict[str, Any], form: ChartFormat, width: int) -> Response:
    headers = {"Cache-Control": "no-store"}
    if form == "vl.json":
        return JSONResponse(spec, headers=headers)
    media_type = "image/svg+xml" if form == "svg" else "image/png"
    return Response(charts.render(spec, form, width), media_type=media_type, headers=headers)
