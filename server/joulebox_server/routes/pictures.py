"""Pictures: the difference of two, and one as a PNG."""

import asyncio
from typing import Annotated, Any

import numpy as np
from fastapi import Query, Response
from fastapi.responses import FileResponse
from sqlite_utils import Database

from joulebox_server.analysis.difference import METRIC, VERSION
from joulebox_server.analysis.images import check_png, read_picture, tonemap_png
from joulebox_server.errors import InvalidError, ServerError, UnavailableError
from joulebox_server.problems import told
from joulebox_server.routes.blobs import FOREVER, ShaPath
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.answers import DifferenceDocument, DifferenceVersions, Recomputed
from joulebox_server.services import Operator, ServicesOf, Viewer
from joulebox_server.store import blobs, differences
from joulebox_server.store.database import Row

PNG_MAGIC = b"\x89PNG"

Exposure = Annotated[float, Query(ge=1e-6, le=1e6)]
Sha = Annotated[str, Query(pattern=r"^[0-9a-f]{64}$")]

router = versioned("pictures")


@router.get("/compare", response_model=DifferenceDocument, responses=told(404, 507))
async def compare(
    services: ServicesOf, _: Viewer, reference: Sha, test: Sha, exposure: Exposure = 1.0
) -> dict[str, Any]:
    """The difference of two stored pictures, computed once and then remembered."""

    def wanted(db: Database) -> Row:
        for sha256 in (reference, test):
            blobs.find(db, services.store.blob_dir, sha256)
        return differences.get(db, differences.want(db, reference, test, exposure))

    difference = await services.write(wanted)
    if difference["state"] == "pending":
        # Shielded: others may wait for the same difference, and this client may leave.
        await asyncio.shield(services.comparer.start(difference))
        difference = await services.read(differences.get, difference["id"])
    if difference["state"] == "failed":
        raise InvalidError(difference["reason"])
    if difference["state"] == "pending":
        raise UnavailableError("the comparison was interrupted; ask again")
    return differences.document(difference)


@router.get("/compare/versions", response_model=DifferenceVersions)
def versions(services: ServicesOf, _: Viewer, reference: Sha, test: Sha) -> dict[str, Any]:
    """Every value that was computed for a pair, of whatever version of the metric, the newest first."""
    return {"items": services.store.read(differences.versions, reference, test)}


@router.post("/differences:recompute", response_model=Recomputed, responses=told(404, 409, 507))
def recompute(services: ServicesOf, _: Operator, sweep: str | None = None) -> dict[str, Any]:
    """Ask for the differences of a sweep, or of all, that today's metric has not computed."""
    asked, kept = services.store.write(differences.recompute, sweep)
    services.bell.ring_from_thread()
    return {"metric": METRIC, "version": VERSION, "asked": asked, "kept": kept}


@router.get(
    "/images/{sha256}.png",
    response_class=Response,
    responses={200: {"content": {"image/png": {}}, "description": "The picture."}, **told(404)},
)
def image(
    services: ServicesOf,
    _: Viewer,
    sha256: ShaPath,
    exposure: Exposure = 1.0,
    width: Annotated[int | None, Query(ge=1, le=16384)] = None,
) -> Response:
    """A stored picture for the eye: linear ones tone-mapped, PNGs (delta images) as they are."""
    path = services.store.read(blobs.find, services.store.blob_dir, sha256)
    headers = {"Cache-Control": FOREVER, "X-Content-Type-Options": "nosniff"}
    try:
        with path.open("rb") as file:
            if file.read(len(PNG_MAGIC)) == PNG_MAGIC:
                check_png(path)  # a browser would decode whatever it says to be
                return FileResponse(path, media_type="image/png", headers=headers)
        picture = read_picture(path)
    except ServerError as error:
        raise InvalidError(str(error).replace(str(path), f"the blob {sha256}")) from None
    return Response(tonemap_png(picture, exposure, width), media_type="image/png", headers=headers)


@router.get(
    "/images/{sha256}.pfm",
    response_class=Response,
    responses={200: {"content": {"image/x-portable-floatmap": {}}, "description": "The picture."}, **told(404)},
)
def linear_image(services: ServicesOf, _: Viewer, sha256: ShaPath) -> Response:
    """A stored picture as the numbers it holds: linear RGB as a portable float map, little-endian, last row first."""
    path = services.store.read(blobs.find, services.store.blob_dir, sha256)
    try:
        picture = read_picture(path)
    except ServerError as error:
        raise InvalidError(str(error).replace(str(path), f"the blob {sha256}")) from None
    height, width = picture.shape[:2]
    content = f"PF\n{width} {height}\n-1.0\n".encode() + np.ascontiguousarray(picture[::-1], "<f4").tobytes()
    headers = {"Cache-Control": FOREVER, "X-Content-Type-Options": "nosniff"}
    return Response(content, media_type="image/x-portable-floatmap", headers=headers)
