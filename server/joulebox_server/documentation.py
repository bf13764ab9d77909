"""The OpenAPI document, and the page that shows it: nothing is loaded from elsewhere."""

from pathlib import Path
from typing import Any, Final

import fastapi_offline
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.responses import FileResponse, HTMLResponse, Response

from joulebox_server.pages import JAVASCRIPT, PAGE_HEADERS, REVALIDATE
from joulebox_server.schemas.answers import Problem
from joulebox_server.schemas.examples import EXAMPLES

ASSETS: Final = Path(fastapi_offline.__file__).parent / "static"
# Swagger UI draws its arrows from data: addresses.
POLICY: Final = PAGE_HEADERS["Content-Security-Policy"].replace("img-src 'self' blob:", "img-src 'self' data:")
HEADERS: Final = PAGE_HEADERS | {"Content-Security-Policy": POLICY, "Cache-Control": REVALIDATE}
PAGE: Final = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>joulebox: the API</title>
<link rel="stylesheet" href="/docs/swagger-ui.css">
<div id="swagger-ui"></div>
<script src="/docs/swagger-ui-bundle.js"></script>
<script src="/docs/start.js"></script>
</html>
"""
START: Final = """SwaggerUIBundle({
  url: "/openapi.json",
  dom_id: "#swagger-ui",
  deepLinking: true,
  validatorUrl: null,
});
"""
DESCRIPTION: Final = (
    "Errors are `application/problem+json` (RFC 9457) with `code`, `request_id` and `errors`. Lists have a `limit` "
    "of at most 200 and a `cursor`, the `next` of the page before. Every answer carries `X-Request-Id`, the id under "
    "which the server's log knows the request."
)


def mount_documentation(app: FastAPI) -> None:
    """Add `/docs` with its scripts."""

    @app.get("/docs", include_in_schema=False)
    async def page() -> Response:
        return HTMLResponse(PAGE, headers=HEADERS)

    @app.get("/docs/start.js", include_in_schema=False)
    async def start() -> Response:
        return Response(START, media_type=JAVASCRIPT, headers=HEADERS)

    @app.get("/docs/swagger-ui-bundle.js", include_in_schema=False)
    async def script() -> Response:
        return FileResponse(ASSETS / "swagger-ui-bundle.js", media_type=JAVASCRIPT, headers=HEADERS)

    @app.get("/docs/swagger-ui.css", include_in_schema=False)
    async def style() -> Response:
        return FileResponse(ASSETS / "swagger-ui.css", media_type="text/css; charset=utf-8", headers=HEADERS)


def describe(app: FastAPI) -> None:
    """Let `app.openapi()` say what the routes alone do not: the one shape of errors, and an example of everything."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(title=app.title, version=app.version, description=DESCRIPTION, routes=app.routes)
    schemas = document["components"]["schemas"]
    schemas["FieldProblem"] = Problem.model_json_schema()["$defs"]["FieldProblem"]
    schemas["Problem"] = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    del schemas["Problem"]["$defs"]
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    for name, example in EXAMPLES.items():
        if name in schemas:
            schemas[name]["examples"] = [example]
    return document
