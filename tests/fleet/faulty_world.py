"""A server, an agent and a wire between them, each a process that may be killed, with faults to be switched on.

The server is the real application, the agent's parts are the real spool, delivery and client; only measuring is
left out. Faults are words in a file that every process reads as it goes: `clock` steps the server's clock, `full`
fills a disk, `cut`, `twice` and `flip` are what the wire does. Forked, not started anew: a killed process is back
in a moment. POSIX only.
"""

import asyncio
import contextlib
import errno
import hashlib
import json
import os
import random
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import stamina.instrumentation
import uvicorn
from joulebox_agent.errors import ServerRefusedError, ServerUnreachableError
from joulebox_agent.fleet import spool as agent_spool
from joulebox_agent.fleet.delivery import Delivery
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.server import Server as Client
from joulebox_agent.fleet.spool import Entry, Spool
from joulebox_server.app import create_app
from joulebox_server.settings import ServerSettings
from joulebox_server.store import blobs as stored_blobs
from seeded import Device, result_of

HUNDREDTH_S = 0.01


@dataclass(frozen=True)
class Faults:
    """The switches, in a file that is replaced whole."""

    path: Path

    def set(self, **switches: Any) -> None:
        draft = self.path.with_suffix(".draft")
        draft.write_text(json.dumps(switches))
        draft.replace(self.path)

    def get(self, name: str) -> Any:
        return json.loads(self.path.read_text()).get(name, 0)


def forked(work: Callable[[], None]) -> int:
    """Run `work` in a child; returns its process id."""
    pid = os.fork()
    if not pid:
        _child(work)
    return pid


def _child(work: Callable[[], None]) -> NoReturn:
    code = 1
    try:
        work()
        code = 0
    finally:
        os._exit(code)  # nothing of the parent's is to be cleaned up here


def kill(pid: int) -> None:
    """As a power cut."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def serve(folder: Path, port: int, faults: Faults) -> None:
    """The server. Its clock is ahead by `clock` seconds, its disk is full while `full` is `server`."""

    def clock() -> int:
        return time.time_ns() // 1000 + int(faults.get("clock") * 1_000_000)

    def no_room(*_: Any, **__: Any) -> NoReturn:
        raise OSError(errno.ENOSPC, "No space left on device")

    settings = ServerSettings(
        data_dir=folder, port=port, release_pause_s=0, retry_pause_s=0, max_attempts=10**6, suspect_after=10**6
    )
    app = create_app(settings, ThreadPoolExecutor(1), clock)
    make_file = stored_blobs.tempfile.mkstemp

    async def fill_disk() -> None:
        full = False
        while True:
            if full != (faults.get("full") == "server"):
                full = not full
                stored_blobs.tempfile.mkstemp = no_room if full else make_file
                store = app.state.services.store
                pages = "1" if full else "1073741823"  # SQLite never goes below what there is
                await asyncio.to_thread(
                    store.write, lambda db, pages=pages: db.execute(f"PRAGMA max_page_count={pages}")
                )
            await asyncio.sleep(HUNDREDTH_S)

    async def main() -> None:
        server = uvicorn.Server(uvicorn.Config(app, port=port, log_level="critical", timeout_graceful_shutdown=1))
        running = asyncio.create_task(server.serve())
        while not server.started and not running.done():
            await asyncio.sleep(HUNDREDTH_S)
        filling = asyncio.create_task(fill_disk())
        await running
        filling.cancel()

    asyncio.run(main())


def measure_and_deliver(url: str, device: Device, state: Path, ledger: Path, faults: Faults, seed: int) -> None:
    """The agent. A line of `ledger` is a result that is safe in the spool: it must be in the server in the end."""
    chance = random.Random(seed)
    write = agent_spool.write_whole

    def hurried(path: Path, content: bytes) -> None:
        if faults.get("full") == "agent":
            raise OSError(errno.ENOSPC, "No space left on device")
        write(path, content)

    agent_spool.write_whole = hurried
    stamina.instrumentation.set_on_retry_hooks([])
    client = Client(url, device.token, timeout_s=5, quick_wait_s=0.01)
    delivery = Delivery(Spool(state), client, Journal(lambda record: None))
    delivery.spool.sweep()
    while True:
        try:
            delivery.send_all()
            if delivery.in_memory:
                time.sleep(0.02)
                continue
            leases, _ = client.lease("boot-1", {}, wait_s=0.1)
            for lease in leases:
                time.sleep(chance.choice((0, 0, 0.02)))
                _keep(delivery, lease.model_dump(), ledger)
        except (ServerUnreachableError, ServerRefusedError):
            time.sleep(0.02)


def _keep(delivery: Delivery, lease: dict[str, Any], ledger: Path) -> None:
    attempt = lease["attempt_id"]
    picture = f"picture of {lease['job_id']}".encode() * 200
    sha256 = hashlib.sha256(picture).hexdigest()
    pixels = hashlib.sha256(f"{attempt} {os.urandom(8).hex()}".encode()).hexdigest()
    document = result_of(lease, pixel_sha256=pixels, image_blob=sha256)
    delivery.keep(Entry(attempt_id=attempt, document=document, blobs=(sha256,)), {sha256: picture})
    if not delivery.in_memory:
        with ledger.open("a") as file:
            file.write(f"{attempt} {pixels}\n")
            file.flush()
            os.fsync(file.fileno())


def wire(port: int, server_port: int, faults: Faults, seed: int) -> None:
    """Carry bytes between agent and server, and do to them what the switches say, each as often as its share.

    cut    end a connection in the middle of what is sent or answered
    twice  send what was sent once more later, over a connection of its own: doubled and out of order
    flip   change a byte of a blob on its way
    """
    chance = random.Random(seed)
    sent: list[bytes] = []

    async def again() -> None:
        while True:
            await asyncio.sleep(0.05)
            if sent and chance.random() < faults.get("twice"):
                with contextlib.suppress(OSError, asyncio.TimeoutError):
                    reader, writer = await asyncio.open_connection("127.0.0.1", server_port)
                    writer.write(chance.choice(sent[-30:]))
                    await writer.drain()
                    await asyncio.wait_for(reader.read(1), 2)
                    writer.close()

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, out: bool) -> None:
        while data := await reader.read(1 << 16):
            if out:
                sent.append(data)
                del sent[:-100]
                if data.startswith(b"picture of") and chance.random() < faults.get("flip"):
                    data = data[:-1] + bytes([data[-1] ^ 1])
            if chance.random() < faults.get("cut"):
                writer.write(data[: chance.randrange(len(data))])
                raise ConnectionResetError
            writer.write(data)
            await writer.drain()

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers = [writer]
        with contextlib.suppress(OSError):
            server_reader, server_writer = await asyncio.open_connection("127.0.0.1", server_port)
            writers.append(server_writer)
            ways = [carry(reader, server_writer, True), carry(server_reader, writer, False)]
            tasks = [asyncio.create_task(way) for way in ways]
            _, open_ways = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in open_ways:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        for each in writers:
            each.close()

    async def main() -> None:
        listening = await asyncio.start_server(connected, "127.0.0.1", port)
        async with listening:
            await again()

    asyncio.run(main())
