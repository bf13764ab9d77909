"""Blobs and the store under them: digests, ranges, a full disk, deleting without leaving files behind."""

import errno
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import pytest
from fake_device import scene_zip, sha256
from joulebox_server.store import Store, blobs, tokens, upkeep
from server_testing import Server
from test_errors import told

CONTENT = bytes(range(256)) * 40


def put(server: Server, content: bytes, name: str | None = None) -> Any:
    return server.client.put(f"/v1/blobs/{name or sha256(content)}", content=content, headers=server.operator)


def files(server: Server) -> set[str]:
    return {path.name for path in server.store.blob_dir.rglob("*") if path.is_file()}


def test_put_get_head_range(server: Server) -> None:
    path = f"/v1/blobs/{sha256(CONTENT)}"
    assert server.client.head(path).status_code == 404
    assert put(server, CONTENT).status_code == 201
    assert put(server, CONTENT).status_code == 200
    head = server.client.head(path)
    assert (head.status_code, head.headers["content-length"], head.content) == (200, str(len(CONTENT)), b"")
    whole = server.client.get(path)
    assert whole.content == CONTENT
    assert whole.headers["etag"] == f'"{sha256(CONTENT)}"'
    part = server.client.get(path, headers={"Range": "bytes=100-199"})
    assert (part.status_code, part.content) == (206, CONTENT[100:200])
    assert part.headers["content-range"] == f"bytes 100-199/{len(CONTENT)}"
    beyond = server.client.get(path, headers={"Range": "bytes=99999-"})
    told(beyond, 416, "range_not_satisfiable", f"within the blob's {len(CONTENT)} bytes")
    assert beyond.headers["content-range"] == f"bytes */{len(CONTENT)}"
    told(server.client.get(path, headers={"Range": "lines=0-1"}), 400, "http_error", "bytes=0-99")


def test_a_blob_is_sent_only_to_those_who_lack_it(server: Server) -> None:
    path = f"/v1/blobs/{sha256(CONTENT)}"
    put(server, CONTENT)
    known = server.client.get(path, headers={"If-None-Match": server.client.get(path).headers["etag"]})
    assert (known.status_code, known.content) == (304, b"")
    assert server.client.get(path, headers={"If-None-Match": f'"{"0" * 64}"'}).content == CONTENT


def png(width: int, height: int) -> bytes:
    """A PNG that says it is so large, of which a row is there."""
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(100))))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in (*chunks, (b"IEND", b""))
    )


def test_a_picture_that_would_burst_whoever_opens_it(server: Server) -> None:
    """A PNG goes to the browser as it is, so one of a few bytes that says it is enormous or is cut off goes nowhere."""
    good, enormous = png(32, 1), png(60_000, 60_000)
    for content in (good, enormous, good[:-4]):
        assert put(server, content).status_code == 201
    assert server.client.get(f"/v1/images/{sha256(good)}.png").content == good
    refused = server.client.get(f"/v1/images/{sha256(enormous)}.png")
    problem = told(refused, 422, "invalid", "is 60000 x 60000 pixels, it must have at most 16,384 on a side")
    assert f"the blob {sha256(enormous)}" in problem["detail"]
    told(server.client.get(f"/v1/images/{sha256(good[:-4])}.png"), 422, "invalid", "is a truncated PNG file")


def test_wrong_digest_leaves_nothing(server: Server) -> None:
    before = files(server)
    problem = told(put(server, CONTENT, "1" * 64), 422, "wrong_digest", "send them again")
    assert sha256(CONTENT) in problem["detail"]
    assert files(server) == before
    assert not any(server.store.incoming_dir.iterdir())


@pytest.mark.parametrize("where", ["write", "fsync", "replace"])
def test_full_disk(server: Server, monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    """507 with Retry-After wherever the disk fills up, nothing half stored, and all is well afterwards."""

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        if where == "write":
            patched.setattr(blobs.Incoming, "write", lambda *_: blobs_full(full))
        else:
            patched.setattr(blobs.os, where, full)
        told(put(server, CONTENT), 507, "storage_full", "disk is full")
    assert server.client.head(f"/v1/blobs/{sha256(CONTENT)}").status_code == 404
    assert not any(server.store.incoming_dir.iterdir())
    assert put(server, CONTENT).status_code == 201


def blobs_full(full: Any) -> None:
    with blobs.disk():
        full()


def test_full_database(server: Server) -> None:
    """When SQLite cannot grow, the request fails as a whole and later ones succeed."""

    def shrink(db: Any) -> None:
        db.execute("PRAGMA max_page_count = 1")

    def grow(db: Any) -> None:
        db.execute("PRAGMA max_page_count = 1000000")

    server.store.write(shrink)
    answers = [put(server, bytes([i]) * 10) for i in range(120)]
    refused = [answer for answer in answers if answer.status_code != 201]
    assert refused
    for answer in refused:
        told(answer, 507, "storage_full", "disk is full")
    server.store.write(grow)
    assert put(server, CONTENT).status_code == 201
    kept = [i for i, answer in enumerate(answers) if answer.status_code == 201]
    for i in kept:
        assert server.client.head(f"/v1/blobs/{sha256(bytes([i]) * 10)}").status_code == 200


def test_lost_file_counts_as_absent(server: Server) -> None:
    """A row without its file (a crash between) is no blob: it can be sent again."""
    put(server, CONTENT)
    blobs.path(server.store.blob_dir, sha256(CONTENT)).unlink()
    assert server.client.head(f"/v1/blobs/{sha256(CONTENT)}").status_code == 404
    assert put(server, CONTENT).status_code == 201
    assert server.client.get(f"/v1/blobs/{sha256(CONTENT)}").content == CONTENT


def test_deleting_a_sweep_removes_what_only_it_used(server: Server) -> None:
    before = files(server)
    device = server.device()
    sweeps = [server.add_sweep(axes={"gather_count": [5]}, repeats=1), server.add_sweep(axes={}, repeats=1)]
    device.work()
    for sweep in sweeps:
        server.wait(sweep["id"], "done")
    after_both = files(server)
    assert server.client.delete(f"/v1/sweeps/{sweeps[0]['id']}", headers=server.operator).status_code == 204
    assert before < files(server) < after_both
    # the second sweep has the same reference: its pictures and values are all there still
    found = server.get(f"/sweeps/{sweeps[1]['id']}/tradeoff")
    assert found["noise_floor"]
    for name in (found["points"][0]["image_sha256"], found["points"][0]["reference_image_sha256"]):
        assert server.client.head(f"/v1/blobs/{name}").status_code == 200
    server.client.delete(f"/v1/sweeps/{sweeps[1]['id']}", headers=server.operator)
    assert files(server) == before
    assert server.get("/results")["items"] == []


def test_a_sweep_being_measured_is_not_deleted(server: Server) -> None:
    sweep = server.add_sweep()
    server.device().lease()
    told(server.client.delete(f"/v1/sweeps/{sweep['id']}", headers=server.operator), 409, "conflict", "cancel it")


def test_gc_and_backup(server: Server, tmp_path: Path) -> None:
    put(server, CONTENT)
    (server.store.incoming_dir / "left").write_bytes(b"half")
    assert upkeep.collect(server.store, grace_s=3600) == 0
    folder = tmp_path / "backup"
    assert upkeep.back_up(server.store, folder) == 2
    assert upkeep.back_up(server.store, folder) == 0
    restored = Store(folder)
    assert restored.read(tokens.people_count, valid=True) == 2
    assert restored.read(blobs.find, restored.blob_dir, sha256(CONTENT)).read_bytes() == CONTENT
    restored.close()
    assert upkeep.collect(server.store, grace_s=-1) == 1  # the scene's bundle is referred to and stays
    assert files(server) == {sha256(scene_zip())}
    assert not any(server.store.incoming_dir.iterdir())


def test_secrets_are_not_at_rest(server: Server) -> None:
    """Neither tokens nor enrolment codes stand anywhere in the database's files."""
    device = server.device()
    code = server.client.post("/v1/enrollments", headers=server.operator, json={}).json()["code"]
    secrets = [device.token, code, server.operator["Authorization"].split()[1]]
    at_rest = b"".join(path.read_bytes() for path in server.store.path.parent.glob("joulebox.db*"))
    for secret in secrets:
        assert secret.encode() not in at_rest
        assert sha256(secret.encode()).encode() in at_rest
