"""Sweeps and their jobs."""

from typing import Annotated, Any

from fastapi import Header, Response
from fastapi.responses import JSONResponse
from sqlite_utils import Database

from joulebox_server.problems import told
from joulebox_server.routes.paging import ETAG, Cursor, Id, IfMatch, Key, Limit, page
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.answers import JobPage, Preview, RetriedSweep, Sweep, SweepPage
from joulebox_server.schemas.base import Document
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.services import Operator, Services, ServicesOf, Viewer
from joulebox_server.store import jobs, planning, sweeps
from joulebox_server.store.database import etag
from joulebox_server.store.sweeps import Action

router = versioned("sweeps")


class ActionRequest(Document):
    """`PATCH /sweeps/{id}`."""

    action: Action


def _shown(services: Services, key: str) -> tuple[str, dict[str, Any]]:
    """The ETag of a sweep, and all that is to be said of it."""

    def whole(db: Database) -> tuple[str, dict[str, Any]]:
        sweep = sweeps.find(db, key)
        more = {
            "definition": sweeps.definition_of(sweep).model_dump(mode="json"),
            "controls": sweeps.controls(db, sweep["id"]),
        }
        return etag(sweep["version"]), sweeps.summary(db, sweep) | more

    return services.store.read(whole)


def _answered(services: Services, response: Response, key: str) -> dict[str, Any]:
    response.headers["ETag"], document = _shown(services, key)
    return document


def _check(services: Services, definition: SweepDefinition) -> None:
    settings = services.settings
    services.store.read(planning.check, definition, settings.max_configurations, settings.max_jobs)


@router.post(
    "/sweeps",
    status_code=201,
    response_model=Sweep,
    responses={200: {"model": Sweep, "description": "This Idempotency-Key made it already."}, **told(409, 413, 507)},
)
def create_sweep(
    services: ServicesOf,
    _: Operator,
    definition: SweepDefinition,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200)] = None,
) -> Response:
    """Make a sweep with all its jobs: 201, or 200 when this Idempotency-Key made it already."""
    _check(services, definition)
    sweep_id, new = services.store.write(planning.create_once, definition, idempotency_key)
    tag, document = _shown(services, sweep_id)
    headers = {"Location": f"/v1/sweeps/{sweep_id}", "ETag": tag}
    return JSONResponse(document, 201 if new else 200, headers)


@router.post("/sweeps:preview", response_model=Preview, responses=told(413))
def preview_sweep(services: ServicesOf, _: Operator, definition: SweepDefinition) -> dict[str, Any]:
    """What a sweep would take; makes nothing."""
    _check(services, definition)
    return services.store.read(planning.preview, definition)


@router.get("/sweeps", response_model=SweepPage)
def list_sweeps(services: ServicesOf, _: Viewer, limit: Limit = 50, cursor: Cursor = None) -> dict[str, Any]:
    """Sweeps, the newest first."""
    return page(services.store.read(sweeps.listed, limit + 1, cursor), limit)


@router.get("/sweeps/{sweep}", response_model=Sweep, responses={200: ETAG, **told(404, 409)})
def get_sweep(services: ServicesOf, _: Viewer, response: Response, sweep: Key) -> dict[str, Any]:
    """One sweep by id, or by name when only one has it."""
    return _answered(services, response, sweep)


@router.get("/sweeps/{sweep}/jobs", response_model=JobPage, responses=told(404, 409))
def list_jobs(services: ServicesOf, _: Viewer, sweep: Key, limit: Limit = 100, cursor: Cursor = None) -> dict[str, Any]:
    """The jobs of a sweep."""

    def found(db: Database) -> list[dict[str, Any]]:
        return jobs.listed(db, str(sweeps.find(db, sweep)["id"]), limit + 1, cursor)

    return page(services.store.read(found), limit)


@router.patch("/sweeps/{sweep}", response_model=Sweep, responses={200: ETAG, **told(404, 409, 412, 507)})
def act(
    services: ServicesOf, _: Operator, response: Response, sweep: Key, request: ActionRequest, if_match: IfMatch = None
) -> dict[str, Any]:
    """Pause, resume or cancel. Jobs being measured are finished in any case."""
    return _answered(services, response, services.store.write(sweeps.act, sweep, request.action, if_match))


@router.delete("/sweeps/{sweep}", status_code=204, responses=told(404, 409, 507))
def delete_sweep(services: ServicesOf, _: Operator, sweep: Key) -> Response:
    """Remove a sweep with its results and the blobs that only it used."""
    services.store.write(sweeps.delete, services.store.blob_dir, sweep)
    return Response(status_code=204)


@router.post("/sweeps/{sweep}:retry-failed", response_model=RetriedSweep, responses={200: ETAG, **told(404, 409, 507)})
def retry_failed(services: ServicesOf, _: Operator, response: Response, sweep: Key) -> dict[str, Any]:
    """Queue every failed job of a sweep again, and no others."""
    sweep_id, count = services.store.write(sweeps.retry_failed, sweep)
    return _answered(services, response, sweep_id) | {"retried": count}


@router.post("/jobs/{job}:retry", response_model=Sweep, responses={200: ETAG, **told(404, 409, 507)})
def retry_job(services: ServicesOf, _: Operator, response: Response, job: Id) -> dict[str, Any]:
    """Queue one failed job again."""
    return _answered(services, response, services.store.write(jobs.retry, job))
