"""Devices: enrolment, capabilities, health, where their pictures disagree."""

import hmac
import socket
from typing import Any

from fastapi import Request, Response
from sqlite_utils import Database

from joulebox_server.errors import ForbiddenError, InvalidError, UnauthenticatedError
from joulebox_server.problems import told
from joulebox_server.routes.paging import ETAG, Cursor, Id, IfMatch, Key, Limit, NameCursor, page
from joulebox_server.routes.versioned import versioned
from joulebox_server.routes.wheels import join_command
from joulebox_server.schemas.answers import Device as DeviceDocument
from joulebox_server.schemas.answers import DeviceId as DeviceIdDocument
from joulebox_server.schemas.answers import DevicePage, DisagreementPage
from joulebox_server.schemas.device import (
    Capabilities,
    DeviceRequest,
    DeviceToken,
    EnrollmentDocument,
    EnrollmentRequest,
    HealthRequest,
)
from joulebox_server.services import DeviceId, Operator, Services, ServicesOf, Viewer
from joulebox_server.settings import is_loopback
from joulebox_server.store import agreement, devices, leases, tokens
from joulebox_server.store.database import etag
from joulebox_server.store.ids import timestamp
from joulebox_server.sweeps.checking import schema_fault

router = versioned("devices")


@router.post("/enrollments", status_code=201, responses=told(507))
def create_enrollment(
    services: ServicesOf, _: Operator, asked: Request, request: EnrollmentRequest | None = None
) -> EnrollmentDocument:
    """A code that enrols one device within 15 minutes, and the line to run on that device."""
    code, expires_at_us = services.store.write(tokens.create_enrollment, None if request is None else request.name)
    return EnrollmentDocument(
        code=code,
        expires_at=timestamp(expires_at_us) or "",
        join=join_command(services.settings.wheels_dir, _url_for_others(services, asked), code),
    )


def _url_for_others(services: Services, asked: Request) -> str:
    """The address by which devices reach this server: as asked, but by the machine's name when asked from itself."""
    url = asked.base_url
    if is_loopback(url.hostname or "") and not services.settings.loopback:
        url = url.replace(hostname=socket.gethostname())
    return str(url).rstrip("/")


@router.post("/devices", status_code=201, responses=told(409, 413, 429, 507))
async def enroll(services: ServicesOf, asked: Request, request: DeviceRequest) -> DeviceToken:
    """Turn a code into a device and its token, which is shown this once."""
    address = asked.client.host if asked.client else ""
    services.enrolling.check(address)
    secret = services.settings.enrollment_secret
    shared = secret is not None and hmac.compare_digest(request.code.encode(), secret.encode())

    def use_and_enroll(db: Database) -> tuple[str, str]:
        if not shared:
            tokens.use_enrollment(db, request.code)
        return devices.enroll(db, request.name, request.boot_id)

    try:
        device_id, token = await services.write(use_and_enroll)
    except UnauthenticatedError:
        services.enrolling.count(address)
        raise
    return DeviceToken(device_id=device_id, token=token)


@router.put("/devices/{device_id}/capabilities", responses=told(413, 507))
def put_capabilities(
    services: ServicesOf, own_id: DeviceId, device_id: Id, capabilities: Capabilities
) -> DeviceIdDocument:
    """What the device is and can do; told at each start of its agent."""
    if device_id != own_id:
        raise ForbiddenError("a device may only tell its own capabilities")
    schema = None if capabilities.renderer is None else capabilities.renderer.settings_schema
    if schema is not None and (fault := schema_fault(schema)) is not None:
        raise InvalidError(f"renderer.settings_schema is not a JSON Schema of settings: {fault}")
    services.store.write(devices.set_capabilities, device_id, capabilities)
    return DeviceIdDocument(device_id=device_id)


@router.get("/devices", response_model=DevicePage)
def list_devices(services: ServicesOf, _: Viewer, limit: Limit = 100, cursor: NameCursor = None) -> dict[str, Any]:
    """Every enrolled device, by name."""
    now = services.clock()

    def found(db: Database) -> list[dict[str, Any]]:
        fleet = devices.fleet_build(db)
        return [devices.document(device, fleet, now=now) for device in devices.listed(db, limit + 1, cursor)]

    return page(services.store.read(found), limit, "name")


@router.get("/devices/{device}", response_model=DeviceDocument, responses={200: ETAG, **told(404)})
def get_device(services: ServicesOf, _: Viewer, response: Response, device: Key) -> dict[str, Any]:
    """One device by id or name."""
    return _shown(services, response, device)


@router.get("/devices/{device}/disagreements", response_model=DisagreementPage, responses=told(404))
def list_disagreements(
    services: ServicesOf, _: Viewer, device: Key, limit: Limit = 50, cursor: Cursor = None
) -> dict[str, Any]:
    """Pictures of a device that differ from what another made of the same settings, the newest first."""

    def found(db: Database) -> list[dict[str, Any]]:
        return agreement.disagreements(db, str(devices.find(db, device)["id"]), limit + 1, cursor)

    return page(services.store.read(found), limit)


@router.patch("/devices/{device}", response_model=DeviceDocument, responses={200: ETAG, **told(404, 412, 507)})
def patch_device(
    services: ServicesOf, _: Operator, response: Response, device: Key, request: HealthRequest, if_match: IfMatch = None
) -> dict[str, Any]:
    """Set a device's health; `good` also clears one that became suspect."""
    return _shown(services, response, services.store.write(devices.set_health, device, request.health, if_match))


def _shown(services: Services, response: Response, key: str) -> dict[str, Any]:
    def found(db: Database) -> tuple[int, dict[str, Any]]:
        device = devices.find(db, key)
        return device["version"], devices.document(device, devices.fleet_build(db), now=services.clock())

    version, document = services.store.read(found)
    response.headers["ETag"] = etag(version)
    return document


@router.post("/devices/{device}/token", status_code=201, responses=told(404, 507))
def rotate_token(services: ServicesOf, _: Operator, device: Key) -> DeviceToken:
    """A new token for a device; the old one ends."""
    device_id, token = services.store.write(devices.rotate_token, device)
    return DeviceToken(device_id=device_id, token=token)


@router.delete("/devices/{device}", status_code=204, responses=told(404, 507))
def revoke(services: ServicesOf, _: Operator, device: Key) -> Response:
    """Shut a device out and take its jobs back; what it measured stays."""
    services.store.write(leases.revoke, device, services.lease_rules, services.clock())
    return Response(status_code=204)
