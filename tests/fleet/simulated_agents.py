"""Many agents in one process, as light as can be: a connection each, lease and result over and over, a ledger.

    python simulated_agents.py HOST PORT SECONDS BLOBS < devices.json > ledger.json

reads the devices (name, device_id, token) from standard input and writes what every agent saw. It speaks
HTTP/1.1 on bare sockets: half of the machine is the server's, and a client library would take most of the rest.
"""

import asyncio
import hashlib
import json
import os
import sys
import time
from dataclasses import dataclass, field
from typing import Any

from seeded import result_of

BLOB_BYTES = 100_000


@dataclass
class Ledger:
    """What an agent was told: the truth that the server's database is held against."""

    leased: list[str] = field(default_factory=list)
    """Attempts."""
    jobs: list[str] = field(default_factory=list)
    acknowledged: list[str] = field(default_factory=list)
    lease_s: list[float] = field(default_factory=list)
    result_s: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)


class Connection:
    """One keep-alive connection."""

    def __init__(self, host: str, port: int, token: str) -> None:
        self.host, self.port = host, port
        self.headers = f"Host: {host}:{port}\r\nAuthorization: Bearer {token}\r\n"

    async def open(self) -> None:
        self.reader, self.writer = await asyncio.open_connection(self.host, self.port)

    async def ask(self, method: str, path: str, body: bytes = b"", kind: str = "application/json") -> tuple[int, bytes]:
        head = f"{method} {path} HTTP/1.1\r\n{self.headers}Content-Type: {kind}\r\nContent-Length: {len(body)}\r\n\r\n"
        self.writer.write(head.encode() + body)
        await self.writer.drain()
        answer = await self.reader.readuntil(b"\r\n\r\n")
        status, length = int(answer[9:12]), 0
        for line in answer.lower().split(b"\r\n"):
            if line.startswith(b"content-length:"):
                length = int(line[15:])
        return status, await self.reader.readexactly(length) if length else b""


async def agent(connection: Connection, ends_s: float, blobs: int, ledger: Ledger) -> None:
    """Lease and deliver until `ends_s`; whatever is not as it should be becomes a line of `errors`."""
    asked = json.dumps({"boot_id": "boot-1", "conditions": {}, "max_jobs": 1, "wait_s": 0, "holding": []}).encode()
    await connection.open()
    while time.perf_counter() < ends_s:
        began_s = time.perf_counter()
        status, body = await connection.ask("POST", "/v1/leases", asked)
        ledger.lease_s.append(time.perf_counter() - began_s)
        if status != 200:
            ledger.errors.append(f"lease: {status} {body[:200]!r}")
            return
        (lease,) = json.loads(body)["leases"]
        ledger.leased.append(lease["attempt_id"])
        ledger.jobs.append(lease["job_id"])
        changes: dict[str, Any] = {}
        for name in ("image_blob", "power_samples")[:blobs]:
            content = os.urandom(32) * (BLOB_BYTES // 32)
            changes[name] = hashlib.sha256(content).hexdigest()
            status, body = await connection.ask(
                "PUT", f"/v1/blobs/{changes[name]}", content, "application/octet-stream"
            )
            if status != 201:
                ledger.errors.append(f"blob: {status} {body[:200]!r}")
        document = json.dumps(result_of(lease, **changes)).encode()
        began_s = time.perf_counter()
        status, body = await connection.ask("PUT", f"/v1/attempts/{lease['attempt_id']}/result", document)
        ledger.result_s.append(time.perf_counter() - began_s)
        if status == 201:
            ledger.acknowledged.append(lease["attempt_id"])
        else:
            ledger.errors.append(f"result: {status} {body[:200]!r}")


async def run(host: str, port: int, seconds: float, blobs: int, devices: list[dict[str, str]]) -> dict[str, Any]:
    """All agents for so many seconds; their ledgers together."""
    ledgers = [Ledger() for _ in devices]
    began_s = time.perf_counter()
    await asyncio.gather(
        *(
            agent(Connection(host, port, device["token"]), began_s + seconds, blobs, ledger)
            for device, ledger in zip(devices, ledgers, strict=True)
        )
    )
    joined: dict[str, Any] = {
        name: [entry for ledger in ledgers for entry in getattr(ledger, name)] for name in Ledger.__dataclass_fields__
    }
    return joined | {"time_s": time.perf_counter() - began_s, "cpu_s": time.process_time()}


def main() -> None:
    host, port, seconds, blobs = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
    json.dump(asyncio.run(run(host, port, seconds, blobs, json.load(sys.stdin))), sys.stdout)


if __name__ == "__main__":
    main()
