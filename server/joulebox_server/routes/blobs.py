"""Blobs by the SHA-256 of their bytes: immutable, so they may be cached for ever."""

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import FileResponse, JSONResponse

from joulebox_server.services import Anyone, ServicesOf, Writer
from joulebox_server.store import blobs

ShaPath = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$")]
FOREVER = "private, max-age=31536000, immutable"

router = APIRouter(tags=["blobs"])


@router.head("/blobs/{sha256}", include_in_schema=False)
@router.get("/blobs/{sha256}")
def get_blob(services: ServicesOf, _: Anyone, sha256: ShaPath) -> FileResponse:
    """The bytes, whole or the Range asked for."""
    found = services.store.read(blobs.find, services.store.blob_dir, sha256)
    headers = {"ETag": f'"{sha256}"', "Cache-Control": FOREVER, "X-Content-Type-Options": "nosniff"}
    return FileResponse(found, media_type="application/octet-stream", headers=headers)


@router.put("/blobs/{sha256}", status_code=201)
async def put_blob(services: ServicesOf, _: Writer, sha256: ShaPath, request: Request) -> Response:
    """Store the body: 201, or 200 when it is here already; 422 when it hashes to something else."""
    store = services.store
    if await services.read(blobs.exists, store.blob_dir, sha256):
        async for _chunk in request.stream():
            pass  # an answer before the end of the body would look like a broken connection
        return JSONResponse({"sha256": sha256}, 200)
    with blobs.Incoming(store.incoming_dir, services.settings.max_blob_bytes) as incoming:
        async for chunk in request.stream():
            incoming.write(chunk)
        new = await services.write(blobs.adopt, store.blob_dir, incoming, sha256)
    return JSONResponse({"sha256": sha256}, 201 if new else 200)
