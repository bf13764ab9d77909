"""The wheels that devices install from this server, and the line that makes a device join."""

import hashlib
import html
import shlex
from functools import lru_cache
from pathlib import Path
from typing import Final
from urllib.parse import quote, urlsplit

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse, HTMLResponse
from packaging.utils import InvalidWheelFilename, parse_wheel_filename
from packaging.version import Version

from joulebox_server.errors import NotFoundError
from joulebox_server.problems import told
from joulebox_server.services import ServicesOf
from joulebox_server.settings import is_loopback

PACKAGES: Final = ("joulebox-agent", "joulebox-render")
ENVIRONMENT: Final = "~/.joulebox"
"""The device's own folder for them: most systems refuse packages beside their own (PEP 668)."""

# Open to all: a device has no token before it joins, and there is nothing secret in a program.
router = APIRouter(tags=["wheels"])


def wheels_in(folder: Path | None) -> dict[Path, tuple[str, Version]]:
    """The agent's and the renderer's wheels of a folder, by name, each with its package and version; {} without one."""
    wheels = {}
    for path in sorted(folder.glob("*.whl")) if folder is not None else ():
        try:
            package, version, _, _ = parse_wheel_filename(path.name)
        except InvalidWheelFilename:
            continue
        if package in PACKAGES and path.is_file():
            wheels[path] = str(package), version
    return wheels


def join_command(folder: Path | None, url: str, code: str) -> str:
    """One line for a device's shell: install the agent and the renderer, enrol, look at the energy sources."""
    steps = [f"joulebox-agent enroll --server {shlex.quote(url)} --code {code}", "joulebox-agent doctor"]
    newest = dict(sorted(wheels_in(folder).values()))
    if len(newest) == len(PACKAGES):
        words = ["python3", "-m", "pip", "install", "--find-links", f"{url}/wheels/"]
        host = urlsplit(url).hostname or ""
        if url.startswith("http://") and not is_loopback(host):
            words[4:4] = ["--trusted-host", host]  # pip passes over plain addresses of other machines otherwise
        # Exactly these versions: pip looks at its public index too, where a stranger's could claim to be newer.
        words += [f"{package}=={newest[package]}" for package in PACKAGES]
        steps[:0] = [f"python3 -m venv {ENVIRONMENT}", f". {ENVIRONMENT}/bin/activate", shlex.join(words)]
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
