"""Whether the server lives, whether it can work, and numbers for Prometheus."""

import shutil
import sqlite3
from typing import Any

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from sqlite_utils import Database

from joulebox_server import __version__
from joulebox_server.errors import ServerError, UnavailableError
from joulebox_server.problems import told
from joulebox_server.schemas.answers import Alive, Ready
from joulebox_server.services import ServicesOf, Viewer
from joulebox_server.store.database import number

LEAST_FREE_BYTES = 64 << 20

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def healthz() -> Alive:
    """The process answers."""
    return Alive(status="ok", version=__version__)


@router.get("/readyz", responses=told(503))
def readyz(services: ServicesOf) -> Ready:
    """The database can be written and there is room for pictures; 503 when not."""

    def nothing(db: Database) -> int:
        return number(db, "SELECT 1")

    try:
        services.store.write(nothing)
        free_bytes = shutil.disk_usage(services.store.blob_dir).free
    except (sqlite3.Error, OSError, ServerError) as error:
        raise UnavailableError(f"the data folder cannot be used: {error}") from error
    if free_bytes < LEAST_FREE_BYTES:
        raise UnavailableError(f"only {free_bytes >> 20} MiB are free under the data folder")
    return Ready(status="ok", free_bytes=free_bytes)


@router.get(
    "/metrics",
    response_class=PlainTextResponse,
    responses={200: {"content": {"text/plain": {}}, "description": "Prometheus' text format."}, **told(401, 403, 503)},
)
def metrics(services: ServicesOf, _: Viewer) -> Response:
    """Counts of jobs, devices, results, blobs and requests in Prometheus' text format."""
    content: Any = generate_latest(services.registry)
    return Response(content, media_type=CONTENT_TYPE_LATEST)
