"""Values that fit the type of their field and still cannot be used: refused in one sentence, nothing stored."""

import json
from typing import Any

import pytest
from fake_device import capabilities, measure_document, picture, sweep
from joulebox_server.errors import InvalidError
from server_testing import Server
from test_errors import told


def test_half_a_character_in_a_sweep(server: Server) -> None:
    body = json.dumps(sweep(settings={"look": "\ud800"}))
    headers = server.operator | {"Content-Type": "application/json"}
    told(server.client.post("/v1/sweeps", content=body, headers=headers), 422, "invalid", "that JSON cannot")
    assert server.get("/sweeps")["items"] == []


def test_results_that_cannot_be_stored(server: Server) -> None:
    """NaN deep inside, half a character, numbers beyond 64 bits; the lease stays, and takes the good result."""
    device = server.device(renderer=None)
    server.add_sweep(axes={}, repeats=1)
    lease = device.lease()[0]
    document = measure_document(lease)
    device.put_blob(picture(document["settings"]))
    attempt, headers = f"/v1/attempts/{lease['attempt_id']}", device.headers | {"Content-Type": "application/json"}
    many_rays = {"direct": document["stages"]["direct"] | {"rays": 1e300}}
    for changes, sentence in (
        ({"conditions": {"before": {"charge": float("nan")}}}, "that JSON cannot"),
        ({"scope": "\udfff"}, "that JSON cannot"),
        ({"images": 10**30}, "images: input should be less"),
        ({"windows": 10**20}, "windows: input should be less"),
        ({"stages": many_rays}, "stages.direct.rays: input should be less"),
    ):
        answer = server.client.put(f"{attempt}/result", content=json.dumps(document | changes), headers=headers)
        told(answer, 422, "invalid", sentence)
    answer = server.client.post(f"{attempt}/release", content=json.dumps({"reason": "\ud800"}), headers=headers)
    told(answer, 422, "invalid", "reason: input should be a valid string")
    assert device.put_result(lease, document).status_code == 201


def test_what_no_field_of_the_database_holds(server: Server) -> None:
    """The net below the schemas: a text or a number that SQLite refuses is the request's fault."""
    asked = {"boot_id": "\ud800", "name": "x", "code": "y"}
    answer = server.client.post("/v1/devices", content=json.dumps(asked), headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text
    with pytest.raises(InvalidError, match="too large"):
        server.store.write(lambda db: db.execute("UPDATE blob SET size_bytes = ?", (2**64,)))


@pytest.mark.parametrize("reference", ["#/nowhere", "http://127.0.0.1:1/schema.json"])
def test_a_schema_whose_references_lead_nowhere(server: Server, reference: str) -> None:
    """Refused when it is told, since nothing could be checked by it; and never fetched."""
    schema = {"type": "object", "properties": {"width": {"anyOf": [{"$ref": reference}]}}}
    device = server.device(renderer=None)
    answer = server.client.put(
        f"/v1/devices/{device.device_id}/capabilities",
        headers=device.headers,
        json=capabilities(renderer={"name": "fake", "version": "1", "settings_schema": schema}),
    )
    told(answer, 422, "invalid", f"{reference!r} leads to none of its definitions")


FAULTY_SCHEMAS = [
    ({"properties": {"a": {"$ref": "#/$defs/a"}}, "$defs": {"a": {"$ref": "#/$defs/a"}}}, "back to themselves"),
    (
        {"properties": {"a": {}}, "$defs": {"a": {"anyOf": [{"$ref": "#/$defs/b"}]}, "b": {"$ref": "#/$defs/a"}}},
        "#/$defs/a, #/$defs/b lead back to themselves",
    ),
    ({"properties": {"a": True}}, "its 'a' is True"),
    (
        {"properties": {"a": {"anyOf": [{"$id": "http://x/", "$ref": "#/$defs/b"}]}}, "$defs": {"b": {}}},
        "its 'a' has an $id",
    ),
]


@pytest.mark.parametrize(("schema", "sentence"), FAULTY_SCHEMAS)
def test_a_schema_by_which_nothing_can_be_checked(server: Server, schema: dict[str, Any], sentence: str) -> None:
    """Refused when it is told: later it would answer every sweep for this device with a fault of ours."""
    device = server.device(renderer=None)
    answer = server.client.put(
        f"/v1/devices/{device.device_id}/capabilities",
        headers=device.headers,
        json=capabilities(renderer={"name": "fake", "version": "1", "settings_schema": schema}),
    )
    told(answer, 422, "invalid", sentence)


def test_a_pattern_that_takes_for_ever_is_left_to_the_renderer(server: Server) -> None:
    """Forty letters would keep Python's regular expressions busy for 2**40 steps."""
    schema = {"properties": {"a": {"type": "string", "pattern": "^(a+)+$"}}}
    server.device(renderer={"name": "fake", "version": "1", "settings_schema": schema})
    asked = sweep(settings={"a": "a" * 40 + "!"}, axes={})
    assert server.client.post("/v1/sweeps:preview", headers=server.operator, json=asked).status_code == 200
    asked["settings"] = {"a": 5}
    answer = server.client.post("/v1/sweeps:preview", headers=server.operator, json=asked)
    told(answer, 422, "invalid", "settings.a: 5 is not of type string")


def test_whole_numbers_without_end(server: Server) -> None:
    """10**400 is JSON, and no number that a chart or an exposure can be made of."""
    for changes in ({"settings": {"exposure": 10**400}}, {"axes": {"gather_count": [-(10**400)]}}):
        answer = server.client.post("/v1/sweeps", headers=server.operator, json=sweep(**changes))
        told(answer, 422, "invalid", "a whole number must lie within 9223372036854775807 of 0")
    server.add_sweep()
    device = server.device()
    lease = device.lease()[0]
    document = measure_document(lease, image_blob=None)
    document["settings"]["gather_count"] = 10**400
    told(device.put_result(lease, document), 422, "invalid", "settings.gather_count: a whole number must lie")


def test_a_void_without_a_reason(server: Server) -> None:
    server.add_sweep()
    device = server.device()
    lease = device.lease()[0]
    told(device.put_result(lease, measure_document(lease, image_blob=None, void="")), 422, "invalid", "void: ")


def test_a_misspelt_budget_is_not_passed_over(server: Server) -> None:
    path = f"/v1/sweeps/{server.add_sweep()['id']}/recommendation"
    told(server.client.get(f"{path}?budget=5"), 422, "invalid", "budget: this field is not known")
