"""A server in this process (TestClient), one on a real port (uvicorn), and devices for both."""

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from joulebox_server import cli
from server_testing import Run, Server, listening, serving


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


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run the command in this process: (exit code, standard output, standard error)."""
    for name in ("JOULEBOX_SERVER", "JOULEBOX_TOKEN", "JOULEBOX_DATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("JOULEBOX_DATA", str(tmp_path / "no-server"))
    monkeypatch.setenv("COLUMNS", "200")

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["joulebox", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capsys.readouterr()
        code = ended.value.code
        return (0 if code is None else int(code)), out, err

    return call


@pytest.fixture
def there(live: Server) -> list[str]:
    """The options that lead to a live server."""
    token = live.operator["Authorization"].split()[1]
    return ["--server", str(live.client.base_url).rstrip("/"), "--token", token]
