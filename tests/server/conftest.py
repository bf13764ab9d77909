"""A server in this process (TestClient), one on a real port (uvicorn), and devices for both."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx2
import pytest
import uvicorn
from joulebox_server.app import create_app
from joulebox_server.settings import ServerSettings
from server_testing import BASE_URL, Clock, Server, serving


@pytest.fixture(scope="session")
def executor() -> Iterator[ThreadPoolExecutor]:
    """Computes differences in this process: spawning one for each test would take seconds."""
    with ThreadPoolExecutor(1) as pool:
        yield pool


@pytest.fixture
def server(tmp_path: Path, executor: ThreadPoolExecutor) -> Iterator[Server]:
    """A server with a scene `box`."""
    with serving(tmp_path / "data", executor) as made:
        made.add_scene()
        yield made


@pytest.fixture
def live(tmp_path: Path, executor: ThreadPoolExecutor) -> Iterator[Server]:
    """As `server`, on a real port: for what needs several connections at once."""
    clock = Clock()
    app = create_app(ServerSettings(data_dir=tmp_path / "data", release_pause_s=0, retry_pause_s=0), executor, clock)
    config = uvicorn.Config(app, port=0, log_level="warning", timeout_graceful_shutdown=1)
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


@pytest.fixture
def contract_dir() -> Path:
    """Sample documents that the agent's tests use as well."""
    return Path(__file__).parents[1] / "contract"
