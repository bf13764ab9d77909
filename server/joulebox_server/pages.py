"""The dashboard's static pages and the chart library, served so that no request leaves this server.

`/` is `web/index.html`, `/assets/...` is everything beside it: the folder travels in the wheel as
`joulebox_server/web`; in a checkout it is `web/` at the top. `/assets/vega.js` is Vega-Embed with all it
needs, bundled offline by vl-convert on first use and kept in the user's cache folder.
"""

import gzip
import hashlib
import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Final

import vl_convert
from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import FileResponse, Response
from fastapi.staticfiles import StaticFiles
from platformdirs import user_cache_path

from joulebox_server.errors import ServerError

# Charts are parsed to an AST and interpreted (`ast: true`), so scripts need no 'unsafe-eval'; the styles of
# vega-embed and of its tooltip are switched off and stand in style.css instead, so styles need no
# 'unsafe-inline'. blob: is for pictures fetched with a token, which <img src> cannot send.
CONTENT_SECURITY_POLICY: Final = "; ".join(
    (
        "default-src 'self'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob:",
        "connect-src 'self'",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
PAGE_HEADERS: Final = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}
REVALIDATE: Final = "no-cache"
FOREVER: Final = "public, max-age=31536000, immutable"
JAVASCRIPT: Final = "text/javascript; charset=utf-8"
CHART_SNIPPET: Final = "export {vegaEmbed, vega};"

_bundling = threading.Lock()


class PagesError(ServerError):
    """The pages or the chart library cannot be served; the message says why and what to do."""


class WebFiles(StaticFiles):
    """Files of `web/` with the page headers; a browser keeps them but asks each time whether they changed."""

    def file_response(self, *args: object, **kwargs: object) -> Response:
        """As StaticFiles (ETag, 304, HEAD), plus the headers of every page."""
        response: Response = super().file_response(*args, **kwargs)  # type: ignore[arg-type]
        response.headers.update(PAGE_HEADERS | {"Cache-Control": REVALIDATE})
        return response


def web_folder() -> Path:
    """The folder of the dashboard's files: in the installed package, else at the top of the checkout.

    Raises PagesError when neither is there.
    """
    package = Path(__file__).resolve().parent
    for folder in (package / "web", package.parent.parent / "web"):
        if (folder / "index.html").is_file():
            return folder
    raise PagesError(
        "the dashboard's files are missing from this installation; "
        "reinstall joulebox-server from its wheel, or run it from a complete checkout"
    )


@cache
def chart_library_name() -> str:
    """File name of the chart library, new whenever vl-convert or the snippet is: it may be cached forever."""
    made_from = f"{version('vl-convert-python')}\n{CHART_SNIPPET}"
    return f"vega-{hashlib.sha256(made_from.encode()).hexdigest()[:16]}.js"


def chart_library(cache_folder: Path | None = None) -> Path:
    """Path of the bundled chart library, made on the first call (about 2 s) and then read from the cache.

    Beside it lies the same file with `.gz`. `cache_folder` defaults to the user's cache folder; a folder that
    cannot be written is replaced by a temporary one, so that a read-only home still shows charts.
    """
    with _bundling:
        folder = cache_folder or user_cache_path("joulebox") / "web"
        path = _made_library(folder)
        if not _complete(path):  # somebody emptied the cache while the server ran
            _made_library.cache_clear()
            path = _made_library(folder)
        return path


@cache
def _made_library(folder: Path) -> Path:
    path = folder / chart_library_name()
    if _complete(path):
        return path
    source = vl_convert.javascript_bundle(CHART_SNIPPET).encode()
    try:
        return _write_library(path, source)
    except OSError:
        return _write_library(Path(tempfile.mkdtemp(prefix="joulebox-web-")) / path.name, source)


def _complete(path: Path) -> bool:
    return path.is_file() and _packed(path).is_file()


def _packed(path: Path) -> Path:
    return path.with_name(path.name + ".gz")


def _write_library(path: Path, source: bytes) -> Path:
    """Write the library plain and packed; each appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for target, content in ((_packed(path), gzip.compress(source, 9, mtime=0)), (path, source)):
        with _replacing(target) as draft:
            draft.write_bytes(content)
    return path


@contextmanager
def _replacing(target: Path) -> Iterator[Path]:
    """A path beside `target` to write to; it takes target's place at the end of the block."""
    draft = target.with_name(f"{target.name}.{os.getpid()}.part")
    try:
        yield draft
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def mount_pages(app: FastAPI, *, cache_folder: Path | None = None) -> None:
    """Add the dashboard to `app`: `/`, `/assets/vega.js` and `/assets/...`.

    The pages hold no data and ask for no token; everything they show they fetch from `/v1`.
    Raises PagesError when the files of the dashboard are missing.
    """
    folder = web_folder()
    files = WebFiles(directory=folder)

    @app.api_route("/", methods=["GET", "HEAD"], include_in_schema=False)
    async def index(request: Request) -> Response:
        return await files.get_response("index.html", request.scope)

    @app.get("/assets/vega.js", include_in_schema=False)
    def chart_library_entry() -> Response:
        # One name for the pages to import; what it points to is cached forever under its own name.
        body = f'export * from "/assets/{chart_library_name()}";\n'
        return Response(body, media_type=JAVASCRIPT, headers=PAGE_HEADERS | {"Cache-Control": REVALIDATE})

    @app.get("/assets/vega-{key}.js", include_in_schema=False)
    def chart_library_file(key: str, request: Request) -> Response:
        if f"vega-{key}.js" != chart_library_name():
            raise HTTPException(404, "this chart library is of another version; load /assets/vega.js")
        path = chart_library(cache_folder)
        headers = PAGE_HEADERS | {"Cache-Control": FOREVER, "Vary": "Accept-Encoding"}
        if "gzip" in request.headers.get("accept-encoding", ""):
            return FileResponse(_packed(path), media_type=JAVASCRIPT, headers=headers | {"Content-Encoding": "gzip"})
        return FileResponse(path, media_type=JAVASCRIPT, headers=headers)

    app.mount("/assets", files, name="assets")
