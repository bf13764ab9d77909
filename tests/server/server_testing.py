"""A server under test: its clock, its client, and how a device uses it."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import uvicorn
from fake_device import FakeDevice, scene_zip, sweep
from joulebox_server.app import create_app
from joulebox_server.connections import PatientProtocol
from joulebox_server.settings import ServerSettings
from joulebox_server.store import tokens
from starlette.testclient import TestClient

BASE_URL = "http://127.0.0.1"

Run = Callable[..., tuple[int, str, str]]
"""Runs the command in this process: (exit code, standard output, standard error)."""


class Clock:
    """Microseconds since 1970, ahead of the machine's by as much as a test wants."""

    def __init__(self) -> None:
        self.ahead_s = 0.0

    def __call__(self) -> int:
        return time.time_ns() // 1000 + round(self.ahead_s * 1e6)


class Server:
    """An app, a client of it, and shortcuts for what most tests begin with."""

    def __init__(self, client: Any, app: Any, clock: Clock) -> None:
        self.client, self.app, self.clock = client, app, clock
        self.store = app.state.services.store
        self.operator = self.token("operator")
        self.viewer = self.token("viewer")

    def token(self, role: str) -> dict[str, str]:
        """Authorization header of a new token."""
        return {"Authorization": f"Bearer {self.store.write(tokens.create, role, role)}"}

    def add_scene(self, name: str = "box", content: bytes | None = None) -> Any:
        return self.client.post(f"/v1/scenes?name={name}", content=content or scene_zip(), headers=self.operator).json()

    def add_sweep(self, **changes: Any) -> dict[str, Any]:
        answer = self.client.post("/v1/sweeps", json=sweep(**changes), headers=self.operator)
        assert answer.status_code == 201, answer.text
        return answer.json()

    def device(self, name: str = "laptop", **changes: Any) -> FakeDevice:
        return FakeDevice.enroll(self.client, self.operator, name, **changes)

    def get(self, path: str, **params: Any) -> Any:
        answer = self.client.get(f"/v1{path}", params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def wait(self, sweep_id: str, *states: str) -> dict[str, Any]:
        """The sweep once it is in one of the states."""
        ends_s = time.monotonic() + 10
        while time.monotonic() < ends_s:
            found = self.get(f"/sweeps/{sweep_id}")
            if found["state"] in states:
                return found
            time.sleep(0.02)
        raise AssertionError(f"the sweep stays {found['state']}: {json.dumps(found['jobs'])}")


@contextmanager
def serving(data_dir: Path, executor: Any, **settings: Any) -> Iterator[Server]:
    clock = Clock()
    given = {"release_pause_s": 0, "retry_pause_s": 0, **settings}
    app = create_app(ServerSettings(data_dir=data_dir, **given), executor, clock)
    with TestClient(app, base_url=BASE_URL, raise_server_exceptions=False) as client:
        yield Server(client, app, clock)


@contextmanager
def listening(data_dir: Path, executor: Any, **settings: Any) -> Iterator[Server]:
    """As `serving`, on a real port of this process, with a scene `box`."""
    clock = Clock()
    given = {"release_pause_s": 0, "retry_pause_s": 0, **settings}
    app = create_app(ServerSettings(data_dir=data_dir, **given), executor, clock)
    config = uvicorn.Config(app, port=0, log_level="warning", timeout_graceful_shutdown=1, http=PatientProtocol)
    running = uvicorn.Server(config)
    thread = threading.Thread(target=running.run)
    thread.start()
    try:
        while not running.started:
            assert thread.is_alive()
            time.sleep(0.01)
        port = running.servers[0].sockets[0].getsockname()[1]
        with httpx2.Client(base_url=f"{BASE_URL}:{port}", timeout=20) as client:
            made = Server(client, app, clock)
            made.add_scene()
            yield made
    finally:
        if running.started:
            app.state.services.bell.close()
        running.should_exit = True
        thread.join()


def failed(result: tuple[int, str, str], code: int, *parts: str) -> None:
    """One sentence on standard error, nothing else."""
    found, out, err = result
    assert (found, out) == (code, ""), err
    assert err.startswith("joulebox: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    for part in parts:
        assert part in err
