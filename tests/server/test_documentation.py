"""The OpenAPI document is complete, its examples are true, and the page that shows it needs nobody else."""

import json
import re
from typing import Any

import pytest
from joulebox_server.analysis.documents import Point, Recommendation, Tradeoff
from joulebox_server.routes.recommendation import ConfirmRequest
from joulebox_server.routes.sweeps import ActionRequest
from joulebox_server.schemas import answers, device, measure, sweep, views
from joulebox_server.schemas.examples import EXAMPLES
from pydantic import BaseModel
from server_testing import Server

MODULES = (answers, device, measure, sweep, views)
METHODS = ("get", "put", "post", "patch", "delete", "head")
SHOWN_ELSEWHERE = {"Tradeoff": Tradeoff, "Point": Point, "Recommendation": Recommendation}


def model_of(name: str) -> type[BaseModel]:
    for own in (ActionRequest, ConfirmRequest):
        if name == own.__name__:
            return own
    return next(getattr(module, name) for module in MODULES if hasattr(module, name))


@pytest.fixture
def document(server: Server) -> dict[str, Any]:
    found: dict[str, Any] = server.client.get("/openapi.json").json()
    return found


def operations(document: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    return [
        (f"{method.upper()} {path}", operation)
        for path, item in document["paths"].items()
        for method, operation in item.items()
        if method in METHODS
    ]


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_are_of_their_models(name: str) -> None:
    """Nothing unknown inside, and what is left out may be."""
    model_of(name).model_validate_json(json.dumps(EXAMPLES[name]))


def test_every_route_of_the_contract_is_there(document: dict[str, Any]) -> None:
    wanted = """POST /v1/enrollments; POST /v1/devices; PUT /v1/devices/{device_id}/capabilities; GET /v1/devices;
    PATCH /v1/devices/{device}; POST /v1/devices/{device}/token; DELETE /v1/devices/{device}; POST /v1/scenes;
    GET /v1/scenes; POST /v1/sweeps; POST /v1/sweeps:preview; GET /v1/sweeps; GET /v1/sweeps/{sweep};
    GET /v1/sweeps/{sweep}/jobs; PATCH /v1/sweeps/{sweep}; DELETE /v1/sweeps/{sweep}; POST /v1/jobs/{job}:retry;
    POST /v1/sweeps/{sweep}:retry-failed; POST /v1/leases; POST /v1/attempts/{attempt_id}/release;
    PUT /v1/attempts/{attempt_id}/result; GET /v1/blobs/{sha256}; PUT /v1/blobs/{sha256}; GET /v1/results;
    GET /v1/sweeps/{sweep}/tradeoff; GET /v1/sweeps/{sweep}/charts/tradeoff.{form};
    GET /v1/sweeps/{sweep}/recommendation; GET /v1/compare; GET /v1/events; GET /healthz; GET /readyz; GET /metrics"""
    found = {name for name, _ in operations(document)}
    assert {" ".join(name.split()) for name in wanted.split(";")} - found == set()


def test_every_operation_says_what_it_does_and_who_may(document: dict[str, Any]) -> None:
    open_to_all = {"POST /v1/devices", "GET /healthz", "GET /readyz", "GET /wheels/", "GET /wheels/{name}"}
    for name, operation in operations(document):
        assert operation["description"], name
        assert ("security" in operation) == (name not in open_to_all), name
        for status, answer in operation["responses"].items():
            if int(status) >= 400:
                schema = answer["content"]["application/problem+json"]["schema"]
                assert schema == {"$ref": "#/components/schemas/Problem"}, name


def test_every_document_has_an_example(document: dict[str, Any]) -> None:
    """Bodies and answers; those of the findings are in tests/contract, which the agent's tests share."""
    schemas = document["components"]["schemas"]
    used = re.findall(
        r'"application/json": {"schema": {"\$ref": "#/components/schemas/(\w+)"', json.dumps(document["paths"])
    )
    assert len(set(used)) > 20
    missing = {name for name in used if "examples" not in schemas[name]} - SHOWN_ELSEWHERE.keys()
    assert missing == set()


def test_the_page_loads_nothing_from_elsewhere(server: Server) -> None:
    page = server.client.get("/docs")
    assert page.status_code == 200
    policy = page.headers["content-security-policy"]
    assert "script-src 'self'" in policy and "unsafe" not in policy and "http" not in policy
    assert "<script>" not in page.text
    assets = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert len(assets) == 3
    for asset in assets:
        assert asset.startswith("/docs/")
        found = server.client.get(asset)
        assert (found.status_code, len(found.content) > 50) == (200, True)
        assert found.headers["x-content-type-options"] == "nosniff"
