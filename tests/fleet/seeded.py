"""Data folders for the load tests: a scene, devices and sweeps, made through the store before a server starts."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fake_device import capabilities, measure_document
from joulebox_server.schemas.device import Capabilities
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.store import Store, blobs, devices, planning, scenes


@dataclass(frozen=True)
class Device:
    """A device that is enrolled: what an agent knows of itself."""

    name: str
    device_id: str
    token: str


def add_scene(store: Store, name: str = "box") -> None:
    with blobs.Incoming(store.incoming_dir, 1000) as incoming:
        incoming.write(name.encode())
        store.write(blobs.adopt, store.blob_dir, incoming, incoming.finish())
        store.write(scenes.put, name, incoming.finish())


def add_devices(store: Store, count: int) -> list[Device]:
    """Devices of one build, all in good health."""
    told = Capabilities.model_validate(capabilities())
    found = []
    for number in range(count):
        name = f"device-{number:04}"
        device_id, token = store.write(devices.enroll, name, "boot-1")
        store.write(devices.set_capabilities, device_id, told)
        found.append(Device(name, device_id, token))
    return found


def add_sweep(store: Store, name: str, on: list[Device], configurations: int, repeats: int = 1) -> str:
    """A sweep of `configurations` jobs a device and repeat, beside references and noise floors."""
    definition = SweepDefinition.model_validate(
        {
            "name": name,
            "scenes": ["box"],
            "devices": [device.device_id for device in on],
            "settings": {"width": 32, "height": 32},
            "axes": {"gather_count": list(range(1, configurations + 1))},
            "repeats": repeats,
            "measure": {"window_s": 1, "min_windows": 2, "max_windows": 2, "max_seconds": 10},
        }
    )
    return store.write(planning.create_once, definition, None)[0]


def fill(folder: Path, device_count: int, jobs_each: int) -> list[Device]:
    """A data folder with a sweep of about `jobs_each` jobs for each device."""
    store = Store(folder)
    add_scene(store)
    found = add_devices(store, device_count)
    add_sweep(store, "load", found, min(jobs_each, 1000), max(1, jobs_each // 1000))
    store.close()
    return found


def result_of(lease: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """The measure document of a lease, without pictures."""
    return measure_document(lease, b"", **{"image_blob": None, **changes})


def result_body(lease: dict[str, Any], **changes: Any) -> bytes:
    return json.dumps(result_of(lease, **changes)).encode()
