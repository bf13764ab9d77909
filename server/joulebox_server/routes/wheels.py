"""The wheels that devices install from this server, and the line that makes a device join."""

import hashlib
import html
import re
import shlex
from functools import lru_cache
from pathlib import Path
from typing import Final
from urllib.parse import quote, urlsplit

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse, HTMLResponse

from joulebox_server.errors import NotFoundError
from joulebox_server.problems import told
from joulebox_server.services import ServicesOf
from joulebox_server.settings import is_loopback

PACKAGES: Final = ("joulebox-agent", "joulebox-render")
WHEEL: Final = re.compile(r"joulebox_(agent|render)-[A-Za-z0-9_.+!]+-[A-Za-z0-9_.]+-[A-Za-z0-9_.]+-[A-Za-z0-9_.]+\.whl")

# Open to all: a device has no token before it joins, and there is nothing secret in a program.
router = APIRouter(tags=["wheels"])


def wheels_in(folder: Path | None) -> list[Path]:
    """The agent's and the renderer's wheels of a folder, by name; none without a folder."""
    if folder is None or not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if WHEEL.fullmatch(path.name) and path.is_file())


def join_command(folder: Path | None, url: str, code: str) -> str:
    """One line for a device's shell: install the agent and the renderer, enrol, look at the energy sources."""
    steps = [f"joulebox-agent enroll --server {shlex.quote(url)} --code {code}", "joulebox-agent doctor"]
    if wheels_in(folder):
        words = ["python3", "-m", "pip", "install", "--find-links", f"{url}/wheels/", *PACKAGES]
        host = urlsplit(url).hostname or ""
        if url.startswith("http://") and not is_loopback(host):
            words[4:4] = ["--trusted-host", host]  # pip passes over plain addresses of other machines otherwise
        steps.insert(0, shlex.join(words))
    return " && ".join(steps)


@router.get("/wheels/", response_class=HTMLResponse)
def list_wheels(services: ServicesOf) -> HTMLResponse:
    """What `pip install --find-links` reads: a link to each wheel with its SHA-256."""
    links = [
        f'<a href="{quote(path.name)}#sha256={_sha256(path, path.stat().st_mtime_ns)}">{html.escape(path.name)}</a><br>'
        for path in wheels_in(services.settings.wheels_dir)
    ]
    return HTMLResponse("\n".join(["<!doctype html>", "<title>joulebox wheels</title>", *links, ""]))


@router.get("/wheels/{name}", response_class=FileResponse, responses=told(404, 422))
def get_wheel(services: ServicesOf, name: str) -> Response:
    """One wheel."""
    for path in wheels_in(services.settings.wheels_dir):
        if path.name == name:
            return FileResponse(path, media_type="application/octet-stream")
    raise NotFoundError(
        f"there is no wheel {name!r} here; `make wheels` builds them and `joulebox serve --wheels` names them"
    )


@lru_cache(maxsize=64)
def _sha256(path: Path, changed_ns: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
