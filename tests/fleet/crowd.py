"""A server with very many devices and results, and what the dashboard asks of it."""

import statistics
import time
from pathlib import Path
from typing import Any

import httpx2
from joulebox_server.store import Store
from joulebox_server.store.database import rows
from joulebox_server.store.ids import new_id, now_us
from seeded import Device, add_devices, add_scene, add_sweep, result_body

SWEEP_DEVICES = 10
SWEEP_JOBS = 100
"""Configurations of each sweep; its references and noise floors come on top."""
ASKED = (
    "/v1/sweeps?limit=50",
    "/v1/sweeps?limit=200",
    "/v1/devices?limit=200",
    "/v1/devices/device-0000",
    "/v1/sweeps/{sweep}",
    "/v1/sweeps/{sweep}/jobs?limit=200",
    "/v1/sweeps/{sweep}/tradeoff",
    "/v1/results?limit=200",
    "/v1/results?limit=200&sweep={sweep}",
    "/metrics",
)


def fill_crowd(folder: Path, device_count: int, result_count: int) -> tuple[list[Device], list[str]]:
    """Devices, and sweeps whose jobs are all done, until there are at least so many results."""
    store = Store(folder)
    add_scene(store)
    devices = add_devices(store, device_count)
    sweeps = []
    for number in range(-(-result_count // (SWEEP_DEVICES * SWEEP_JOBS))):
        first = number * SWEEP_DEVICES % len(devices)
        on = (devices + devices)[first : first + min(SWEEP_DEVICES, len(devices))]
        sweeps.append(add_sweep(store, f"sweep {number}", on, SWEEP_JOBS))
        store.write(_finish_all, sweeps[-1])
    store.close()
    return devices, sweeps


def _finish_all(db: Any, sweep_id: str) -> None:
    """Give every job of a sweep an attempt and a result, by bare statements: through the store it takes minutes."""
    found = rows(
        db,
        """SELECT job.id, job.seed, target.device_id FROM job JOIN target ON target.id = job.target_id
        WHERE job.sweep_id = ?""",
        (sweep_id,),
    )
    at_us = now_us()
    for job in found:
        lease = {
            "scene": {"name": "box", "bundle_sha256": "0" * 64},
            "settings": {"seed": job["seed"]},
            "measure": {"meter": True, "window_s": 1},
        }
        attempt_id, body = new_id(), result_body(lease).decode()
        db.execute(
            """INSERT INTO attempt (id, job_id, device_id, boot_id, state, conditions, leased_at_us, expires_at_us)
            VALUES (?, ?, ?, 'boot-1', 'finished', '{}', ?, ?)""",
            (attempt_id, job["id"], job["device_id"], at_us, at_us),
        )
        db.execute(
            """INSERT INTO result (id, attempt_id, job_id, sweep_id, device_id, body_sha256, document, accepted, method,
            quality, images, windows, time_us, time_low_us, time_high_us, energy_uj, energy_low_uj, energy_high_uj,
            received_at_us) VALUES (?, ?, ?, ?, ?, '', ?, 'ok', 'battery_gauge', 'measured', 50, 5, 1000, 990, 1010,
            10000, 9900, 10100, ?)""",
            (new_id(), attempt_id, job["id"], sweep_id, job["device_id"], body, at_us),
        )
    db.execute("UPDATE job SET state = 'done' WHERE sweep_id = ?", (sweep_id,))
    db.execute("UPDATE sweep SET state = 'done' WHERE id = ?", (sweep_id,))


def answers(port: int, sweep_id: str, times: int) -> dict[str, float]:
    """Median time [s] of each question, asked so often after a first time. Raises on an answer that is not good."""
    found = {}
    with httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=60) as client:
        for question in ASKED:
            path = question.replace("{sweep}", sweep_id)
            client.get(path).raise_for_status()
            waits_s = []
            for _ in range(times):
                began_s = time.perf_counter()
                client.get(path).raise_for_status()
                waits_s.append(time.perf_counter() - began_s)
            found[question] = statistics.median(waits_s)
    return found
