"""The store: one writer, writes that fail alone, requests that go away, other processes."""

import multiprocessing
import os
import signal
import sqlite3
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from fake_device import picture, resolved, scene_zip, sweep
from joulebox_server.errors import ConflictError, NotFoundError, UnavailableError
from joulebox_server.store import Store, devices, tokens
from joulebox_server.store.database import number
from server_testing import Server, serving


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    made = Store(tmp_path)
    yield made
    made.close()


def test_durability_settings(store: Store) -> None:
    """WAL, FULL, foreign keys, busy timeout: what the promise to an agent rests on."""

    def pragmas(db: Any) -> list[Any]:
        names = ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        return [db.execute(f"PRAGMA {name}").fetchone()[0] for name in names]

    assert store.write(pragmas) == ["wal", 2, 1, 5000]


def test_a_failed_write_undoes_itself_alone(store: Store) -> None:
    """Writes share a commit; the one that fails leaves nothing, its neighbours stay."""
    gate = threading.Event()

    def hold(db: Any) -> None:
        gate.wait(5)

    def half(db: Any) -> None:
        devices.enroll(db, "half", "boot")
        raise NotFoundError("on purpose")

    holding = store.submit(hold)
    before, failing, after = (
        store.submit(devices.enroll, "before", "boot"),
        store.submit(half),
        store.submit(devices.enroll, "after", "boot"),
    )
    gate.set()
    holding.result()
    assert before.result()
    with pytest.raises(NotFoundError, match="on purpose"):
        failing.result()
    assert after.result()
    names = [device["name"] for device in store.read(devices.listed, 10, None)]
    assert sorted(names) == ["after", "before"]


def test_a_cancelled_write_is_skipped(store: Store) -> None:
    """A client that hangs up takes its write along, and the writer lives on."""
    gate = threading.Event()
    holding = store.submit(lambda db: gate.wait(5))
    gone = store.submit(devices.enroll, "gone", "boot")
    assert gone.cancel()
    gate.set()
    holding.result(5)
    assert store.submit(devices.enroll, "here", "boot").result(5)
    assert [device["name"] for device in store.read(devices.listed, 10, None)] == ["here"]


def test_readers_cannot_write(store: Store) -> None:
    with pytest.raises(sqlite3.OperationalError, match="readonly"):
        store.read(tokens.create, "viewer", "sneaky")


def test_closed_store(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.close()
    store.close()
    with pytest.raises(UnavailableError):
        store.write(tokens.people_count, valid=True)


def test_closing_waits_for_a_read_under_way(tmp_path: Path) -> None:
    """SQLite ends the process with a segmentation fault when a connection is closed in the middle of a query."""
    store, begun, gate = Store(tmp_path), threading.Event(), threading.Event()

    def slow(db: Any) -> int:
        begun.set()
        gate.wait(5)
        return number(db, "SELECT 7")

    with ThreadPoolExecutor(2) as pool:
        reading = pool.submit(store.read, slow)
        assert begun.wait(5)
        closing = pool.submit(store.close)
        with pytest.raises(TimeoutError):
            closing.result(0.1)
        gate.set()
        assert reading.result(5) == 7
        closing.result(5)
    with pytest.raises(UnavailableError):
        store.read(number, "SELECT 7")


def test_threads_that_come_and_go_leave_no_connections(store: Store) -> None:
    """A web server's threads end after idling for seconds: one open connection each would fill the process."""

    def connection(db: Any) -> int:
        return id(db)

    seen = set()
    for _ in range(5):
        with ThreadPoolExecutor(1) as pool:
            seen.add(pool.submit(store.read, connection).result())
    assert len(seen) == 1


def test_two_stores_on_one_folder(tmp_path: Path) -> None:
    """A command beside the server: read-then-write from both, eight threads, no lock error, no write lost."""
    stores = [Store(tmp_path), Store(tmp_path)]

    def bump(db: Any) -> None:
        seen = number(db, "SELECT count(*) FROM token")
        tokens.create(db, "viewer", f"{seen}")

    def many(which: int) -> None:
        for _ in range(20):
            stores[which % 2].write(bump)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(many, range(8)))
    assert stores[0].read(number, "SELECT count(DISTINCT name) FROM token") == 160
    for store in stores:
        store.close()


def test_names_are_unique_among_living_devices(store: Store) -> None:
    device_id, _ = store.write(devices.enroll, "one", "boot")
    with pytest.raises(ConflictError):
        store.write(devices.enroll, "one", "boot")
    store.write(devices.revoke, device_id)
    assert store.write(devices.enroll, "one", "boot")


def test_idempotency_key(server: Server) -> None:
    """The same key and sweep: the first one again. The same key and another sweep: refused."""

    def post(body: Any, key: str) -> Any:
        return server.client.post("/v1/sweeps", json=body, headers=server.operator | {"Idempotency-Key": key})

    first, again = post(sweep(), "k1"), post(sweep(), "k1")
    assert (first.status_code, again.status_code) == (201, 200)
    assert first.json()["id"] == again.json()["id"]
    assert first.headers["location"] == f"/v1/sweeps/{first.json()['id']}"
    assert post(sweep(name="other"), "k1").status_code == 409
    assert post(sweep(), "k2").json()["id"] != first.json()["id"]
    assert len(server.get("/sweeps")["items"]) == 2


def test_pages_of_sweeps(server: Server) -> None:
    made = [server.add_sweep(name=f"sweep {i}")["id"] for i in range(5)]
    seen, cursor = [], None
    while True:
        page = server.get("/sweeps", limit=2, **({} if cursor is None else {"cursor": cursor}))
        seen += [found["id"] for found in page["items"]]
        cursor = page["next"]
        if cursor is None:
            break
    assert seen == made[::-1]
    assert len(server.get(f"/sweeps/{made[0]}/jobs", limit=4)["items"]) == 4


def test_scene_names(server: Server) -> None:
    """The same bundle again is 200; another one under the name leaves older sweeps their own."""
    post, headers = server.client.post, server.operator
    assert post("/v1/scenes?name=box", content=scene_zip(), headers=headers).status_code == 200
    server.add_sweep(axes={}, repeats=1)
    changed = post("/v1/scenes?name=box", content=scene_zip("<scene/>"), headers=headers)
    assert changed.status_code == 201
    lease = server.device().lease()[0]
    assert lease["scene"]["bundle_sha256"] != changed.json()["bundle_sha256"]
    assert server.get("/scenes")["items"][0]["bundle_sha256"] == changed.json()["bundle_sha256"]


def test_health_and_metrics(server: Server) -> None:
    server.add_sweep()
    server.device().lease()
    assert server.client.get("/healthz").json()["status"] == "ok"
    assert server.client.get("/readyz").json()["status"] == "ok"
    text = server.client.get("/metrics").text
    for line in ('joulebox_jobs{state="leased"} 1.0', 'joulebox_jobs{state="queued"} 5.0', "joulebox_devices 1.0"):
        assert line in text
    assert 'joulebox_requests_total{method="POST",status="201"}' in text


def test_openapi_names_every_route(server: Server) -> None:
    paths = server.client.get("/openapi.json").json()["paths"]
    for path in ("/v1/sweeps", "/v1/leases", "/v1/attempts/{attempt_id}/result", "/v1/blobs/{sha256}", "/v1/events"):
        assert path in paths


@pytest.mark.skipif(sys.platform == "win32", reason="ends a worker with a POSIX signal")
def test_a_worker_process_that_dies(tmp_path: Path) -> None:
    """Differences are computed in a process of their own; one that is killed costs a second try, not the server."""
    with serving(tmp_path, None) as server:
        shas = []
        for seed in (1, 2):
            content = picture(resolved({"seed": seed}))
            shas.append(server.device(f"device {seed}").put_blob(content))
        pair = {"reference": shas[0], "test": shas[1]}
        first = server.get("/compare", **pair)
        workers = multiprocessing.active_children()
        assert workers
        for worker in workers:
            os.kill(worker.pid or 0, signal.SIGKILL)
            worker.join()
        second = server.get("/compare", **pair, exposure=2.0)
        assert second["value"] != first["value"]
    assert not multiprocessing.active_children()
