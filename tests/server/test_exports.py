"""Results in every format, backups and their way back, wheels for devices, and how the server tells of requests."""

import json
import logging
import os
import shlex
import shutil
import socket
import sqlite3
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from arro3.io import read_parquet
from joulebox_server.errors import ConflictError, InvalidError
from joulebox_server.routes.wheels import join_command
from joulebox_server.store import Store, upkeep
from joulebox_server.store.database import number
from joulebox_server.store.results import COLUMNS
from server_testing import Server, listening, serving
from test_errors import told


def test_parquet_holds_what_json_holds(server: Server, tmp_path: Path) -> None:
    sweep = server.add_sweep(repeats=1)
    server.device().work()
    server.wait(sweep["id"], "done")
    answer = server.client.get("/v1/results", params={"format": "parquet"})
    assert answer.headers["content-type"] == "application/vnd.apache.parquet"
    (tmp_path / "results.parquet").write_bytes(answer.content)
    table = read_parquet(tmp_path / "results.parquet").read_all()
    assert tuple(table.column_names) == COLUMNS
    found = {name: table.column(name).to_pylist() for name in COLUMNS}
    rows = server.get("/results")["items"]
    assert [{name: found[name][index] for name in COLUMNS} for index in range(len(rows))] == rows
    assert list(server.store.incoming_dir.iterdir()) == []


def test_parquet_of_nothing_and_of_many_batches(
    server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def table(**params: str) -> Any:
        (tmp_path / "some.parquet").write_bytes(server.client.get("/v1/results", params=params).content)
        return read_parquet(tmp_path / "some.parquet").read_all()

    assert table(format="parquet").num_rows == 0
    monkeypatch.setattr("joulebox_server.store.results.BATCH", 3)
    sweep = server.add_sweep(axes={"gather_count": [1, 2, 3, 4, 5]}, repeats=1)
    server.device().work()
    assert table(format="parquet", sweep=sweep["id"]).num_rows == 7
    lines = server.client.get("/v1/results", params={"format": "csv"}).text.splitlines()
    assert len(lines) == 8


def test_a_backup_comes_back(tmp_path: Path, executor: Any) -> None:
    """Everything is as it was; what is damaged is said, and nothing is written over."""
    with serving(tmp_path / "data", executor) as server:
        server.add_scene()
        sweep = server.add_sweep(repeats=1)
        server.device().work()
        server.wait(sweep["id"], "done")
        before = server.get("/results")
        upkeep.back_up(server.store, tmp_path / "backup")
    restored = upkeep.restore(tmp_path / "backup", tmp_path / "new")
    assert (restored.blobs > 4, restored.missing) == (True, [])
    with serving(tmp_path / "new", executor) as server:
        assert server.get("/results") == before
        assert server.get(f"/sweeps/{sweep['id']}/tradeoff")["points"]
    with pytest.raises(ConflictError, match="holds a server's data already"):
        upkeep.restore(tmp_path / "backup", tmp_path / "new")
    with pytest.raises(InvalidError, match=r"holds no joulebox\.db"):
        upkeep.restore(tmp_path / "nothing", tmp_path / "newer")
    victim = next(path for path in (tmp_path / "backup" / "blobs").rglob("*") if path.is_file())
    victim.write_bytes(b"damaged")
    assert upkeep.restore(tmp_path / "backup", tmp_path / "newer").missing == [victim.name]
    broken = tmp_path / "backup" / "joulebox.db"
    broken.write_bytes(broken.read_bytes()[:5000] + b"x" * 3000)
    with pytest.raises(InvalidError, match="damaged"):
        upkeep.restore(tmp_path / "backup", tmp_path / "newest")
    assert not (tmp_path / "newest" / "joulebox.db").exists()


def test_a_first_release_opens(tmp_path: Path, executor: Any) -> None:
    """A database of the first release, made by its code: everything in it is still there, and work goes on."""
    source = Path(__file__).parents[1] / "fleet" / "data" / "first_release.sql"
    connection = sqlite3.connect(tmp_path / "joulebox.db")
    connection.executescript(source.read_text(encoding="utf-8"))
    counted = {
        table: connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
        for table in ("device", "scene", "sweep", "job", "attempt", "result", "stage", "comparison", "event", "token")
    }
    connection.close()
    assert (counted["result"], counted["job"], counted["attempt"]) == (4, 7, 6)
    store = Store(tmp_path)
    assert {table: store.read(number, f"SELECT count(*) FROM {table}") for table in counted} == counted
    assert store.read(lambda db: db.execute("PRAGMA integrity_check").fetchone()[0]) == "ok"
    assert store.read(lambda db: db.execute("PRAGMA foreign_key_check").fetchall()) == []
    assert store.write(lambda db: db.execute("PRAGMA foreign_keys").fetchone()[0]) == 1
    store.close()
    with serving(tmp_path, executor) as server:
        sweeps = {sweep["name"]: sweep for sweep in server.get("/sweeps")["items"]}
        assert (sweeps["small"]["state"], sweeps["small"]["jobs"]["done"]) == ("done", 4)
        assert len(server.get(f"/sweeps/{sweeps['small']['id']}/tradeoff")["points"]) == 2
        (laptop,) = server.get("/devices")["items"]
        assert (laptop["health"], laptop["capabilities"]["renderer"]) == ("good", {"name": "fake", "version": "1"})
        server.clock.ahead_s = 10_000_000
        rotated = server.client.post("/v1/devices/laptop/token", headers=server.operator).json()
        server.add_scene()
        device = server.device("fresh")
        device.device_id, device.token = rotated["device_id"], rotated["token"]
        assert device.work() == 3
        assert server.get(f"/sweeps/{sweeps['second']['id']}")["jobs"]["done"] == 3


def test_wheels(tmp_path: Path, executor: Any) -> None:
    """pip's page of links, with hashes; nothing else of the folder is given out."""
    folder = tmp_path / "wheels"
    folder.mkdir()
    names = ["joulebox_agent-0.1.0-py3-none-any.whl", "joulebox_render-0.1.0-py3-none-any.whl"]
    for name in [*names, "secret.txt", "joulebox_server-0.1.0-py3-none-any.whl"]:
        (folder / name).write_bytes(name.encode())
    with serving(tmp_path / "data", executor, wheels_dir=folder) as server:
        page = server.client.get("/wheels/").text
        assert [name for name in names if f'href="{name}#sha256=' in page] == names
        assert "secret" not in page and "joulebox_server" not in page
        assert server.client.get(f"/wheels/{names[0]}").content == names[0].encode()
        for other in ("secret.txt", "..%2fdata%2fjoulebox.db", "joulebox_server-0.1.0-py3-none-any.whl"):
            assert server.client.get(f"/wheels/{other}").status_code == 404
        told(server.client.get("/wheels/secret.txt"), 404, "not_found", "make wheels")
        code = server.client.post("/v1/enrollments", headers=server.operator, json={}).json()
        assert code["join"] == (
            "python3 -m venv ~/.joulebox && . ~/.joulebox/bin/activate"
            " && python3 -m pip install --find-links http://127.0.0.1/wheels/"
            " joulebox-agent==0.1.0 joulebox-render==0.1.0"
            f" && joulebox-agent enroll --server http://127.0.0.1 --code {code['code']} && joulebox-agent doctor"
        )
        (folder / names[1]).unlink()  # half of what a device needs is nothing it could install
        assert "pip" not in server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["join"]
        shutil.rmtree(folder)
        assert "pip" not in server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["join"]


def test_pip_finds_the_wheels(tmp_path: Path, executor: Any) -> None:
    """The line that a device runs, as far as it is ours: pip takes both wheels from the server, hashes checked."""
    folder = tmp_path / "wheels"
    folder.mkdir()
    for name in ("joulebox_agent", "joulebox_render"):
        with zipfile.ZipFile(folder / f"{name}-0.1.0-py3-none-any.whl", "w") as wheel:
            inside = f"{name}-0.1.0.dist-info"
            wheel.writestr(f"{inside}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
            wheel.writestr(f"{inside}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
            wheel.writestr(f"{inside}/RECORD", "")
    with listening(tmp_path / "data", executor, wheels_dir=folder) as server:
        line = server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["join"]
        words = shlex.split(line.split("&&")[2])
        assert words[:4] == ["python3", "-m", "pip", "install"]
        quiet = ["--quiet", "--disable-pip-version-check", "--no-index", "--no-deps", "--dest", str(tmp_path / "got")]
        command = [sys.executable, "-m", "pip", "download", *quiet, *words[4:]]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
        done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (tmp_path / "got").iterdir()) == sorted(path.name for path in folder.iterdir())


def test_the_line_for_another_machine(tmp_path: Path) -> None:
    """pip passes over plain HTTP of other machines unless told to trust them; it takes the newest here."""
    for name in ("agent-0.9", "render-0.9", "render-0.10", "render-x.y"):
        (tmp_path / f"joulebox_{name}-py3-none-any.whl").touch()
    assert " joulebox-agent==0.9 joulebox-render==0.10 " in join_command(tmp_path, "https://lab.example", "A-B-C")
    assert "--trusted-host lab.example" in join_command(tmp_path, "http://lab.example:8473", "A-B-C")
    assert "--trusted-host" not in join_command(tmp_path, "https://lab.example:8473", "A-B-C")


def test_the_line_names_the_machine_when_others_may_come(tmp_path: Path, executor: Any) -> None:
    """Asked from the server's own machine, under an address that would lead a device to itself."""
    with serving(tmp_path, executor, host="0.0.0.0") as server:
        line = server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["join"]
        assert f"--server http://{socket.gethostname()} " in line


def test_a_line_for_each_request(server: Server, caplog: pytest.LogCaptureFixture) -> None:
    """With the id that the answer carries; never a token, a code, a query or a body."""
    device = server.device()
    caplog.set_level(logging.INFO, "joulebox.requests")
    caplog.clear()  # whether the device's own requests were heard depends on who set the level before
    code = server.client.post("/v1/enrollments", headers=server.operator, json={"name": "hush-hush"}).json()["code"]
    answer = server.client.post("/v1/devices", json={"code": code, "name": "phone", "boot_id": "hush-boot"})
    wrong = server.client.get("/v1/results?sweep=hush-query", headers={"Authorization": "Bearer jb_hush"})
    device.lease()
    lines = [json.loads(record.getMessage()) for record in caplog.records if record.name == "joulebox.requests"]
    assert [(line["method"], line["path"], line["status"], line["role"]) for line in lines] == [
        ("POST", "/v1/enrollments", 201, "operator"),
        ("POST", "/v1/devices", 201, None),
        ("GET", "/v1/results", 401, None),
        ("POST", "/v1/leases", 204, "device"),
    ]
    assert lines[1]["request_id"] == answer.headers["x-request-id"]
    assert lines[2]["request_id"] == wrong.json()["request_id"]
    assert lines[3]["device_id"] == device.device_id
    secrets = [code, answer.json()["token"], device.token, server.operator["Authorization"], "hush"]
    assert [secret for secret in secrets if secret.split()[-1] in caplog.text] == []


def test_headers_of_every_answer(server: Server) -> None:
    for path in ("/v1/sweeps", "/v1/nothing", "/healthz", "/", "/docs", "/v1/blobs/x"):
        headers = server.client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff", path
        assert "frame-ancestors 'none'" in headers["content-security-policy"], path
        assert "unsafe" not in headers["content-security-policy"], path
        assert headers["x-request-id"], path
        assert "cache-control" in headers, path
    assert server.client.get("/v1/sweeps").headers["cache-control"] == "no-store"


def test_wrong_codes_are_limited(server: Server) -> None:
    """Ten a minute; then even a good code waits, and the answer says how long."""
    body = {"code": "WRNG-WRNG-WRNG", "name": "x", "boot_id": "b"}
    for _ in range(10):
        assert server.client.post("/v1/devices", json=body).status_code == 401
    answer = server.client.post("/v1/devices", json=body)
    told(answer, 429, "too_many", "try again in")
    assert 1 <= int(answer.headers["retry-after"]) <= 60
    code = server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["code"]
    assert server.client.post("/v1/devices", json=body | {"code": code}).status_code == 429
    server.app.state.services.enrolling._clock = lambda: 1e12
    assert server.client.post("/v1/devices", json=body | {"code": code}).status_code == 201


def test_measurements_tell_jobs_differences_and_whole_documents(server: Server) -> None:
    """More than a batch of the store's, oldest first; those of another sweep are not among them."""
    server.device().work()
    counts = list(range(1, 55))
    sweeps = [server.add_sweep(axes={"gather_count": wanted}, repeats=1) for wanted in ([7], counts)]
    server.device("second").work()
    for sweep in sweeps:
        server.wait(sweep["id"], "done")
    answer = server.client.get(f"/v1/sweeps/{sweeps[1]['id']}/measurements")
    assert answer.headers["content-type"] == "application/x-ndjson"
    found = [json.loads(line) for line in answer.text.splitlines()]
    assert [told["id"] for told in found] == sorted(told["id"] for told in found)
    measured = [told for told in found if told["purpose"] == "measure"]
    assert sorted(told["document"]["settings"]["gather_count"] for told in measured) == counts
    assert len(found) == len(counts) + 2
    assert all(told["difference"] >= 0 and len(told["delta_sha256"]) == 64 for told in measured)
    (reference,) = [told for told in found if told["purpose"] == "reference"]
    assert (reference["difference"], reference["reference_sha256"]) == (None, None)
    assert {told["reference_sha256"] for told in measured} == {reference["document"]["image_blob"]}
    assert {told["scene"] for told in found} == {"box"}
    assert server.client.get("/v1/sweeps/none/measurements").status_code == 404
