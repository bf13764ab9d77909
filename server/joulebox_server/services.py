"""What handlers work with, kept on the app and nowhere else; and who is asking."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Concatenate, ParamSpec, TypeVar

from fastapi import Depends, Request
from fastapi.openapi.models import HTTPBearer
from fastapi.security.base import SecurityBase
from prometheus_client import CollectorRegistry
from sqlite_utils import Database

from joulebox_server.comparing import Comparer
from joulebox_server.errors import ForbiddenError, UnauthenticatedError
from joulebox_server.feed import Feed
from joulebox_server.limits import FailureLimit
from joulebox_server.settings import ServerSettings, is_loopback
from joulebox_server.store import Store, tokens
from joulebox_server.store.jobs import LeaseRules
from joulebox_server.store.tokens import Principal
from joulebox_server.waiting import Bell
from joulebox_server.workers import Workers

P = ParamSpec("P")
T = TypeVar("T")


@dataclass
class Services:
    """The parts of one running server."""

    settings: ServerSettings
    store: Store
    bell: Bell
    comparer: Comparer
    drawing: Workers
    clock: Callable[[], int]
    """Microseconds since 1970; leases are judged by it."""
    registry: CollectorRegistry = field(default_factory=CollectorRegistry)
    enrolling: FailureLimit = field(default_factory=FailureLimit)

    def __post_init__(self) -> None:
        self.feed = Feed(self.read, self.bell)

    @property
    def lease_rules(self) -> LeaseRules:
        """The settings that leases depend on."""
        settings = self.settings
        return LeaseRules(
            slack_s=settings.lease_slack_s,
            release_pause_s=settings.release_pause_s,
            retry_pause_s=settings.retry_pause_s,
            longest_retry_pause_s=settings.longest_retry_pause_s,
            max_attempts=settings.max_attempts,
            suspect_after=settings.suspect_after,
        )

    async def write(self, function: Callable[Concatenate[Database, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """`store.write` without holding up the event loop."""
        return await asyncio.wrap_future(self.store.submit(function, *args, **kwargs))

    async def read(self, function: Callable[Concatenate[Database, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """`store.read` without holding up the event loop."""
        return await asyncio.to_thread(lambda: self.store.read(function, *args, **kwargs))


async def services_of(request: Request) -> Services:
    """The services of the app that got this request."""
    services: Services = request.app.state.services
    return services


class _Token(SecurityBase):
    """A dependency that lets only these roles pass; admin may do all that people may do.

    One step without dependencies of its own: FastAPI takes longer over each than the look at the token.
    """

    model = HTTPBearer(description="A token of `joulebox token create`, or a device's own.")
    scheme_name = "HTTPBearer"

    def __init__(self, *roles: tokens.Role) -> None:
        self._roles = roles

    def holder(self, request: Request) -> Principal:
        """Who asks. Raises ForbiddenError, or UnauthenticatedError unless reads are free (loopback)."""
        found = _principal(request, request.app.state.services)
        request.state.role, request.state.device_id = found.role, found.device_id
        if found.role in self._roles or (found.role == "admin" and self._roles != ("device",)):
            return found
        may = " or ".join(self._roles)
        raise ForbiddenError(f"a token of the role {found.role} may not do this; {may} may")


class Allowed(_Token):
    """Who asks."""

    async def __call__(self, request: Request) -> Principal:
        return self.holder(request)


class AllowedDevice(_Token):
    """The id of the device that asks."""

    async def __call__(self, request: Request) -> str:
        found = self.holder(request)
        if found.device_id is None:
            raise ForbiddenError("this token belongs to no device")
        return found.device_id


def _principal(request: Request, services: Services) -> Principal:
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and token.strip():
        # Not in a thread: a look into an index is quicker than the way there, and every request makes it.
        return services.store.look(tokens.principal, token.strip())
    if scheme:
        raise UnauthenticatedError("the Authorization header must read `Bearer TOKEN`")
    settings = services.settings
    reads = request.method in ("GET", "HEAD")
    # The Host too: a page from elsewhere can make a browser ask 127.0.0.1 under its own name.
    if reads and settings.anonymous_reads and settings.loopback and is_loopback(request.url.hostname or ""):
        return Principal("viewer")
    raise UnauthenticatedError("this needs a token: send `Authorization: Bearer TOKEN`")


ServicesOf = Annotated[Services, Depends(services_of)]
Viewer = Annotated[Principal, Depends(Allowed("viewer", "operator"))]
Operator = Annotated[Principal, Depends(Allowed("operator"))]
Anyone = Annotated[Principal, Depends(Allowed("viewer", "operator", "device"))]
Writer = Annotated[Principal, Depends(Allowed("operator", "device"))]
DeviceId = Annotated[str, Depends(AllowedDevice("device"))]
