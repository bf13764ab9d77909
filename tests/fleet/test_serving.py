"""`joulebox serve` as operators run it: TLS, logs without secrets, and what it refuses."""

import json
import logging
import os
import signal
import ssl
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest
from fake_device import FakeDevice, scene_zip, sweep
from joulebox_server import cli
from joulebox_server.cli import serving

DATA = Path(__file__).parent / "data"
CERTIFICATE, KEY = DATA / "loopback.pem", DATA / "loopback.key"
JOULEBOX = [sys.executable, "-c", "from joulebox_server.cli import main; main()"]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX")


class Served:
    """A server process, and all that it said."""

    def __init__(self, *options: str) -> None:
        command = [*JOULEBOX, "serve", "--port", "0", "--json", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        text = ""
        while not text.endswith("}\n"):
            line = self.process.stdout.readline()
            assert line, self.process.communicate()[1]
            text += line
        self.told: dict[str, Any] = json.loads(text)

    def stop(self) -> str:
        """End it; returns what it wrote to standard error."""
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.communicate(timeout=20)[1]
        finally:
            self.process.kill()


Refused = Callable[..., str]


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Try to serve in this process; returns the sentence on standard error."""

    def call(code: int, *options: str) -> str:
        monkeypatch.setattr(sys, "argv", ["joulebox", "serve", "--port", "0", *options])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == code
        return capsys.readouterr().err

    return call


def test_tls(tmp_path: Path) -> None:
    """Under a certificate of one's own: answers over TLS alone, and tells browsers to stay with it."""
    served = Served("--data", str(tmp_path), "--tls-certificate", str(CERTIFICATE), "--tls-key", str(KEY))
    try:
        url = served.told["url"]
        assert url.startswith("https://127.0.0.1:")
        trusting = ssl.create_default_context(cafile=str(CERTIFICATE))
        answer = httpx2.get(f"{url}/healthz", verify=trusting)
        assert (answer.status_code, answer.headers["strict-transport-security"]) == (200, "max-age=31536000")
        with pytest.raises(httpx2.TransportError):
            httpx2.get(f"{url}/healthz", verify=ssl.create_default_context())
        with pytest.raises(httpx2.TransportError):
            httpx2.get(url.replace("https", "http") + "/healthz")
        environment = os.environ | {"SSL_CERT_FILE": str(CERTIFICATE)}
        command = [*JOULEBOX, "device", "list", "--data", str(tmp_path)]
        listed = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60)
        assert (listed.returncode, "no device yet" in listed.stdout) == (0, True), listed.stderr
    finally:
        served.stop()


def test_one_server_a_data_folder(tmp_path: Path, refused: Refused) -> None:
    """A second is refused and takes nothing from the first; after a kill the folder is free again."""
    first = Served("--data", str(tmp_path))
    try:
        url = first.told["url"]
        assert f"another server at {url} uses the data folder" in refused(1, "--data", str(tmp_path))
        assert json.loads((tmp_path / "server.json").read_text())["url"] == url
        assert httpx2.get(f"{url}/readyz").status_code == 200
    finally:
        first.process.kill()
        first.process.communicate()
    assert "Traceback" not in Served("--data", str(tmp_path)).stop()


def test_the_request_log_is_renewed(tmp_path: Path) -> None:
    """Every line is in the log or in the ones before it; none is longer than it may be."""
    log = logging.getLogger("joulebox.requests")
    lines = [f"line {number} {'x' * 1000}" for number in range(35)]
    path = tmp_path / "requests.log"
    path.write_text("from an earlier run\n" * 100)
    limit = serving.LONGEST_LOG_BYTES
    serving.LONGEST_LOG_BYTES = 15_000
    try:
        with serving.request_log(path):
            for line in lines:
                log.info(line)
    finally:
        serving.LONGEST_LOG_BYTES = limit
    files = [tmp_path / f"requests.log{suffix}" for suffix in (".3", ".2", ".1", "")]
    kept = "".join(file.read_text() for file in files if file.exists())
    assert kept == "from an earlier run\n" * 100 + "".join(f"{line}\n" for line in lines)
    assert sum(file.exists() for file in files) == 3
    assert all(file.stat().st_size <= 15_000 for file in files if file.exists())


def test_files_of_tls_that_cannot_be_used(refused: Refused, tmp_path: Path) -> None:
    data = ("--data", str(tmp_path))
    assert "belong together" in refused(2, *data, "--tls-key", str(KEY))
    assert "cannot be used" in refused(2, *data, "--tls-certificate", str(tmp_path / "none"), "--tls-key", str(KEY))
    assert "cannot be used" in refused(2, *data, "--tls-certificate", str(KEY), "--tls-key", str(CERTIFICATE))
    assert not (tmp_path / "joulebox.db").exists()


def test_secrets_are_in_no_log(tmp_path: Path) -> None:
    """A whole session, its errors and a fault of the server: neither log, stream nor database shows a secret."""
    secret = "the-shared-secret-of-this-test"
    (tmp_path / "secret").write_text(secret)
    served = Served("--data", str(tmp_path / "data"), "--enrollment-secret-file", str(tmp_path / "secret"))
    token = served.told["operator_token"]
    operator = {"Authorization": f"Bearer {token}"}
    with httpx2.Client(base_url=served.told["url"], timeout=30) as client:
        code = client.post("/v1/enrollments", headers=operator, json={}).json()["code"]
        body = {"code": secret, "name": "shared", "boot_id": "1"}
        shared = client.post("/v1/devices", json=body).json()["token"]
        assert client.post("/v1/devices", json=body).status_code == 409
        device = FakeDevice.enroll(client, operator, "laptop")
        rotated = client.post("/v1/devices/laptop/token", headers=operator).json()["token"]
        old, device.token = device.token, rotated
        assert client.get("/v1/scenes", headers={"Authorization": f"Bearer {old}"}).status_code == 401
        assert client.get("/v1/scenes", headers={"Authorization": f"Basic {rotated}"}).status_code == 401
        client.post("/v1/scenes?name=box", content=scene_zip(), headers=operator)
        assert client.post("/v1/sweeps", json=sweep(), headers=operator).status_code == 201
        assert device.work() == 6
        broken = next((tmp_path / "data" / "blobs").rglob("*/*"))
        broken.unlink()
        broken.mkdir()  # a fault: a folder where a file should be
        client.get(f"/v1/images/{broken.name}.png", headers=operator)
    said = served.stop()
    log = (tmp_path / "data" / "requests.log").read_text()
    lines = [json.loads(line) for line in log.splitlines()]
    assert len(lines) > 25 and len({line["request_id"] for line in lines}) == len(lines)
    stored = (tmp_path / "data" / "joulebox.db").read_bytes().decode(errors="replace")
    for hidden in (token, secret, code, shared, old, rotated):
        assert hidden not in log
        assert hidden not in said
        assert hidden not in stored  # hashes only


def test_a_request_log_that_cannot_be_written(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    data = ("--data", str(tmp_path / "data"))
    assert "cannot be written" in refused(1, *data, "--request-log", str(tmp_path / "file" / "log"))
