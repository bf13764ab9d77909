"""Scene bundles."""

from typing import Annotated, Any

from fastapi import Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse
from sqlite_utils import Database

from joulebox_server.bundles import check_bundle
from joulebox_server.problems import told
from joulebox_server.routes.paging import Limit, NameCursor, page
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.answers import SceneBundle, ScenePage
from joulebox_server.schemas.base import Name
from joulebox_server.services import Anyone, Operator, ServicesOf
from joulebox_server.store import blobs, scenes

router = versioned("scenes")


ZIP = {"required": True, "content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}}}


@router.post(
    "/scenes",
    status_code=201,
    response_model=SceneBundle,
    responses={200: {"model": SceneBundle, "description": "The name means this bundle already."}, **told(413, 507)},
    openapi_extra={"requestBody": ZIP},
)
async def post_scene(services: ServicesOf, _: Operator, request: Request, name: Annotated[Name, Query()]) -> Response:
    """Store a zip of a scene's folder under a name: 201, or 200 when the name means this bundle already."""
    settings, store = services.settings, services.store
    with blobs.Incoming(store.incoming_dir, settings.max_blob_bytes) as incoming:
        async for chunk in request.stream():
            incoming.write(chunk)
        sha256 = await run_in_threadpool(incoming.finish)
        await run_in_threadpool(check_bundle, incoming.path, settings.max_scene_files, settings.max_scene_bytes)

        def keep(db: Database) -> bool:
            blobs.adopt(db, store.blob_dir, incoming, sha256)
            return scenes.put(db, name, sha256)

        new = await services.write(keep)
    return JSONResponse({"name": name, "bundle_sha256": sha256}, 201 if new else 200)


@router.get("/scenes", response_model=ScenePage)
def list_scenes(services: ServicesOf, _: Anyone, limit: Limit = 100, cursor: NameCursor = None) -> dict[str, Any]:
    """The scenes that sweeps can name."""
    return page(services.store.read(scenes.listed, limit + 1, cursor), limit, "name")
