"""What was found out about a sweep: trade-off, charts, exported results."""

import csv
import io
import json
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse, StreamingResponse
from sqlite_utils import Database

from joulebox_server import observations
from joulebox_server.analysis import charts
from joulebox_server.analysis.documents import Tradeoff
from joulebox_server.analysis.frame import ScaleName, XName, YName
from joulebox_server.routes.paging import Cursor, Limit, page
from joulebox_server.services import ServicesOf, Viewer
from joulebox_server.store import results, sweeps

Positive = Annotated[float | None, Query(gt=0, allow_inf_nan=False)]
Confidence = Annotated[float, Query(ge=0.5, le=0.999)]
ChartFormat = Literal["vl.json", "svg", "png"]

router = APIRouter(tags=["findings"])


@router.get("/sweeps/{sweep}/tradeoff")
def get_tradeoff(
    services: ServicesOf,
    _: Viewer,
    sweep: str,
    scene: str | None = None,
    device: str | None = None,
    confidence: Confidence = 0.95,
) -> Tradeoff:
    """Points, intervals, front and limit of one scene on one device; without them, of the first."""
    return services.store.read(observations.tradeoff, sweep, scene, device, confidence)


@router.get("/sweeps/{sweep}/charts/tradeoff.{form}")
def tradeoff_chart(
    services: ServicesOf,
    _: Viewer,
    sweep: str,
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


@router.get("/sweeps/{sweep}/charts/stages.{form}")
def stages_chart(
    services: ServicesOf,
    _: Viewer,
    sweep: str,
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


@router.get("/results")
def list_results(
    services: ServicesOf,
    _: Viewer,
    sweep: str | None = None,
    format: Literal["json", "ndjson", "csv"] = "json",  # noqa: A002 (the name of the query parameter)
    limit: Limit = 100,
    cursor: Cursor = None,
) -> Response:
    """Results as flat rows: a page of JSON, or all of them as lines of JSON or CSV."""

    def first(db: Database) -> tuple[str | None, list[dict[str, Any]]]:
        sweep_id = None if sweep is None else str(sweeps.find(db, sweep)["id"])
        count = limit + 1 if format == "json" else results.BATCH
        return sweep_id, results.exported(db, sweep_id, count, cursor)

    sweep_id, batch = services.store.read(first)
    if format == "json":
        return JSONResponse(page(batch, limit))
    lines = _csv_lines if format == "csv" else _json_lines
    media_type = "text/csv; charset=utf-8" if format == "csv" else "application/x-ndjson"
    headers = {"Content-Disposition": f'attachment; filename="results.{format}"'}
    return StreamingResponse(lines(_following(services, sweep_id, batch)), media_type=media_type, headers=headers)


def _following(services: ServicesOf, sweep_id: str | None, batch: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    # A batch a read, so that a slow reader holds no snapshot of the database open.
    while batch:
        yield from batch
        batch = services.store.read(results.exported, sweep_id, results.BATCH, batch[-1]["id"])


def _json_lines(found: Iterator[dict[str, Any]]) -> Iterator[str]:
    for result in found:
        yield json.dumps(result) + "\n"


def _csv_lines(found: Iterator[dict[str, Any]]) -> Iterator[str]:
    out = io.StringIO()
    writer = csv.DictWriter(out, results.COLUMNS, lineterminator="\r\n")
    writer.writeheader()
    for result in found:
        writer.writerow(result)
        yield out.getvalue()
        out.seek(0)
        out.truncate()
    yield out.getvalue()
