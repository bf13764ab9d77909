"""Sweeps and their jobs."""

from typing import Annotated, Any

from fastapi import APIRouter, Header, Response
from fastapi.responses import JSONResponse
from sqlite_utils import Database

from joulebox_server.routes.paging import Cursor, Limit, page
from joulebox_server.schemas.base import Document
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.services import Operator, Services, ServicesOf, Viewer
from joulebox_server.store import jobs, planning, sweeps
from joulebox_server.store.sweeps import Action

router = APIRouter(tags=["sweeps"])


class ActionRequest(Document):
    """`PATCH /sweeps/{id}`."""

    action: Action


def _shown(services: Services, key: str) -> dict[str, Any]:
    def whole(db: Database) -> dict[str, Any]:
        sweep = sweeps.find(db, key)
        definition = sweeps.definition_of(sweep).model_dump(mode="json")
        return {**sweeps.summary(db, sweep), "definition": definition}

    return services.store.read(whole)


def _check(services: Services, definition: SweepDefinition) -> None:
    settings = services.settings
    services.store.read(planning.check, definition, settings.max_configurations, settings.max_jobs)


@router.post("/sweeps", status_code=201)
def create_sweep(
    services: ServicesOf,
    _: Operator,
    definition: SweepDefinition,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200)] = None,
) -> Response:
    """Make a sweep with all its jobs: 201, or 200 when this Idempotency-Key made it already."""
    _check(services, definition)
    sweep_id, new = services.store.write(planning.create_once, definition, idempotency_key)
    headers = {"Location": f"/v1/sweeps/{sweep_id}"}
    return JSONResponse(_shown(services, sweep_id), 201 if new else 200, headers)


@router.post("/sweeps:preview")
def preview_sweep(services: ServicesOf, _: Operator, definition: SweepDefinition) -> dict[str, Any]:
    """What a sweep would take; makes nothing."""
    _check(services, definition)
    return services.store.read(planning.preview, definition)


@router.get("/sweeps")
def list_sweeps(services: ServicesOf, _: Viewer, limit: Limit = 50, cursor: Cursor = None) -> dict[str, Any]:
    """Sweeps, the newest first."""
    return page(services.store.read(sweeps.listed, limit + 1, cursor), limit)


@router.get("/sweeps/{sweep}")
def get_sweep(services: ServicesOf, _: Viewer, sweep: str) -> dict[str, Any]:
    """One sweep by id, or by name when only one has it."""
    return _shown(services, sweep)


@router.get("/sweeps/{sweep}/jobs")
def list_jobs(services: ServicesOf, _: Viewer, sweep: str, limit: Limit = 100, cursor: Cursor = None) -> dict[str, Any]:
    """The jobs of a sweep."""

    def found(db: Database) -> list[dict[str, Any]]:
        return jobs.listed(db, str(sweeps.find(db, sweep)["id"]), limit + 1, cursor)

    return page(services.store.read(found), limit)


@router.patch("/sweeps/{sweep}")
def act(services: ServicesOf, _: Operator, sweep: str, request: ActionRequest) -> dict[str, Any]:
    """Pause, resume or cancel. Jobs being measured are finished in any case."""
    return _shown(services, services.store.write(sweeps.act, sweep, request.action))


@router.delete("/sweeps/{sweep}", status_code=204)
def delete_sweep(services: ServicesOf, _: Operator, sweep: str) -> Response:
    """Remove a sweep with its results and the blobs that only it used."""
    services.store.write(sweeps.delete, services.store.blob_dir, sweep)
    return Response(status_code=204)


@router.post("/sweeps/{sweep}:retry-failed")
def retry_failed(services: ServicesOf, _: Operator, sweep: str) -> dict[str, Any]:
    """Queue every failed job of a sweep again."""
    sweep_id, count = services.store.write(sweeps.retry_failed, sweep)
    return {**_shown(services, sweep_id), "retried": count}


@router.post("/jobs/{job}:retry")
def retry_job(services: ServicesOf, _: Operator, job: str) -> dict[str, Any]:
    """Queue one failed job again."""
    return _shown(services, services.store.write(jobs.retry, job))
