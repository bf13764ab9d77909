"""A small real data set, made only through the HTTP interface, by a device that renders by formula.

The device leases jobs, uploads EXR pictures and measure documents, and reports: what the dashboard then shows
went through the server's own schemas, store, metric and charts. Its picture is a shaded box whose noise falls
with the photons and the gather count; its costs rise with both.
"""

import hashlib
import io
import threading
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import OpenImageIO
import uvicorn
from joulebox_server.app import create_app
from joulebox_server.settings import ServerSettings
from joulebox_server.store import tokens
from stored import restore

SIDE = 64
SCHEMA: dict[str, Any] = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "width": {"type": "integer", "minimum": 1, "default": SIDE},
        "height": {"type": "integer", "minimum": 1, "default": SIDE},
        "seed": {"type": "integer", "minimum": 0, "default": 0},
        "exposure": {"type": "number", "exclusiveMinimum": 0, "default": 1.0},
        "global_photons": {"type": "integer", "minimum": 0, "default": 100_000},
        "gather_count": {"type": "integer", "minimum": 1, "default": 50},
        "indirect": {"enum": ["direct_visualization", "final_gather"], "default": "direct_visualization"},
    },
}
DEFAULTS: dict[str, Any] = {name: rule["default"] for name, rule in SCHEMA["properties"].items()}


def sweep_definition(**changes: Any) -> dict[str, Any]:
    """Nine settings twice each; together with reference and noise floor 20 jobs a scene and device."""
    return {
        "name": "box-photons",
        "scenes": ["box"],
        "settings": {"width": SIDE, "height": SIDE},
        "axes": {"global_photons": [20_000, 60_000, 200_000], "gather_count": [25, 50, 100]},
        "repeats": 2,
        "reference": {"settings": {"global_photons": 1_000_000, "gather_count": 400}},
        "measure": {"window_s": 1.0, "min_windows": 2, "max_windows": 2, "max_seconds": 10},
        "exposure": 3.0,
    } | changes


def exr_picture(settings: dict[str, Any], folder: Path, blemish: float = 0.0) -> tuple[bytes, str]:
    """EXR bytes of a red-green box with a lamp, blotched by as much noise as its settings leave; hash of its pixels."""
    width, height = settings["width"], settings["height"]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    y, x = y / height, x / width
    light = 0.06 + 0.16 * np.exp(-6 * ((x - 0.5) ** 2 + (y - 0.3) ** 2))
    colour = np.full((height, width, 3), (0.75, 0.72, 0.66), np.float32)
    colour[x < 0.18] = (0.62, 0.10, 0.08)
    colour[x > 0.82] = (0.12, 0.45, 0.10)
    image = colour * light[..., None]
    image[(abs(x - 0.5) < 0.12) & (y < 0.06)] = 1.5
    random = np.random.default_rng([settings["seed"], settings["global_photons"], settings["gather_count"]])
    blotches = random.normal(0, 1, (height // 4, width // 4, 1)).repeat(4, 0).repeat(4, 1)
    strength = 4.0 / np.sqrt(settings["global_photons"]) + 0.2 / settings["gather_count"]
    image = np.abs(image * (1 + strength * blotches)).astype(np.float32)
    image[:8, :8] *= 1 + blemish
    path = folder / f"picture-{threading.get_ident()}.exr"
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), OpenImageIO.ImageSpec(width, height, 3, "float")), output.geterror()
    assert output.write_image(np.ascontiguousarray(image)), output.geterror()
    output.close()
    return path.read_bytes(), hashlib.sha256(image.tobytes()).hexdigest()


def _interval(value: float, share: float = 0.03) -> dict[str, float]:
    return {"value": value, "low": value * (1 - share), "high": value * (1 + share)}


BATTERY = {"battery_charge_share": 0.71, "battery_full_j": 172_800.0, "mains_online": False}
"""What a device with a meter tells of its battery: 48 Wh."""


def measure_document(
    lease: dict[str, Any], image: bytes, pixel_sha256: str, quality: str, power_w: float, version: str = "1"
) -> dict[str, Any]:
    """A result for a lease: a cost for every photon and every gathered one, `power_w` throughout."""
    settings = DEFAULTS | lease["settings"]
    stages_s = {
        "photon_map": settings["global_photons"] / 250_000,
        "direct": 0.25,
        "indirect": settings["gather_count"] / 120,
    }
    time_s = sum(stages_s.values())
    energy = None if quality == "none" else _interval(power_w * time_s)
    return {
        "schema": 1,
        "scene": lease["scene"]["name"],
        "scene_sha256": lease["scene"]["bundle_sha256"],
        "settings": settings,
        "renderer": {"name": "formula", "version": version, "intersector": "bvh", "isa": "none", "threads": 1},
        "plan": {"run": list(stages_s), "left_out": {"caustics": "no specular surface"}},
        "photons": {"global_stored": settings["global_photons"]},
        "method": "none" if quality == "none" else "replay",
        "quality": quality,
        "scope": "battery",
        "refresh_s": None if quality == "none" else 1.0,
        "images": 20,
        "windows": 2,
        "window_s": lease["measure"]["window_s"],
        "time_s_per_image": _interval(time_s, 0.01),
        "cpu_s_per_image": _interval(1.9 * time_s, 0.01),
        "energy_j_per_image": {"gross": energy, "net": None, "counter": None},
        "confidence": 0.95,
        "stages": {
            name: {
                "time_s": stage_s,
                "cpu_s": 1.9 * stage_s,
                "rays": 1000.0,
                "energy_j": {
                    "equation_2": None if energy is None else power_w * stage_s,
                    "integrated": None,
                    "regressed": None,
                },
            }
            for name, stage_s in stages_s.items()
        },
        "window_data": [],
        "power_samples": None,
        "conditions": {"before": {}, "after": {} if quality == "none" else BATTERY},
        "void": None,
        "noise": None,
        "pixel_sha256": pixel_sha256,
        "image_blob": hashlib.sha256(image).hexdigest(),
    }


@dataclass
class FormulaDevice:
    """An enrolled device that answers every lease by formula; `quality` is what its energies rest on.

    version, blemish    of its renderer; by how much its pictures are brighter than they should be in a corner
    """

    client: httpx2.Client
    folder: Path
    token: str
    quality: str = "replayed"
    power_w: float = 12.0
    version: str = "1"
    blemish: float = 0.0

    @classmethod
    def enroll(
        cls, client: httpx2.Client, operator: dict[str, str], folder: Path, name: str, **changes: Any
    ) -> "FormulaDevice":
        code = _good(client.post("/v1/enrollments", headers=operator, json={"name": name})).json()["code"]
        body = {"code": code, "name": name, "boot_id": "boot-1"}
        enrolled = _good(client.post("/v1/devices", json=body)).json()
        device = cls(client, folder, enrolled["token"], **changes)
        available = device.quality != "none"
        capabilities = {
            "platform": "linux",
            "machine": "x86_64",
            "os": "Debian 13",
            "cores": 2,
            "isa": "x86-64-v3",
            "agent_version": "0.1.0",
            "energy_methods": [
                {
                    "method": "replay",
                    "available": available,
                    "scope": "battery" if available else None,
                    "reason": None if available else "no trace was given",
                }
            ],
            "renderer": {"name": "formula", "version": device.version, "settings_schema": SCHEMA},
        }
        path = f"/v1/devices/{enrolled['device_id']}/capabilities"
        _good(client.put(path, headers=device.headers, json=capabilities))
        return device

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}

    def work(self, most: int = 1000) -> int:
        """Do the jobs there are, at most `most`; returns how many were done."""
        for count in range(most):
            lease = self._lease()
            if lease is None:
                return count
            image, pixels = exr_picture(DEFAULTS | lease["settings"], self.folder, self.blemish)
            sha256 = hashlib.sha256(image).hexdigest()
            binary = self.headers | {"Content-Type": "application/octet-stream"}
            _good(self.client.put(f"/v1/blobs/{sha256}", headers=binary, content=image))
            document = measure_document(lease, image, pixels, self.quality, self.power_w, self.version)
            path = f"/v1/attempts/{lease['attempt_id']}/result"
            _good(self.client.put(path, headers=self.headers, json=document))
        return most

    def refuse(self, reason: str) -> None:
        """Take one job and give it back as failed."""
        lease = self._lease()
        assert lease is not None, "there is no job to refuse"
        body = {"reason": reason, "failed": True}
        _good(self.client.post(f"/v1/attempts/{lease['attempt_id']}/release", headers=self.headers, json=body))

    def _lease(self) -> dict[str, Any] | None:
        conditions = {} if self.quality == "none" else BATTERY
        body = {"boot_id": "boot-1", "conditions": conditions, "max_jobs": 1, "wait_s": 0}
        answer = _good(self.client.post("/v1/leases", headers=self.headers, json=body))
        return answer.json()["leases"][0] if answer.status_code == 200 else None


def _good(answer: httpx2.Response) -> httpx2.Response:
    assert answer.is_success, f"{answer.request.method} {answer.request.url}: {answer.status_code} {answer.text}"
    return answer


@dataclass
class Fleet:
    """A running server, reached at `url`, and what fills it."""

    url: str
    client: httpx2.Client
    folder: Path
    operator: dict[str, str]
    viewer_token: str

    @property
    def operator_token(self) -> str:
        return self.operator["Authorization"].removeprefix("Bearer ")

    def sweep_id(self, name: str) -> str:
        return str(self.get(f"/v1/sweeps/{name}")["id"])

    def points(self, sweep: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.get(f"/v1/sweeps/{sweep}/tradeoff")["points"]
        return found

    def get(self, path: str) -> Any:
        return _good(self.client.get(path, headers=self.operator)).json()

    def add_scene(self, name: str = "box") -> None:
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as bundle:
            bundle.writestr("scene.xml", f'<scene version="3.0.0"><!-- {name} --></scene>')
        _good(self.client.post(f"/v1/scenes?name={name}", content=out.getvalue(), headers=self.operator))

    def add_device(self, name: str = "shelf-laptop", **changes: Any) -> FormulaDevice:
        return FormulaDevice.enroll(self.client, self.operator, self.folder, name, **changes)

    def add_sweep(self, **changes: Any) -> str:
        answer = self.client.post("/v1/sweeps", json=sweep_definition(**changes), headers=self.operator)
        return str(_good(answer).json()["id"])

    def wait(self, sweep_id: str, *states: str, seconds: float = 60) -> None:
        """Until the sweep is in one of the states."""
        ends_s = time.monotonic() + seconds
        state = ""
        while time.monotonic() < ends_s:
            state = _good(self.client.get(f"/v1/sweeps/{sweep_id}", headers=self.operator)).json()["state"]
            if state in states:
                return
            time.sleep(0.05)
        raise AssertionError(f"after {seconds} s the sweep is {state}, not {' or '.join(states)}")


@contextmanager
def running_fleet(folder: Path, *, stored: bool = False, **settings: Any) -> Iterator[Fleet]:
    """The real app on a free loopback port, in a thread of this process, with an empty store or the stored one."""
    given = {"release_pause_s": 0, "max_attempts": 1, **settings}
    if stored:
        restore(folder, folder / "data")
    with ThreadPoolExecutor(1) as executor:
        app = create_app(ServerSettings(data_dir=folder / "data", **given), executor)
        config = uvicorn.Config(app, port=0, log_level="warning", timeout_graceful_shutdown=1)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            while not server.started:
                assert thread.is_alive(), "the server did not start"
                time.sleep(0.01)
            url = f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
            store = app.state.services.store
            operator = {"Authorization": f"Bearer {store.write(tokens.create, 'operator', 'operator')}"}
            viewer_token = str(store.write(tokens.create, "viewer", "viewer"))
            with httpx2.Client(base_url=url, timeout=30) as client:
                yield Fleet(url, client, folder, operator, viewer_token)
        finally:
            if server.started:
                app.state.services.bell.close()
            server.should_exit = True
            thread.join()


def fill(fleet: Fleet) -> dict[str, str]:
    """Sweeps that were not recorded: replayed with a battery, time only, half done, too few to know; name -> id."""
    for scene in ("box", "hall"):
        fleet.add_scene(scene)
    laptop = fleet.add_device("shelf-laptop")
    handheld = fleet.add_device("handheld-without-meter", quality="none")
    made = {"replayed": fleet.add_sweep(devices=["shelf-laptop"], scenes=["box", "hall"])}
    laptop.work()
    fleet.wait(made["replayed"], "done")
    made["time_only"] = fleet.add_sweep(name="handheld-times", devices=["handheld-without-meter"])
    handheld.work()
    fleet.wait(made["time_only"], "done")
    some = [{"global_photons": p, "gather_count": g} for p, g in SPARSE]
    made["sparse"] = fleet.add_sweep(name="sparse", devices=["shelf-laptop"], axes={}, rule="list", configurations=some)
    laptop.work()
    fleet.wait(made["sparse"], "done")
    made["running"] = fleet.add_sweep(name="overnight", devices=["shelf-laptop"])
    laptop.work(8)
    return made


SPARSE = [(p, g) for p in (20_000, 60_000, 200_000) for g in (25, 50, 100, 200) if (p, g) != (200_000, 200)]
"""All combinations but the best: it can be predicted."""
