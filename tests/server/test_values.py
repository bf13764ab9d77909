"""Values that fit the type of their field and still cannot be used: refused in one sentence, nothing stored."""

import json

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


def test_a_misspelt_budget_is_not_passed_over(server: Server) -> None:
    path = f"/v1/sweeps/{server.add_sweep()['id']}/recommendation"
    told(server.client.get(f"{path}?budget=5"), 422, "invalid", "budget: this field is not known")
