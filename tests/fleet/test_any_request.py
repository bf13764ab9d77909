"""Whatever is sent: no fault of the server, no status that the OpenAPI document does not name, no other shape."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import schemathesis
from fake_device import FakeDevice
from hypothesis import HealthCheck, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)
from server_testing import Server, listening

CHECKS = [not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]
ENDLESS = "/v1/events"
"""A stream that ends when its reader goes: asked for a sweep that is not there only."""
HANGS_S = 300
"""Far beyond what any answer takes, also where this process is stopped for a while: only a hang lasts so long."""
FULL = (503, 507)
DEVICES = ("/v1/leases", "/v1/attempts", "/v1/devices/{device_id}/capabilities")

schemathesis.serializer.alias("application/zip", "application/octet-stream")


class Target:
    """A server with something of everything, so that made-up requests also meet what exists."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.device: FakeDevice = server.device()
        sweep = server.add_sweep(repeats=1)
        self.device.work(3)
        lease = self.device.lease()[0]
        result = server.get("/results")["items"][0]
        self.known: dict[str, str] = {
            "sweep": sweep["id"],
            "device": self.device.device_id,
            "device_id": self.device.device_id,
            "attempt_id": lease["attempt_id"],
            "job": lease["job_id"],
            "sha256": result["image_sha256"],
            "name": "box",
        }
        self.schema = schemathesis.openapi.from_url(f"{str(server.client.base_url).rstrip('/')}/openapi.json")

    def operations(self) -> Iterator[Any]:
        for found in self.schema.get_all_operations():
            yield found.ok()

    def try_out(self, operation: Any, examples: int) -> int:
        """Send made-up requests of one operation, every other one about what exists; returns how many."""
        sent = 0
        headers = self.device.headers if operation.path.startswith(DEVICES) else self.server.operator

        @settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck), database=None)
        @given(case=operation.as_strategy())
        def run(case: Any) -> None:
            nonlocal sent
            sent += 1
            if sent % 2 and case.path_parameters:
                case.path_parameters = {
                    name: self.known.get(name, value) for name, value in case.path_parameters.items()
                }
            if operation.path == ENDLESS:
                case.query = {**(case.query or {}), "sweep": "none"}
            if operation.path == "/v1/leases" and isinstance(case.body, dict):
                case.body["wait_s"] = 0
            response = case.call(headers=headers, timeout=HANGS_S)
            case.validate_response(response, checks=CHECKS)

        run()
        return sent


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory, executor: Any) -> Iterator[Target]:
    folder: Path = tmp_path_factory.mktemp("any")
    with listening(folder, executor, max_jobs=200, max_configurations=100, suspect_after=10**6) as server:
        yield Target(server)


def test_any_request(target: Target) -> None:
    sent = {f"{operation.method} {operation.path}": target.try_out(operation, 5) for operation in target.operations()}
    assert len(sent) > 30 and all(sent.values())


@pytest.mark.long
def test_very_many_requests(target: Target) -> None:
    for operation in target.operations():
        target.try_out(operation, 150)
