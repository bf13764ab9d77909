"""Exported results: a page of JSON, or all of them as lines of JSON, CSV or a Parquet file."""

import csv
import io
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from fastapi import Response
from fastapi.responses import FileResponse, JSONResponse, StreamingResponse
from sqlite_utils import Database
from starlette.background import BackgroundTask

from joulebox_server.parquet import write_parquet
from joulebox_server.problems import told
from joulebox_server.routes.paging import Cursor, Key, Limit, page
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.answers import ResultPage
from joulebox_server.services import Services, ServicesOf, Viewer
from joulebox_server.store import results, sweeps
from joulebox_server.store.blobs import disk

Row = dict[str, Any]
BINARY = {"schema": {"type": "string", "format": "binary"}}
FORMATS: dict[int | str, dict[str, Any]] = {
    200: {
        "model": ResultPage,
        "content": {
            "application/x-ndjson": {"schema": {"type": "string"}},
            "text/csv": {"schema": {"type": "string"}},
            "application/vnd.apache.parquet": BINARY,
        },
        "description": "Results, the oldest first.",
    }
}

router = versioned("results")


@router.get("/results", response_model=ResultPage, responses={**FORMATS, **told(404, 409, 507)})
def list_results(
    services: ServicesOf,
    _: Viewer,
    sweep: str | None = None,
    format: Literal["json", "ndjson", "csv", "parquet"] = "json",  # noqa: A002 (the name of the query parameter)
    limit: Limit = 100,
    cursor: Cursor = None,
) -> Response:
    """Results as flat rows: a page of JSON, or all of them as lines of JSON, CSV or Parquet."""

    def first(db: Database) -> tuple[str | None, list[Row]]:
        sweep_id = None if sweep is None else str(sweeps.find(db, sweep)["id"])
        count = limit + 1 if format == "json" else results.BATCH
        return sweep_id, results.exported(db, sweep_id, count, cursor)

    sweep_id, batch = services.store.read(first)
    if format == "json":
        return JSONResponse(page(batch, limit))
    batches = _batches(services, sweep_id, batch)
    headers = {"Content-Disposition": f'attachment; filename="results.{format}"'}
    if format == "parquet":
        return _parquet_file(services.store.incoming_dir, batches, headers)
    lines = _csv_lines(batches) if format == "csv" else _json_lines(batches)
    media_type = "text/csv; charset=utf-8" if format == "csv" else "application/x-ndjson"
    return StreamingResponse(lines, media_type=media_type, headers=headers)


@router.get(
    "/sweeps/{sweep}/measurements",
    response_class=StreamingResponse,
    responses={200: {"content": {"application/x-ndjson": {"schema": {"type": "string"}}}}, **told(404, 409)},
)
def list_measurements(services: ServicesOf, _: Viewer, sweep: Key) -> Response:
    """Every result of a sweep that was not voided, as lines of JSON: its job, its difference, its whole document."""

    def first(db: Database) -> tuple[str, list[Row]]:
        sweep_id = str(sweeps.find(db, sweep)["id"])
        return sweep_id, results.measurements(db, sweep_id, None)

    def batches() -> Iterator[list[Row]]:
        sweep_id, batch = found
        while batch:
            yield batch
            batch = services.store.read(results.measurements, sweep_id, batch[-1]["id"])

    found = services.store.read(first)
    return StreamingResponse(_json_lines(batches()), media_type="application/x-ndjson")


def _batches(services: Services, sweep_id: str | None, batch: list[Row]) -> Iterator[list[Row]]:
    # A batch a read, so that a slow reader holds no snapshot of the database open.
    while batch:
        yield batch
        batch = services.store.read(results.exported, sweep_id, results.BATCH, batch[-1]["id"])


def _json_lines(batches: Iterator[list[Row]]) -> Iterator[str]:
    for batch in batches:
        yield "".join(json.dumps(result) + "\n" for result in batch)


def _csv_lines(batches: Iterator[list[Row]]) -> Iterator[str]:
    out = io.StringIO()
    writer = csv.DictWriter(out, results.COLUMNS, lineterminator="\r\n")
    writer.writeheader()
    for batch in batches:
        writer.writerows(batch)
        yield out.getvalue()
        out.seek(0)
        out.truncate()
    yield out.getvalue()


def _parquet_file(folder: Path, batches: Iterator[list[Row]], headers: dict[str, str]) -> Response:
    """Written to a file first, because the index of a Parquet file stands at its end."""
    with disk():
        handle, name = tempfile.mkstemp(dir=folder, suffix=".parquet")
        os.close(handle)
        try:
            write_parquet(batches, Path(name))
        except BaseException:
            os.unlink(name)
            raise
    media_type = "application/vnd.apache.parquet"
    return FileResponse(name, media_type=media_type, headers=headers, background=BackgroundTask(os.unlink, name))
