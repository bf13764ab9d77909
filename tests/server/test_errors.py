"""Every error has one shape: RFC 9457 problem+json with code, request id and the fields at fault."""

import io
import json
import sqlite3
import zipfile
from pathlib import Path
from typing import Any

import pytest
from fake_device import capabilities, measure_document, scene_zip, sweep
from server_testing import Server, serving

NOBODY = {"Authorization": "Bearer jb_nobody"}
ZEROS = "0" * 64
UUID = "01990000-0000-7000-8000-000000000000"

# (method, path, options, status, code, part of the sentence)
PLAIN: list[tuple[str, str, dict[str, Any], int, str, str]] = [
    ("GET", "/v1/nothing", {}, 404, "not_found", "no GET /v1/nothing"),
    ("PUT", "/v1/sweeps", {}, 405, "method_not_allowed", "no PUT /v1/sweeps"),
    ("GET", f"/v1/sweeps/{UUID}", {}, 404, "not_found", "joulebox sweep list"),
    ("GET", f"/v1/sweeps/{UUID}/jobs", {}, 404, "not_found", "no sweep"),
    ("GET", f"/v1/sweeps/{UUID}/tradeoff", {}, 404, "not_found", "no sweep"),
    ("GET", f"/v1/sweeps/{UUID}/recommendation", {}, 404, "not_found", "no sweep"),
    ("GET", f"/v1/sweeps/{UUID}/charts/tradeoff.svg", {}, 404, "not_found", "no sweep"),
    ("GET", f"/v1/sweeps/{UUID}/charts/tradeoff.gif", {}, 422, "invalid", "form"),
    ("GET", "/v1/results?sweep=nope", {}, 404, "not_found", "no sweep"),
    ("GET", "/v1/results?format=xml", {}, 422, "invalid", "format"),
    ("GET", "/v1/events?sweep=nope", {}, 404, "not_found", "no sweep"),
    ("GET", "/v1/devices/nobody", {}, 404, "not_found", "none is enrolled"),
    ("GET", "/v1/sweeps?limit=201", {}, 422, "invalid", "limit: input should be less than or equal to 200"),
    ("GET", "/v1/blobs/xyz", {}, 422, "invalid", "sha256"),
    ("GET", f"/v1/blobs/{ZEROS}", {}, 404, "not_found", "no blob"),
    ("GET", f"/v1/images/{ZEROS}.png", {}, 404, "not_found", "no blob"),
    ("GET", f"/v1/compare?reference={ZEROS}&test={ZEROS}", {}, 404, "not_found", "no blob"),
    ("GET", f"/v1/compare?reference={ZEROS}", {}, 422, "invalid", "test: this field is missing"),
    ("GET", "/v1/devices", {"headers": NOBODY}, 401, "unauthenticated", "not known"),
    ("GET", "/v1/devices", {"headers": {"Authorization": "Basic x"}}, 401, "unauthenticated", "Bearer TOKEN"),
    ("GET", "/v1/devices", {"headers": {"Host": "evil.example"}}, 401, "unauthenticated", "needs a token"),
    ("POST", "/v1/sweeps", {"json": {}}, 401, "unauthenticated", "needs a token"),
    ("POST", "/v1/devices", {"json": {"code": "A", "name": "b", "boot_id": "c"}}, 401, "unauthenticated", "enrolment"),
    ("POST", "/v1/devices", {"json": {"code": "A"}}, 422, "invalid", "name: this field is missing"),
    (
        "POST",
        "/v1/devices",
        {"content": "{", "headers": {"Content-Type": "application/json"}},
        422,
        "invalid",
        "JSON decode error",
    ),
]


def told(answer: Any, status: int, code: str, sentence: str) -> dict[str, Any]:
    """Check the one shape; returns the problem."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem.keys() == {"type", "title", "status", "detail", "code", "request_id", "errors"}
    assert (problem["status"], problem["code"]) == (status, code)
    assert sentence in problem["detail"]
    assert problem["request_id"] == answer.headers["x-request-id"]
    assert all(error.keys() == {"field", "message"} for error in problem["errors"])
    assert "Traceback" not in answer.text
    if status == 401:
        assert answer.headers["www-authenticate"] == "Bearer"
    if status in (503, 507):
        assert int(answer.headers["retry-after"]) > 0
    return dict(problem)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory, executor: Any) -> Any:
    with serving(tmp_path_factory.mktemp("data"), executor) as server:
        server.add_scene()
        yield server


@pytest.mark.parametrize(("method", "path", "options", "status", "code", "sentence"), PLAIN)
def test_plain_errors(
    shared: Server, method: str, path: str, options: dict[str, Any], status: int, code: str, sentence: str
) -> None:
    told(shared.client.request(method, path, **options), status, code, sentence)


BAD_SWEEPS: list[tuple[dict[str, Any], str, str]] = [
    ({"axes": {"global_photns": [1]}}, "axes.global_photns[0]", "did you mean 'global_photons'?"),
    ({"axes": {"gather_count": [5, 0]}}, "axes.gather_count[1]", "0 must be at least 1"),
    ({"settings": {"width": "wide"}}, "settings.width", "is not of type integer"),
    ({"settings": {"indirect": "final_gathr"}}, "settings.indirect", "did you mean 'final_gather'?"),
    ({"settings": {"height": 0}}, "settings.height", "0 must be at least 1"),
    ({"settings": {"height": "tall"}}, "settings.height", "'tall' is not of type integer"),
    ({"reference": {"settings": {"sede": 3}}}, "reference.settings.sede", "did you mean 'seed'?"),
    ({"rule": "list", "axes": {}, "configurations": [{"widht": 3}]}, "configurations[0].widht", "'width'"),
    ({"scenes": ["boks"]}, "scenes[0]", "known are box"),
    ({"devices": ["nobody"]}, "devices[0]", "enrolled are laptop"),
    ({"axes": {"seed": list(range(1000)), "gather_count": list(range(1, 1000))}}, "axes", "at most 2000"),
    ({"repeats": 1000, "axes": {"seed": list(range(30))}}, "repeats", "at most 20000"),
    ({"axes": {"seed": []}}, "axes.seed", "at least 1 item"),
    ({"axes": {"seed": [1, 1]}}, "the body", "holds a value twice"),
    ({"repeats": 0}, "repeats", "greater than or equal to 1"),
    ({"rule": "latin"}, "rule", "one_at_a_time"),
    ({"measure": {"min_windows": 9, "max_windows": 2}}, "measure", "min_windows 9 is more than max_windows 2"),
    ({"scenes": []}, "scenes", "at least 1 item"),
    ({"scenes": ["box", "box"]}, "the body", "twice"),
    ({"surprise": 1}, "surprise", "not known"),
    ({"rule": "list"}, "the body", "belong together"),
    ({"devices": ["laptop"], "requires": {"os": "x"}}, "the body", "cannot both be given"),
    ({"limit": 0}, "limit", "greater than 0"),
    ({"settings": {"seed": 2**60}}, "the body", "whole number from 0 to 9007199254740992"),
    ({"settings": {"seed": 10**30}}, "settings.seed", "a whole number must lie within"),
    ({"axes": {"seed": [1, 1.5]}}, "the body", "seed is 1.5"),
    ({"reference": {"settings": {"seed": True}}}, "the body", "seed is True"),
]


@pytest.fixture(scope="module")
def with_device(shared: Server) -> Server:
    shared.device()
    return shared


@pytest.mark.parametrize(("changes", "field", "sentence"), BAD_SWEEPS)
@pytest.mark.parametrize("path", ["/v1/sweeps", "/v1/sweeps:preview"])
def test_bad_sweeps(with_device: Server, path: str, changes: dict[str, Any], field: str, sentence: str) -> None:
    answer = with_device.client.post(path, json=sweep(**changes), headers=with_device.operator)
    problem = told(answer, 422, "invalid", sentence)
    assert problem["errors"][0]["field"] == field
    assert with_device.get("/sweeps")["items"] == []


def test_roles(server: Server) -> None:
    """A viewer may not write, a device not read sweeps, an operator not measure; an admin may do what people may."""
    device = server.device()
    for headers, method, path in (
        (server.viewer, "POST", "/v1/enrollments"),
        (server.viewer, "DELETE", f"/v1/devices/{device.device_id}"),
        (device.headers, "GET", "/v1/sweeps"),
        (device.headers, "POST", "/v1/sweeps"),
        (server.operator, "POST", "/v1/leases"),
        (server.token("admin"), "POST", "/v1/leases"),
    ):
        body = {} if method == "POST" else None
        told(server.client.request(method, path, headers=headers, json=body), 403, "forbidden", "role")
    assert server.client.post("/v1/enrollments", headers=server.token("admin"), json={}).status_code == 201


def test_beyond_loopback_reads_need_a_token(tmp_path: Path, executor: Any) -> None:
    with serving(tmp_path, executor, host="0.0.0.0") as server:
        told(server.client.get("/v1/sweeps"), 401, "unauthenticated", "needs a token")
        assert server.client.get("/v1/sweeps", headers=server.viewer).status_code == 200
        assert server.client.get("/healthz").status_code == 200


def test_device_errors(server: Server) -> None:
    device, other = server.device(), server.device("other")
    path = f"/v1/devices/{other.device_id}/capabilities"
    told(server.client.put(path, headers=device.headers, json=capabilities()), 403, "forbidden", "own")
    bad = capabilities(renderer={"name": "x", "version": "1", "settings_schema": {"type": 3}})
    path = f"/v1/devices/{device.device_id}/capabilities"
    told(server.client.put(path, headers=device.headers, json=bad), 422, "invalid", "JSON Schema")
    path = f"/v1/attempts/{UUID}/release"
    told(server.client.post(path, headers=device.headers, json={"reason": "hot"}), 404, "not_found", "attempt")
    code = server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["code"]
    taken = {"code": code, "name": "laptop", "boot_id": "b"}
    told(server.client.post("/v1/devices", json=taken), 409, "conflict", "'laptop' is enrolled")
    # the refused enrolment did not spend the code; the next one does
    assert server.client.post("/v1/devices", json=taken | {"name": "third"}).status_code == 201
    told(server.client.post("/v1/devices", json=taken | {"name": "fourth"}), 401, "unauthenticated", "used")


def test_bad_results(server: Server) -> None:
    server.add_sweep()
    device, other = server.device(), server.device("other")
    lease = device.lease()[0]
    document = measure_document(lease)
    missing = told(device.put_result(lease, document), 422, "invalid", "image_blob")
    assert document["image_blob"] in missing["errors"][0]["message"]
    told(device.put_result(lease, document | {"image_blob": None, "extra": 1}), 422, "invalid", "extra")
    lopsided = {"value": 1.0, "low": 2.0, "high": 3.0}
    told(
        device.put_result(lease, document | {"time_s_per_image": lopsided}),
        422,
        "invalid",
        "time_s_per_image: 2.0 to 3.0 is not an interval around 1.0",
    )
    told(device.put_result(lease, document | {"time_s_per_image": None}), 422, "invalid", "time_s_per_image is missing")
    other_size = document | {"image_blob": None, "settings": document["settings"] | {"width": 99}}
    told(device.put_result(lease, other_size), 422, "invalid", "settings.width: is 99, the job asked for 32")
    nan = json.dumps(document).replace(str(document["window_s"]), "NaN", 1)
    path = f"/v1/attempts/{lease['attempt_id']}/result"
    headers = device.headers | {"Content-Type": "application/json"}
    told(server.client.put(path, headers=headers, content=nan), 422, "invalid", "finite number")
    told(other.put_result(lease, document), 403, "forbidden", "another device")
    told(device.put_result(lease | {"attempt_id": UUID}, document), 404, "not_found", "attempt")
    assert server.get("/results")["items"] == []


DIRECTORY_AT, NAME_LENGTH_AT = -6, 63 + 28
"""Where `scene_zip()` says where its list of files begins, and how long the name of the first is."""


def packed(method: int) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as bundle:
        bundle.writestr("scene.xml", bytes(range(256)))
    return out.getvalue()


def damaged(content: bytes, at: int, value: int) -> bytes:
    """With one byte made another."""
    assert content[at] != value
    changed = bytearray(content)
    changed[at] = value
    return bytes(changed)


BAD_SCENES = [
    (b"not a zip", "not a whole zip file"),
    (scene_zip()[:60], "not a whole zip file"),
    (scene_zip(**{"../escape.ply": b"x"}), "outside its folder"),
    (scene_zip(**{"/etc/passwd": b"x"}), "outside its folder"),
    (scene_zip(**{"..\\escape.ply": b"x"}), "outside its folder"),
    (scene_zip(**{"SCENE.xml": b"x"}), "two files of one name"),
    (scene_zip(**{"mesh": b"x", "mesh/box.ply": b"x"}), "two files of one name"),
    (scene_zip(**{"caf\u00e9.ply": b"x", "cafe\u0301.ply": b"y"}), "two files of one name"),
    (scene_zip(**{"../folder/": b""}), "outside its folder"),
    *((scene_zip(**{name: b"x"}), "not every system can keep") for name in ("./scene.xml", "a//b", "a\\b", "b.", "c?")),
    (scene_zip(**dict.fromkeys(["long" * 64], b"x")), "not every system can keep"),
    (packed(zipfile.ZIP_BZIP2), "in a rare way"),
    (packed(zipfile.ZIP_LZMA), "in a rare way"),
    (damaged(packed(zipfile.ZIP_DEFLATED), 45, 0), "not a whole zip file"),
    (damaged(scene_zip(), DIRECTORY_AT, 200), "not a whole zip file"),
    (damaged(scene_zip(), NAME_LENGTH_AT, 0), "not a whole zip file"),
]


@pytest.mark.parametrize(("content", "sentence"), BAD_SCENES)
def test_bad_scenes(shared: Server, content: bytes, sentence: str) -> None:
    answer = shared.client.post("/v1/scenes?name=bad", content=content, headers=shared.operator)
    told(answer, 422, "invalid", sentence)
    assert "bad" not in [scene["name"] for scene in shared.get("/scenes")["items"]]
    assert not any(shared.store.incoming_dir.iterdir())


def test_scene_limits(tmp_path: Path, executor: Any) -> None:
    """A small zip that unpacks to much (a bomb), too many files, a link, a name with a slash."""
    with serving(tmp_path, executor, max_scene_bytes=100_000, max_scene_files=3) as server:
        post, headers = server.client.post, server.operator
        bomb = scene_zip(**{"zeros.ply": bytes(100_001)})
        told(post("/v1/scenes?name=a", content=bomb, headers=headers), 413, "too_large", "unpacks to more")
        many = scene_zip(**{f"{i}.ply": b"x" for i in range(3)})
        told(post("/v1/scenes?name=a", content=many, headers=headers), 413, "too_large", "4 files")
        told(
            post("/v1/scenes?name=..", content=scene_zip(), headers=headers), 422, "invalid", "name: a name may not be"
        )
        told(post("/v1/scenes?name=a/b", content=scene_zip(), headers=headers), 422, "invalid", "name")


def test_body_limits(tmp_path: Path, executor: Any) -> None:
    with serving(tmp_path, executor, max_body_bytes=2000, max_blob_bytes=3000) as server:
        long = json.dumps(sweep(name="x" * 3000))
        headers = server.operator | {"Content-Type": "application/json"}
        told(server.client.post("/v1/sweeps", content=long, headers=headers), 413, "too_large", "")
        answer = server.client.put(f"/v1/blobs/{ZEROS}", content=bytes(3001), headers=server.operator)
        told(answer, 413, "too_large", "at most 3000 bytes")
        assert not any(server.store.incoming_dir.iterdir())


def test_questions_that_contradict_themselves(server: Server) -> None:
    sweep_id = server.add_sweep()["id"]
    path = f"/v1/sweeps/{sweep_id}/recommendation"
    for params, sentence in (
        ({"budget_j": 1, "budget_s": 1}, "one budget"),
        ({"budget_wh": 1}, "belong together"),
        ({"budget_j": -1}, "budget_j"),
        ({"budget_j": "nan"}, "budget_j"),
        ({"confidence": 2}, "confidence"),
    ):
        told(server.client.get(path, params=params), 422, "invalid", sentence)
    answer = server.client.get(path, params={"budget_j": 1})
    assert answer.status_code == 422
    assert answer.json()["code"] == "not_answerable"


def test_unexpected_error(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault of ours: the shape, an id to find it in the log, nothing of the inside."""

    def broken(*_: Any) -> None:
        raise sqlite3.DatabaseError("secret inside")

    monkeypatch.setattr("joulebox_server.store.devices.listed", broken)
    answer = server.client.get("/v1/devices")
    problem = told(answer, 500, "failed", "its log says more")
    assert "secret" not in answer.text
    assert problem["request_id"] in problem["detail"]


PASSED_OVER = [
    ("/v1/sweeps?limit=2&curser=x", "curser: this field is not known; known are cursor, limit"),
    ("/v1/results?sweep_id=x", "sweep_id: this field is not known"),
    ("/v1/devices/x?limit=1", "limit: this field is not known; there are none here"),
    ("/v1/sweeps?cursor=zzz", "cursor: string should match pattern"),
    ("/v1/results?cursor=", "cursor: string should match pattern"),
]


@pytest.mark.parametrize(("path", "sentence"), PASSED_OVER)
def test_a_question_is_answered_whole_or_not_at_all(shared: Server, path: str, sentence: str) -> None:
    """A misspelt filter would answer with everything, a damaged cursor with the first page once more."""
    told(shared.client.get(path), 422, "invalid", sentence)


def test_every_parameter_of_the_description_is_known(shared: Server) -> None:
    """No route refuses a query parameter that the OpenAPI document says it has."""
    described = shared.client.get("/openapi.json").json()["paths"]
    asked = 0
    for path, methods in described.items():
        for parameter in methods.get("get", {}).get("parameters", []):
            if parameter["in"] == "query" and path.startswith("/v1/") and path != "/v1/events":
                answer = shared.client.get(path.replace("{", "").replace("}", ""), params={parameter["name"]: "1"})
                assert "this field is not known" not in answer.text, (path, parameter["name"])
                asked += 1
    assert asked > 20


def test_a_body_says_each_thing_once(shared: Server) -> None:
    twice = b'{"repeats": 1, ' + json.dumps(sweep(name="twice", repeats=5)).encode()[1:]
    headers = shared.operator | {"Content-Type": "application/json"}
    told(shared.client.post("/v1/sweeps", content=twice, headers=headers), 422, "invalid", "'repeats' stands twice")
    told(
        shared.client.post("/v1/sweeps", content=b"x", headers=headers | {"Content-Encoding": "gzip"}),
        422, "invalid", "it is packed (gzip); send it as it is",
    )  # fmt: skip
    told(
        shared.client.post("/v1/sweeps", content=twice, headers=shared.operator | {"Content-Type": "text/plain"}),
        422, "invalid", "the body: it must be JSON, with the header Content-Type: application/json",
    )  # fmt: skip
    assert "twice" not in [found["name"] for found in shared.get("/sweeps")["items"]]
