"""Who may do what: every route of the API asked by every role, and by nobody."""

from collections.abc import Iterator
from typing import Any

import pytest
from fake_device import FakeDevice, capabilities, measure_document, scene_zip, sweep
from joulebox_server.settings import ServerSettings
from server_testing import Server, serving

UUID = "01990000-0000-7000-8000-000000000000"
ZEROS = "0" * 64
PEOPLE = ("admin", "operator", "viewer")
READ = {"admin", "operator", "viewer"}
ALL = READ | {"device"}
CHANGE = {"admin", "operator"}
SEND = {"admin", "operator", "device"}
DEVICE = {"device"}
ANYBODY = ALL | {"nobody"}

# Who may; a sample of the request. What does not exist answers 404 to those who may.
RIGHTS: dict[str, tuple[set[str], dict[str, Any]]] = {
    "POST /v1/enrollments": (CHANGE, {"json": {}}),
    "POST /v1/devices": (ANYBODY, {"json": {"code": "WRONG", "name": "x", "boot_id": "b"}}),
    "PUT /v1/devices/{device_id}/capabilities": (DEVICE, {"json": capabilities()}),
    "GET /v1/devices": (READ, {}),
    "GET /v1/devices/{device}": (READ, {}),
    "GET /v1/devices/{device}/disagreements": (READ, {}),
    "PATCH /v1/devices/{device}": (CHANGE, {"json": {"health": "good"}}),
    "POST /v1/devices/{device}/token": (CHANGE, {}),
    "DELETE /v1/devices/{device}": (CHANGE, {}),
    "POST /v1/scenes": (CHANGE, {"content": scene_zip(), "params": {"name": "box"}}),
    "GET /v1/scenes": (ALL, {}),
    "POST /v1/sweeps": (CHANGE, {"json": sweep()}),
    "POST /v1/sweeps:preview": (CHANGE, {"json": sweep()}),
    "GET /v1/sweeps": (READ, {}),
    "GET /v1/sweeps/{sweep}": (READ, {}),
    "GET /v1/sweeps/{sweep}/jobs": (READ, {}),
    "PATCH /v1/sweeps/{sweep}": (CHANGE, {"json": {"action": "pause"}}),
    "DELETE /v1/sweeps/{sweep}": (CHANGE, {}),
    "POST /v1/sweeps/{sweep}:retry-failed": (CHANGE, {}),
    "POST /v1/jobs/{job}:retry": (CHANGE, {}),
    "POST /v1/leases": (DEVICE, {"json": {"boot_id": "b"}}),
    "POST /v1/attempts/{attempt_id}/release": (DEVICE, {"json": {"reason": "warm"}}),
    "PUT /v1/attempts/{attempt_id}/result": (DEVICE, {"json": "a measure document"}),
    "GET /v1/blobs/{sha256}": (ALL, {}),
    "PUT /v1/blobs/{sha256}": (SEND, {"content": b"other bytes"}),
    "GET /v1/results": (READ, {}),
    "GET /v1/sweeps/{sweep}/measurements": (READ, {}),
    "GET /v1/sweeps/{sweep}/tradeoff": (READ, {}),
    "GET /v1/sweeps/{sweep}/recommendation": (READ, {}),
    "GET /v1/sweeps/{sweep}/charts/tradeoff.{form}": (READ, {}),
    "GET /v1/sweeps/{sweep}/charts/stages.{form}": (READ, {}),
    "GET /v1/sweeps/{sweep}/charts/trace.{form}": (READ, {"params": {"point": "none"}}),
    "GET /v1/sweeps/{sweep}/points/{configuration_id}": (READ, {}),
    "GET /v1/sweeps/{sweep}/progress": (READ, {}),
    "POST /v1/sweeps:read": (CHANGE, {"content": "name = 'x'", "headers": {"Content-Type": "text/plain"}}),
    "GET /v1/fleet": (READ, {}),
    "GET /v1/compare": (READ, {"params": {"reference": ZEROS, "test": ZEROS}}),
    "GET /v1/compare/versions": (READ, {"params": {"reference": ZEROS, "test": ZEROS}}),
    "POST /v1/differences:recompute": (CHANGE, {"params": {"sweep": "none"}}),
    "POST /v1/sweeps/{sweep}/recommendation:confirm": (CHANGE, {"json": {"count": 1}}),
    "GET /v1/images/{sha256}.png": (READ, {}),
    "GET /v1/images/{sha256}.pfm": (READ, {}),
    "GET /v1/events": (READ, {"params": {"sweep": "none"}}),
    "GET /metrics": (READ, {}),
    "GET /healthz": (ANYBODY, {}),
    "GET /readyz": (ANYBODY, {}),
    "GET /wheels/": (ANYBODY, {}),
    "GET /wheels/{name}": (ANYBODY, {}),
}


class Asked:
    """A server that is no loopback to anybody, so that every read needs a token; and a device of it."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.device: FakeDevice = server.device()
        self.tokens = {role: server.token(role) for role in PEOPLE} | {"device": self.device.headers, "nobody": {}}
        server.add_sweep(axes={}, repeats=1)
        self.document = measure_document(self.device.lease()[0], b"")

    def status(self, route: str, role: str) -> int:
        method, path = route.split()
        for name in ("sweep", "job", "attempt_id", "device", "configuration_id"):
            path = path.replace(f"{{{name}}}", UUID)
        path = path.replace("{device_id}", self.device.device_id).replace("{sha256}", ZEROS)
        path = path.replace("{form}", "svg").replace("{name}", "none.whl")
        options = dict(RIGHTS[route][1])
        if options.get("json") == "a measure document":
            options["json"] = self.document
        headers = self.tokens[role] | {"Host": "lab.example"} | options.pop("headers", {})
        return int(self.server.client.request(method, path, headers=headers, **options).status_code)


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory, executor: Any) -> Iterator[Asked]:
    with serving(tmp_path_factory.mktemp("data"), executor, host="0.0.0.0") as server:
        server.add_scene()
        yield Asked(server)


def test_every_route_is_in_the_table(asked: Asked) -> None:
    document = asked.server.client.get("/openapi.json").json()
    found = {f"{method.upper()} {path}" for path, item in document["paths"].items() for method in item}
    assert found == RIGHTS.keys()


@pytest.mark.parametrize("role", [*PEOPLE, "device", "nobody"])
@pytest.mark.parametrize("route", RIGHTS)
def test_who_may(asked: Asked, route: str, role: str) -> None:
    """Those who may not are told 403, those without a token 401; those who may get past both."""
    status = asked.status(route, role)
    asked.server.app.state.services.enrolling = type(asked.server.app.state.services.enrolling)()
    if role in RIGHTS[route][0]:
        assert status not in (401, 403) or route == "POST /v1/devices", status  # whose code is wrong
        assert status < 500
    else:
        assert status == (401 if role == "nobody" else 403)


def test_a_device_sees_no_other_device_s_work(asked: Asked) -> None:
    """Capabilities, releases and results of another device are refused."""
    server = asked.server
    other = server.device("other")
    lease = asked.device.lease()[0]
    path = f"/v1/attempts/{lease['attempt_id']}"
    body = measure_document(lease, b"")
    assert server.client.put(f"{path}/result", headers=other.headers, json=body).status_code == 403
    assert server.client.post(f"{path}/release", headers=other.headers, json={"reason": "x"}).status_code == 403
    mine = f"/v1/devices/{asked.device.device_id}/capabilities"
    assert server.client.put(mine, headers=other.headers, json=capabilities()).status_code == 403


def test_reads_without_a_token_only_from_this_machine(asked: Asked, tmp_path: Any, executor: Any) -> None:
    """On loopback, under a name of loopback; never when other machines can reach the server."""
    assert asked.server.client.get("/v1/sweeps").status_code == 401
    with serving(tmp_path, executor) as local:
        assert local.client.get("/v1/sweeps").status_code == 200
        assert local.client.get("/v1/sweeps", headers={"Host": "evil.example"}).status_code == 401
    with serving(tmp_path, executor, anonymous_reads=False) as strict:
        assert strict.client.get("/v1/sweeps").status_code == 401
    assert not ServerSettings(data_dir=tmp_path, host="0.0.0.0").loopback
