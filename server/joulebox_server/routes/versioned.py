"""The routers of `/v1`."""

from fastapi import APIRouter

from joulebox_server.problems import told


def versioned(tag: str) -> APIRouter:
    """A router under `/v1`, with the errors that each of its routes can answer with.

    The app takes its routes over as they are (`app.routes.extend`): `include_router` would compare the versions of
    all routers within routers on every request, a tenth of what a lease costs.
    """
    return APIRouter(prefix="/v1", tags=[tag], responses=told(401, 403, 408, 422, 503))
