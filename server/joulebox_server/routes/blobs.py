"""Blobs by the SHA-256 of their bytes: immutable, so they may be cached for ever."""

import asyncio
from typing import Annotated, Any

from fastapi import Path, Request, Response
from fastapi.responses import FileResponse, JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import Message, Receive, Scope, Send

from joulebox_server.errors import TooLargeError
from joulebox_server.problems import told
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.answers import StoredBlob
from joulebox_server.services import Anyone, ServicesOf, Writer
from joulebox_server.store import blobs


class BlobFile(FileResponse):
    """A file, or the Range asked for; a Range that cannot be is told in the one shape of errors."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """As FileResponse, whose own refusals are plain text."""

        async def checked(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] in (400, 416):
                size = {"Content-Range": f"bytes */{self.headers['content-length']}"}
                sentence = f"the Range must lie within the blob's {self.headers['content-length']} bytes, as bytes=0-99"
                raise HTTPException(message["status"], sentence, size)
            await send(message)

        await super().__call__(scope, receive, checked)


ShaPath = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$")]
BYTES: dict[str, Any] = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
FOREVER = "private, max-age=31536000, immutable"

router = versioned("blobs")


@router.head("/blobs/{sha256}", include_in_schema=False)
@router.get(
    "/blobs/{sha256}",
    response_class=BlobFile,
    responses={
        200: {"content": BYTES, "description": "The bytes."},
        206: {"content": BYTES, "description": "The Range asked for."},
        304: {"description": "The ETag of If-None-Match: the asker has it."},
        **told(400, 404, 416),
    },
)
def get_blob(services: ServicesOf, _: Anyone, sha256: ShaPath, request: Request) -> Response:
    """The bytes, whole or the Range asked for."""
    found = services.store.read(blobs.find, services.store.blob_dir, sha256)
    tag = f'"{sha256}"'
    headers = {"ETag": tag, "Cache-Control": FOREVER, "X-Content-Type-Options": "nosniff"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    return BlobFile(found, media_type="application/octet-stream", headers=headers)


@router.put(
    "/blobs/{sha256}",
    status_code=201,
    response_model=StoredBlob,
    responses={200: {"model": StoredBlob, "description": "It is here already."}, **told(413, 507)},
    openapi_extra={"requestBody": {"required": True, "content": BYTES}},
)
async def put_blob(services: ServicesOf, _: Writer, sha256: ShaPath, request: Request) -> Response:
    """Store the body: 201, or 200 when it is here already; 422 when it hashes to something else."""
    store, most = services.store, services.settings.max_blob_bytes
    if await services.read(blobs.exists, store.blob_dir, sha256):
        await _pass_over(request, most)
        return JSONResponse({"sha256": sha256}, 200)
    with blobs.Incoming(store.incoming_dir, most) as incoming:
        async for chunk in request.stream():
            incoming.write(chunk)
        await asyncio.to_thread(incoming.finish)  # waits for the disk: neither this loop nor the writer should
        new = await services.write(blobs.adopt, store.blob_dir, incoming, sha256)
    return JSONResponse({"sha256": sha256}, 201 if new else 200)


async def _pass_over(request: Request, most: int) -> None:
    """Read a body that is not needed: an answer before its end would look like a broken connection."""
    size_bytes = 0
    async for chunk in request.stream():
        size_bytes += len(chunk)
        if size_bytes > most:
            raise TooLargeError(f"a blob may have at most {most} bytes")
