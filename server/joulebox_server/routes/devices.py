"""Devices: enrolment, capabilities, health."""

import hmac
from typing import Any

from fastapi import APIRouter, Response
from sqlite_utils import Database

from joulebox_server.errors import ForbiddenError, InvalidError
from joulebox_server.schemas.device import (
    Capabilities,
    DeviceRequest,
    DeviceToken,
    EnrollmentDocument,
    EnrollmentRequest,
    HealthRequest,
)
from joulebox_server.services import DeviceId, Operator, ServicesOf, Viewer
from joulebox_server.store import devices, tokens
from joulebox_server.store.ids import timestamp
from joulebox_server.sweeps.checking import schema_fault

router = APIRouter(tags=["devices"])


@router.post("/enrollments", status_code=201)
def create_enrollment(
    services: ServicesOf, _: Operator, request: EnrollmentRequest | None = None
) -> EnrollmentDocument:
    """A code that enrols one device within 15 minutes."""
    code, expires_at_us = services.store.write(tokens.create_enrollment, None if request is None else request.name)
    return EnrollmentDocument(code=code, expires_at=timestamp(expires_at_us) or "")


@router.post("/devices", status_code=201)
def enroll(services: ServicesOf, request: DeviceRequest) -> DeviceToken:
    """Turn a code into a device and its token, which is shown this once."""
    secret = services.settings.enrollment_secret
    shared = secret is not None and hmac.compare_digest(request.code.encode(), secret.encode())

    def use_and_enroll(db: Database) -> tuple[str, str]:
        if not shared:
            tokens.use_enrollment(db, request.code)
        return devices.enroll(db, request.name, request.boot_id)

    device_id, token = services.store.write(use_and_enroll)
    return DeviceToken(device_id=device_id, token=token)


@router.put("/devices/{device_id}/capabilities")
def put_capabilities(
    services: ServicesOf, own_id: DeviceId, device_id: str, capabilities: Capabilities
) -> dict[str, str]:
    """What the device is and can do; told at each start of its agent."""
    if device_id != own_id:
        raise ForbiddenError("a device may only tell its own capabilities")
    schema = None if capabilities.renderer is None else capabilities.renderer.settings_schema
    if schema is not None and (fault := schema_fault(schema)) is not None:
        raise InvalidError(f"renderer.settings_schema is not a JSON Schema of settings: {fault}")
    services.store.write(devices.set_capabilities, device_id, capabilities)
    return {"device_id": device_id}


@router.get("/devices")
def list_devices(services: ServicesOf, _: Viewer) -> dict[str, Any]:
    """Every enrolled device, the most recently seen first."""
    now = services.clock()
    found = services.store.read(devices.enrolled)
    return {"items": [devices.document(device, now=now) for device in found], "next": None}


@router.get("/devices/{device}")
def get_device(services: ServicesOf, _: Viewer, device: str) -> dict[str, Any]:
    """One device by id or name."""
    return devices.document(services.store.read(devices.find, device), now=services.clock())


@router.patch("/devices/{device}")
def patch_device(services: ServicesOf, _: Operator, device: str, request: HealthRequest) -> dict[str, Any]:
    """Set a device's health."""
    device_id = services.store.write(devices.set_health, device, request.health)
    return devices.document(services.store.read(devices.find, device_id), now=services.clock())


@router.post("/devices/{device}/token", status_code=201)
def rotate_token(services: ServicesOf, _: Operator, device: str) -> DeviceToken:
    """A new token for a device; the old one ends."""
    device_id, token = services.store.write(devices.rotate_token, device)
    return DeviceToken(device_id=device_id, token=token)


@router.delete("/devices/{device}", status_code=204)
def revoke(services: ServicesOf, _: Operator, device: str) -> Response:
    """Shut a device out; what it measured stays."""
    services.store.write(devices.revoke, device)
    return Response(status_code=204)
