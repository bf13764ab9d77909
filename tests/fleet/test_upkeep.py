"""Upkeep beside a fleet at work, and a server killed while it brings an old database up to date."""

import hashlib
import os
import signal
import sqlite3
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from fake_device import FakeDevice
from joulebox_agent.fleet.delivery import Delivery
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.server import Server as Client
from joulebox_agent.fleet.spool import Entry, Spool
from joulebox_server.store import Store, blobs, upkeep
from joulebox_server.store.database import number, rows
from seeded import result_of
from server_testing import Server, listening

FIRST_RELEASE = Path(__file__).parent / "data" / "first_release.sql"
DEVICES, JOBS_EACH = 3, 6


def deliver_everything(server: Server, device: FakeDevice, spool: Path) -> list[dict[str, Any]]:
    """Work by the agent's own spool, delivery and client; returns what its journal says."""
    said: list[dict[str, Any]] = []
    client = Client(str(server.client.base_url), device.token, quick_wait_s=0.01)
    delivery = Delivery(Spool(spool), client, Journal(said.append))
    while True:
        leases, _ = client.lease("boot-1", {}, 0)
        if not leases:
            client.close()
            return said
        picture = f"picture of {leases[0].job_id}".encode() * 1000
        sha256 = hashlib.sha256(picture).hexdigest()
        document = result_of(leases[0].model_dump(), image_blob=sha256)
        delivery.keep(Entry(attempt_id=leases[0].attempt_id, document=document, blobs=(sha256,)), {sha256: picture})
        delivery.send_all()


def test_backups_and_collections_beside_a_fleet_at_work(tmp_path: Path, executor: Any) -> None:
    """No collection takes a blob that a result names; every backup is whole in itself, whenever it was taken."""
    with listening(tmp_path / "data", executor) as server:
        devices = [server.device(f"device {index}") for index in range(DEVICES)]
        for device in devices:
            server.add_sweep(
                name=device.device_id,
                devices=[device.device_id],
                axes={"global_photons": list(range(10_000, 10_000 + JOBS_EACH))},
                repeats=1,
            )
        said: list[dict[str, Any]] = []
        working = [
            threading.Thread(target=lambda d=device: said.extend(deliver_everything(server, d, tmp_path / d.device_id)))
            for device in devices
        ]
        for thread in working:
            thread.start()
        backups = []
        while any(thread.is_alive() for thread in working):
            backups.append(tmp_path / f"backup {len(backups)}")
            upkeep.back_up(server.store, backups[-1])
            upkeep.collect(server.store, grace_s=0.5)
        for thread in working:
            thread.join()
        assert [record for record in said if record["event"] != "delivered"] == []
        upkeep.collect(server.store, grace_s=-1)
        count = whole_results(server.store)
        assert count >= DEVICES * JOBS_EACH
        assert not any(list((tmp_path / device.device_id).glob("*.json")) for device in devices)
    for folder in backups:
        restored = Store(folder)
        whole_results(restored)
        assert restored.read(lambda db: db.execute("PRAGMA integrity_check").fetchone()[0]) == "ok"
        restored.close()


def whole_results(store: Store) -> int:
    """How many results there are; every picture that one names must be there."""
    named = [found["image_sha256"] for found in store.read(rows, "SELECT image_sha256 FROM result")]
    for sha256 in named:
        path = store.read(blobs.find, store.blob_dir, sha256)
        assert hashlib.sha256(path.read_bytes()).hexdigest() == sha256
    return len(named)


def killed_at(folder: Path, statement: int) -> bool:
    """Open a store in a child that dies at this statement of its migrations; whether it did."""
    pid = os.fork()
    if not pid:
        connect = Store._connect
        left = statement

        def dying(store: Store) -> Any:
            db = connect(store)

            def count(_: str) -> None:
                nonlocal left
                left -= 1
                if not left:
                    os.kill(os.getpid(), signal.SIGKILL)

            db.conn.set_trace_callback(count)
            return db

        Store._connect = dying  # type: ignore[method-assign]
        try:
            Store(folder)
        finally:
            os._exit(0)
    return os.WTERMSIG(os.waitpid(pid, 0)[1]) == signal.SIGKILL


@pytest.mark.skipif(sys.platform == "win32", reason="processes are forked, which Windows cannot")
def test_a_server_killed_while_it_migrates(tmp_path: Path) -> None:
    """Whatever was done is undone: the next start finds the first release's data and brings all of it along."""
    script = FIRST_RELEASE.read_text(encoding="utf-8")
    statement, killed = 1, 0
    while True:
        folder = tmp_path / str(statement)
        folder.mkdir()
        with sqlite3.connect(folder / "joulebox.db") as made:
            made.executescript(script)
        made.close()
        died = killed_at(folder, statement)
        store = Store(folder)
        assert store.read(number, "SELECT count(*) FROM result") == 4
        assert store.read(number, "SELECT count(*) FROM job") == 7
        assert store.read(lambda db: db.execute("PRAGMA foreign_key_check").fetchall()) == []
        assert store.read(number, "SELECT count(*) FROM picture_check") == 0
        store.close()
        if not died:
            break
        killed += 1
        statement += 5
    assert killed > 10
