"""Requests that are made to hurt: none brings a fault, a hang or another's data; others are served meanwhile."""

import asyncio
import json
import socket
import sqlite3
import time
from collections.abc import Iterator
from typing import Any

import pytest
from fake_device import capabilities, measure_document, sweep
from joulebox_server import connections
from server_testing import Server, listening

JSON_ROUTES = (
    ("POST", "/v1/enrollments"),
    ("POST", "/v1/devices"),
    ("PUT", "/v1/devices/{device}/capabilities"),
    ("PATCH", "/v1/devices/{device}"),
    ("POST", "/v1/sweeps"),
    ("POST", "/v1/sweeps:preview"),
    ("PATCH", "/v1/sweeps/{sweep}"),
    ("POST", "/v1/leases"),
    ("POST", "/v1/attempts/{attempt}/release"),
    ("PUT", "/v1/attempts/{attempt}/result"),
    ("POST", "/v1/sweeps/{sweep}/recommendation:confirm"),
)
BODIES = {
    "nested": b"[" * 100_000,
    "nested objects": b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
    "whole and nested": b'{"conditions": ' + b"[" * 30_000 + b"]" * 30_000 + b', "boot_id": "b", "reason": "r"}',
    "ten megabytes": b'{"name": "' + b"x" * 10_000_000 + b'"}',
    "not UTF-8": b'{"name": "\xff\xfe"}',
    "half a character": b'{"name": "\\ud800", "code": "\\udfff", "boot_id": "\\ud800", "reason": "\\ud800"}',
    "a long number": b'{"max_jobs": ' + b"9" * 100_000 + b"}",
    "a huge exponent": b'{"wait_s": 1e999999999, "boot_id": "b"}',
    "not a number": b'{"wait_s": NaN, "conditions": {"a": NaN, "b": -Infinity}, "boot_id": "b"}',
    "twice the same key": b'{"boot_id": "a", "boot_id": "b", "reason": "a", "reason": "b"}',
    "empty": b"",
    "null": b"null",
    "a null byte": b'{"name": "a\\u0000b", "code": "a\\u0000b", "boot_id": "\\u0000", "reason": "\\u0000"}',
}
NAMES = {
    "a\nb": 422, "a\x1b[31mb": 422, "a/b": 422, "..": None, "a\x7fb": 422, "a\u0085b": 422, "\u202eevil": 422,
    "a\u200bb": 422, " ": 422, "laptop ": 422, "日本語 🔋": 201, "x" * 101: 422,
}  # fmt: skip


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, executor: Any) -> Iterator[Server]:
    with listening(tmp_path_factory.mktemp("hostile"), executor, suspect_after=10**6, body_silence_s=1.0) as found:
        yield found


@pytest.fixture(scope="module")
def address(server: Server) -> tuple[str, int]:
    return str(server.client.base_url.host), int(server.client.base_url.port or 0)


def is_problem(answer: Any) -> bool:
    return (
        answer.headers["content-type"] == "application/problem+json" and {"code", "request_id"} <= answer.json().keys()
    )


@pytest.mark.parametrize("kind", BODIES)
def test_bodies(server: Server, kind: str) -> None:
    """Every route that reads JSON refuses in the one shape what it cannot use, and never as a fault of its own."""
    device = server.device(f"bodies {kind}")
    server.add_sweep(repeats=1, name=f"bodies {kind}")
    lease = device.lease()[0]
    told = {"device": device.device_id, "sweep": lease["sweep_id"], "attempt": lease["attempt_id"]}
    for method, route in JSON_ROUTES:
        path = route.format(**told)
        own = any(word in path for word in ("/capabilities", "/leases", "/attempts"))
        headers = device.headers if own else server.operator
        answer = server.client.request(
            method, path, content=BODIES[kind], headers={**headers, "Content-Type": "application/json"}
        )
        assert answer.status_code < 500, (method, route, answer.text[:300])
        if answer.status_code >= 300:
            assert answer.status_code in (401, 404, 409, 413, 422, 429), (method, route, answer.text[:300])
            assert is_problem(answer)
    server.app.state.services.enrolling = type(server.app.state.services.enrolling)()
    listed = server.get("/devices", limit=200)
    json.dumps(listed, allow_nan=False)


@pytest.mark.parametrize("name", NAMES)
def test_names(server: Server, name: str) -> None:
    """Nothing in a name can move a terminal's cursor, hide, or pass for another; any script may be written."""
    code = server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["code"]
    answer = server.client.post("/v1/devices", json={"code": code, "name": name, "boot_id": "b"})
    assert answer.status_code == (NAMES[name] or answer.status_code) < 500, answer.text
    made = server.client.post("/v1/sweeps", json=sweep(name=name), headers=server.operator)
    assert made.status_code == (NAMES[name] or made.status_code) < 500, made.text


def test_a_result_for_another_s_lease(server: Server) -> None:
    """Neither posted, released nor looked up; and the rightful device goes on undisturbed."""
    mine, other = server.device("rightful"), server.device("thief")
    server.add_sweep(repeats=1, name="mine", devices=["rightful"])
    lease = mine.lease()[0]
    path = f"/v1/attempts/{lease['attempt_id']}"
    document = measure_document(lease)
    for method, where, body in (("PUT", "result", document), ("POST", "release", {"reason": "x"})):
        assert server.client.request(method, f"{path}/{where}", json=body, headers=other.headers).status_code == 403
    taken = {"boot_id": "b", "holding": [lease["attempt_id"]]}
    assert server.client.post("/v1/leases", json=taken, headers=other.headers).status_code in (200, 204)
    assert mine.finish(lease).status_code == 201


def test_an_idempotency_key_sent_again(server: Server) -> None:
    """The same body once more is the same sweep; another body under the key is refused; so is a key of nonsense."""
    headers = {**server.operator, "Idempotency-Key": "once"}
    first = server.client.post("/v1/sweeps", json=sweep(name="keyed"), headers=headers)
    again = server.client.post("/v1/sweeps", json=sweep(name="keyed"), headers=headers)
    other = server.client.post("/v1/sweeps", json=sweep(name="not keyed"), headers=headers)
    assert (first.status_code, again.json()["id"], other.status_code) == (201, first.json()["id"], 409)
    for key in ("", "x" * 10_000):
        headers["Idempotency-Key"] = key
        assert server.client.post("/v1/sweeps", json=sweep(), headers=headers).status_code == 422


def half_sent(address: tuple[str, int], start: bytes) -> socket.socket:
    connection = socket.create_connection(address, timeout=30)
    connection.sendall(start)
    return connection


def test_bodies_that_come_a_byte_at_a_time(server: Server, address: tuple[str, int]) -> None:
    """A hundred half requests hold up nobody, and each is ended when it has been silent for `body_silence_s`."""
    device = server.device("slow")
    token = device.headers["Authorization"].encode()
    head = b" HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 1000\r\n"
    starts = (
        b"POST /v1/devices" + head + b'\r\n{"code"',
        b"POST /v1/leases" + head + b"Authorization: " + token + b"\r\n\r\n{",
        b"PUT /v1/blobs/" + b"0" * 64 + head + b"Authorization: " + token + b"\r\n\r\nx",
    )
    held = [half_sent(address, starts[number % 3]) for number in range(99)]
    try:
        assert server.get("/sweeps") is not None
        assert device.lease() is not None
        for connection in held:
            answer = connection.recv(4096)
            assert answer.startswith(b"HTTP/1.1 408"), answer
    finally:
        for connection in held:
            connection.close()
    assert list(server.store.incoming_dir.iterdir()) == []


def test_a_client_that_leaves_in_mid_body(
    server: Server, address: tuple[str, int], caplog: pytest.LogCaptureFixture
) -> None:
    """Its own affair: told in one line of the log, not as a fault of the server with a traceback."""
    device = server.device("leaves")
    head = (
        f"PUT /v1/blobs/{'0' * 64} HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n"
        f"Authorization: {device.headers['Authorization']}\r\n\r\nx"
    )
    with caplog.at_level("INFO"):
        half_sent(address, head.encode()).close()
        ends_s = time.monotonic() + 20
        while "was given up by its client" not in caplog.text and time.monotonic() < ends_s:
            time.sleep(0.05)
    assert "was given up by its client" in caplog.text
    assert "Traceback" not in caplog.text
    assert list(server.store.incoming_dir.iterdir()) == []


def test_a_connection_that_never_asks(
    server: Server, address: tuple[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Silent from the start, or in the middle of a head, the first or a later one: closed; a long answer is not."""
    monkeypatch.setattr(connections, "HEAD_WITHIN_S", 1.0)
    whole = b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n"
    held = [half_sent(address, start) for start in (b"", b"GET / HT", whole[:-2], whole + whole[:-2])]
    watching = half_sent(address, b"GET /v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    try:
        for connection in held:
            answer = b""
            while part := connection.recv(4096):
                answer += part
            assert answer.count(b"HTTP/1.1 200") == (1 if connection is held[-1] else 0)
        time.sleep(1.5)
        watching.setblocking(False)
        assert watching.recv(65_536).startswith(b"HTTP/1.1 200")
        with pytest.raises(BlockingIOError):  # open, and nothing more to read
            watching.recv(1)
    finally:
        for connection in [*held, watching]:
            connection.close()


def test_a_trickle_is_ended_too(server: Server, address: tuple[str, int]) -> None:
    """A byte now and then is not silence, but a whole JSON body has no longer than ten such silences."""
    head = b"POST /v1/devices HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 1000\r\n\r\n"
    connection = half_sent(address, head)
    began_s = time.monotonic()
    connection.settimeout(0.4)
    answer = b""
    try:
        while not answer and time.monotonic() - began_s < 60:
            connection.sendall(b" ")
            try:
                answer = connection.recv(4096)
            except TimeoutError:
                continue
    finally:
        connection.close()
    assert answer.startswith(b"HTTP/1.1 408"), answer


def test_five_hundred_who_watch(server: Server, address: tuple[str, int]) -> None:
    """Each gets every event once and in order; a device that works meanwhile is served."""
    device = server.device("watched")
    made = server.add_sweep(repeats=2, name="watched", devices=["watched"])
    first = server.client.get("/v1/events", params={"sweep": "none"}).status_code
    assert first == 404
    begin = b"GET /v1/events?sweep=" + made["id"].encode() + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"

    async def watch() -> list[str]:
        reader, writer = await asyncio.open_connection(*address)
        writer.write(begin)
        await writer.drain()
        ids: list[str] = []
        started.release()
        while True:
            line = await asyncio.wait_for(reader.readline(), 60)
            if line.startswith(b"id:"):
                ids.append(line.split(b":")[1].strip().decode())
            if b'"state":"done"' in line and b'"job_id"' not in line:
                writer.close()
                return ids

    started = asyncio.Semaphore(0)

    async def main() -> list[list[str]]:
        watching = [asyncio.create_task(watch()) for _ in range(500)]
        for _ in watching:
            await started.acquire()
        await asyncio.sleep(1)
        done = await asyncio.to_thread(device.work)
        assert done > 0
        return await asyncio.gather(*watching)

    seen = asyncio.run(main())
    assert len({tuple(ids) for ids in seen}) == 1
    assert seen[0] == sorted(set(seen[0]), key=int)
    assert len(seen[0]) >= 2 * len(server.get(f"/sweeps/{made['id']}/jobs", limit=200)["items"])


def test_a_database_that_another_process_holds(server: Server) -> None:
    """Reads go on; a write is told to come again, and comes through afterwards."""
    holder = sqlite3.connect(server.store.path, isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    try:
        began_s = time.monotonic()
        answer = server.client.post("/v1/enrollments", headers=server.operator, json={})
        assert answer.status_code == 503 and is_problem(answer) and int(answer.headers["retry-after"]) > 0
        assert time.monotonic() - began_s < 15
        assert server.client.get("/v1/sweeps").status_code == 200
    finally:
        holder.execute("ROLLBACK")
        holder.close()
    assert server.client.post("/v1/enrollments", headers=server.operator, json={}).status_code == 201


def test_a_device_that_tells_very_much(server: Server) -> None:
    """A schema that takes long to check, or words without end, are refused."""
    device = server.device("greedy")
    schema = {"type": "object", "properties": {f"p{number}": {} for number in range(50_000)}}
    told = capabilities() | {"renderer": {"name": "r", "version": "1", "settings_schema": schema}}
    answer = server.client.put(f"/v1/devices/{device.device_id}/capabilities", json=told, headers=device.headers)
    assert answer.status_code == 422 and "more than 5000 values" in answer.json()["detail"]
    told = capabilities() | {"platform": "x" * 10_000_000}
    answer = server.client.put(f"/v1/devices/{device.device_id}/capabilities", json=told, headers=device.headers)
    assert answer.status_code == 422
    assert len(answer.content) < 2000
