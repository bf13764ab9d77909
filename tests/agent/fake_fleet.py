"""A fleet server in memory behind httpx2.MockTransport: what an agent may meet, without sockets."""

import hashlib
import io
import json
import zipfile
from typing import Any

import httpx2

TOKEN = "device-token"


def scene_zip(members: dict[str, bytes] | None = None) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as bundle:
        for name, content in (members or {"scene.xml": b"<scene/>", "meshes/a.obj": b"v 0 0 0"}).items():
            bundle.writestr(name, content)
    return buffer.getvalue()


def refusal(status: int, problem: dict[str, Any]) -> httpx2.Response:
    """A refusal as every joulebox server makes it."""
    return httpx2.Response(status, json=problem, headers={"Content-Type": "application/problem+json"})


class FakeFleet:
    """Speaks the agent's part of /v1. `down` refuses connections, `answers` overrides single routes."""

    def __init__(self) -> None:
        self.blobs: dict[str, bytes] = {}
        self.jobs: list[dict[str, Any]] = []
        self.results: dict[str, bytes] = {}
        self.releases: list[tuple[str, str, bool]] = []
        self.capabilities: dict[str, Any] | None = None
        self.calls: list[str] = []
        self.down = 0
        self.answers: dict[str, tuple[int, dict[str, Any]]] = {}
        self.transport = httpx2.MockTransport(self.handle)

    def add_scene(self, content: bytes | None = None) -> str:
        content = scene_zip() if content is None else content
        digest = hashlib.sha256(content).hexdigest()
        self.blobs[digest] = content
        return digest

    def add_job(self, number: int, bundle_sha256: str, meter: bool = True, **settings: Any) -> None:
        self.jobs.append({
            "attempt_id": f"attempt-{number}", "job_id": f"job-{number}", "sweep_id": "sweep", "purpose": "measure",
            "expires_at": "2030-01-01T00:00:00Z", "scene": {"name": "cornell", "bundle_sha256": bundle_sha256},
            "defines": {}, "settings": settings, "added_by_a_newer_server": 1,
            "measure": {"window_s": 0.1, "min_windows": 2, "max_windows": 2, "half_width": 0.5, "max_seconds": 20,
                        "meter": meter},
        })  # fmt: skip

    def handle(self, request: httpx2.Request) -> httpx2.Response:
        path = request.url.path.removeprefix("/v1")
        self.calls.append(f"{request.method} {path}")
        if self.down:
            self.down -= 1
            raise httpx2.ConnectError("Connection refused", request=request)
        for key, (status, problem) in self.answers.items():
            if f"{request.method} {path}".startswith(key):
                return refusal(status, problem)
        if path != "/devices" and request.headers.get("Authorization") != f"Bearer {TOKEN}":
            return refusal(401, {"title": "Unauthorized", "detail": "unknown token"})
        return self.route(request.method, path, request.read())

    def route(self, method: str, path: str, body: bytes) -> httpx2.Response:
        if path == "/devices":
            return httpx2.Response(201, json={"device_id": "device-1", "token": TOKEN})
        if path.endswith("/capabilities"):
            self.capabilities = json.loads(body)
            return httpx2.Response(200, json={})
        if path == "/leases":
            if not self.jobs:
                return httpx2.Response(204, headers={"Retry-After": "0"})
            return httpx2.Response(200, json={"leases": [self.jobs.pop(0)]})
        if path.startswith("/blobs/"):
            return self.blob(method, path.removeprefix("/blobs/"), body)
        attempt, verb = path.removeprefix("/attempts/").split("/")
        if verb == "release":
            told = json.loads(body)
            self.releases.append((attempt, told["reason"], told["failed"]))
            return httpx2.Response(204)
        return self.result(attempt, body)

    def blob(self, method: str, digest: str, body: bytes) -> httpx2.Response:
        if method == "PUT":
            if hashlib.sha256(body).hexdigest() != digest:
                return refusal(422, {"title": "wrong digest"})
            self.blobs[digest] = body
            return httpx2.Response(201)
        if digest not in self.blobs:
            return refusal(404, {"title": "no such blob"})
        return httpx2.Response(200, content=self.blobs[digest] if method == "GET" else b"")

    def result(self, attempt: str, body: bytes) -> httpx2.Response:
        document = json.loads(body)
        for name in ("power_samples", "image_blob"):
            if document.get(name) and document[name] not in self.blobs:
                return refusal(422, {"title": "missing blob", "detail": f"blob {document[name]} is missing"})
        if attempt in self.results:
            if self.results[attempt] != body:
                return refusal(409, {"title": "another result was sent"})
            return httpx2.Response(200, json={"accepted": "ok"})
        self.results[attempt] = body
        return httpx2.Response(201, json={"accepted": "ok"})
