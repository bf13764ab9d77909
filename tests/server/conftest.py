"""A server in this process (TestClient), one on a real port (uvicorn), and devices for both."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from server_testing import Server, listening, serving


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
    with listening(tmp_path / "data", executor) as made:
        yield made


@pytest.fixture
def contract_dir() -> Path:
    """Sample documents that the agent's tests use as well."""
    return Path(__file__).parents[1] / "contract"
