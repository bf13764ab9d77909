"""The device's side of a job: lease, give back, result."""

import asyncio
import random

from fastapi import Response
from fastapi.responses import JSONResponse

from joulebox_server.problems import told
from joulebox_server.routes.paging import Id
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.answers import Accepted
from joulebox_server.schemas.device import Lease, LeaseRequest, Leases, ReleaseRequest
from joulebox_server.schemas.measure import MeasureDocument
from joulebox_server.services import DeviceId, Services, ServicesOf
from joulebox_server.store import leases, results

LOOK_AGAIN_S = 2.0
"""A waiting device looks this often for jobs that return by the clock alone."""
RETRY_AFTER_S = (5, 10)

NOTHING_TO_DO = {
    "description": "Nothing to do.",
    "headers": {"Retry-After": {"schema": {"type": "integer"}, "description": "Seconds to wait before asking again."}},
}

router = versioned("work")


@router.post("/leases", response_model=Leases, responses={204: NOTHING_TO_DO, **told(413, 507)})
async def lease(services: ServicesOf, device_id: DeviceId, request: LeaseRequest) -> Response:
    """Jobs for the device that asks; waits up to `wait_s` for one, else 204 with Retry-After."""
    loop = asyncio.get_running_loop()
    ends_s = loop.time() + request.wait_s
    granted = await _lease(services, device_id, request)
    while not granted:
        heard = services.bell.heard
        left_s = ends_s - loop.time()
        if left_s <= 0 or services.bell.closed:
            # Spread, so that a shelf of devices does not come back at one moment.
            return Response(status_code=204, headers={"Retry-After": str(random.randint(*RETRY_AFTER_S))})
        if await services.read(leases.work_waits, device_id, services.clock()):
            granted = await _lease(services, device_id, request)
        else:
            await services.bell.wait(heard, min(left_s, LOOK_AGAIN_S))
    return Response(Leases(leases=granted).model_dump_json(), media_type="application/json")


async def _lease(services: Services, device_id: str, request: LeaseRequest) -> list[Lease]:
    return await services.write(
        leases.lease,
        device_id,
        request.boot_id,
        request.conditions,
        request.max_jobs,
        services.lease_rules,
        services.clock(),
        request.holding,
    )


@router.post("/attempts/{attempt_id}/release", status_code=204, responses=told(404, 409, 413, 507))
async def release(services: ServicesOf, device_id: DeviceId, attempt_id: Id, request: ReleaseRequest) -> Response:
    """Give a job back: unmeasured (spends no retry), or `failed`."""
    await services.write(leases.release, attempt_id, device_id, request, services.lease_rules, services.clock())
    return Response(status_code=204)


@router.put(
    "/attempts/{attempt_id}/result",
    status_code=201,
    response_model=Accepted,
    responses={200: {"model": Accepted, "description": "The same once more."}, **told(404, 409, 413, 507)},
)
async def put_result(services: ServicesOf, device_id: DeviceId, attempt_id: Id, document: MeasureDocument) -> Response:
    """The measure document of an attempt: 201 the first time, 200 for the same again, 409 for another."""
    accepted, new = await services.write(
        results.accept,
        services.store.blob_dir,
        attempt_id,
        device_id,
        document,
        services.lease_rules,
        services.clock(),
    )
    return JSONResponse({"accepted": accepted}, 201 if new else 200)
