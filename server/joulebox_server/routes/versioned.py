"""The routers of `/v1`, whose routes pass nothing over that a request says."""

from collections.abc import Awaitable, Callable
from typing import Any

from fastapi import APIRouter, Request, Response, params
from fastapi.dependencies.utils import get_flat_params
from fastapi.routing import APIRoute

from joulebox_server.errors import FieldError, InvalidError
from joulebox_server.plain_json import read_json
from joulebox_server.problems import told


def versioned(tag: str) -> APIRouter:
    """A router under `/v1`, with the errors that each of its routes can answer with.

    The app takes its routes over as they are (`app.routes.extend`): `include_router` would compare the versions of
    all routers within routers on every request, a tenth of what a lease costs.
    """
    return APIRouter(prefix="/v1", tags=[tag], route_class=_StrictRoute, responses=told(401, 403, 408, 422, 503))


class _StrictRoute(APIRoute):
    """Refuses a query parameter that it does not know, and a body that would be taken for less than it says."""

    def get_route_handler(self) -> Callable[[Request], Awaitable[Response]]:  # type: ignore[override]
        handle = super().get_route_handler()
        known = self._query_names()

        async def strictly(request: Request) -> Response:
            if request.scope["query_string"]:
                _check_query(request, known)
            return await handle(_StrictRequest(request.scope, request.receive))

        return strictly

    def _query_names(self) -> frozenset[str]:
        others = (params.Path, params.Header)
        found = get_flat_params(self.dependant)
        return frozenset(field.alias for field in found if not isinstance(field.field_info, others))


class _StrictRequest(Request):
    async def json(self) -> Any:
        """The body, which must be JSON that says each thing once."""
        coding = self.headers.get("content-encoding", "identity")
        if coding != "identity":
            raise InvalidError(f"it is packed ({coding[:20]}); send it as it is, without Content-Encoding")
        return read_json(await self.body())


def _check_query(request: Request, known: frozenset[str]) -> None:
    unknown = sorted(set(request.query_params) - known)
    if unknown:
        may = f"known are {', '.join(sorted(known))}" if known else "there are none here"
        errors = [FieldError(name[:60], "this field is not known") for name in unknown[:5]]
        raise InvalidError(f"{errors[0].field}: this field is not known; {may}", errors)
