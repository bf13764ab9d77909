"""A device as the server sees one: leases jobs, makes pictures by a formula, sends blobs and results."""

import hashlib
import io
import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "width": {"type": "integer", "minimum": 1, "maximum": 16384, "default": 32},
        "height": {"anyOf": [{"type": "integer", "minimum": 1, "maximum": 16384}, {"type": "null"}], "default": None},
        "seed": {"type": "integer", "minimum": 0, "default": 0},
        "global_photons": {"type": "integer", "minimum": 0, "default": 100000},
        "gather_count": {"type": "integer", "minimum": 1, "default": 100},
        "indirect": {"$ref": "#/$defs/Indirect", "default": "direct_visualization"},
    },
    "$defs": {"Indirect": {"enum": ["none", "direct_visualization", "final_gather", "path"], "type": "string"}},
}
DEFAULTS: dict[str, Any] = {
    "width": 32,
    "height": 32,
    "seed": 0,
    "global_photons": 100_000,
    "gather_count": 100,
    "indirect": "direct_visualization",
}
PRESETS: dict[str, dict[str, Any]] = {"reference": {"global_photons": 250_000}, "draft": {"global_photons": 10_000}}


def scene_zip(text: str = '<scene version="3.0.0"/>', **others: bytes) -> bytes:
    """A scene bundle."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as bundle:
        bundle.writestr(zipfile.ZipInfo("scene.xml"), text)
        for name, content in others.items():
            bundle.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def resolved(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings as a renderer completes them."""
    given = {key: value for key, value in settings.items() if key != "preset"}
    return DEFAULTS | PRESETS.get(str(settings.get("preset")), {}) | given


def picture(settings: dict[str, Any]) -> bytes:
    """NPY bytes of a picture whose noise falls with the photon count, drawn anew by every seed."""
    height, width = settings["height"], settings["width"]
    ramp = np.linspace(0.1, 0.8, width, dtype=np.float32)
    image = np.broadcast_to(ramp[None, :, None], (height, width, 3)).copy()
    random = np.random.default_rng([settings["seed"], settings["global_photons"], settings["gather_count"]])
    image += random.normal(0, 0.5 / settings["global_photons"] ** 0.5, image.shape).astype(np.float32)
    out = io.BytesIO()
    np.save(out, np.abs(image))
    return out.getvalue()


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def interval(value: float, share: float = 0.02) -> dict[str, float]:
    return {"value": value, "low": value * (1 - share), "high": value * (1 + share)}


def measure_document(lease: dict[str, Any], image: bytes | None = None, **changes: Any) -> dict[str, Any]:
    """A result for a lease: time grows with the photon count, 10 W throughout."""
    settings = resolved(lease["settings"])
    time_s = 0.1 + settings["global_photons"] / 100_000
    image = picture(settings) if image is None else image
    energy = interval(10 * time_s) if lease["measure"]["meter"] else None
    stages = {
        name: {
            "time_s": share * time_s,
            "cpu_s": share * time_s,
            "rays": 1000.0,
            "energy_j": {"equation_2": share * 10 * time_s, "integrated": None, "regressed": None},
        }
        for name, share in (("photon_map", 0.3), ("direct", 0.2), ("indirect", 0.5))
    }
    return {
        "schema": 1,
        "scene": lease["scene"]["name"],
        "scene_sha256": lease["scene"]["bundle_sha256"],
        "settings": settings,
        "renderer": {"name": "fake", "version": "1", "intersector": "bvh", "isa": "none", "threads": 1},
        "plan": {"run": ["photon_map", "direct", "indirect"], "left_out": {"caustics": "no specular surface"}},
        "photons": {"global_stored": settings["global_photons"]},
        "method": "battery_gauge" if energy else "none",
        "quality": "measured" if energy else "none",
        "scope": "whole machine",
        "refresh_s": 1.0 if energy else None,
        "images": 50,
        "windows": 5,
        "window_s": lease["measure"]["window_s"],
        "time_s_per_image": interval(time_s),
        "cpu_s_per_image": interval(time_s),
        "energy_j_per_image": {"gross": energy, "net": None, "counter": energy},
        "confidence": 0.95,
        "stages": stages,
        "window_data": [],
        "power_samples": None,
        "conditions": {"before": {"charge_percent": 80}, "after": {"charge_percent": 79}},
        "void": None,
        "noise": None,
        "pixel_sha256": sha256(image + b"pixels"),
        "image_blob": sha256(image),
    } | changes


@dataclass
class FakeDevice:
    """Talks to the server through an httpx2 client (a TestClient is one)."""

    client: Any
    token: str
    device_id: str
    boot_id: str = "boot-1"
    done: list[str] = field(default_factory=list)

    @classmethod
    def enroll(cls, client: Any, operator: dict[str, str], name: str = "laptop", **changes: Any) -> "FakeDevice":
        code = client.post("/v1/enrollments", headers=operator, json={}).json()["code"]
        answer = client.post("/v1/devices", json={"code": code, "name": name, "boot_id": "boot-1"})
        assert answer.status_code == 201, answer.text
        device = cls(client, answer.json()["token"], answer.json()["device_id"])
        device.tell_capabilities(**changes)
        return device

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}

    def tell_capabilities(self, **changes: Any) -> None:
        answer = self.client.put(
            f"/v1/devices/{self.device_id}/capabilities", headers=self.headers, json=capabilities(**changes)
        )
        assert answer.status_code == 200, answer.text

    def lease(self, **request: Any) -> list[dict[str, Any]]:
        body = {"boot_id": self.boot_id, "conditions": {}, "max_jobs": 1, "wait_s": 0} | request
        answer = self.client.post("/v1/leases", headers=self.headers, json=body)
        assert answer.status_code in (200, 204), answer.text
        return answer.json()["leases"] if answer.status_code == 200 else []

    def put_blob(self, content: bytes) -> str:
        answer = self.client.put(
            f"/v1/blobs/{sha256(content)}",
            headers=self.headers | {"Content-Type": "application/octet-stream"},
            content=content,
        )
        assert answer.status_code in (200, 201), answer.text
        return sha256(content)

    def put_result(self, lease: dict[str, Any], document: dict[str, Any]) -> Any:
        path = f"/v1/attempts/{lease['attempt_id']}/result"
        return self.client.put(path, headers=self.headers, json=document)

    def finish(self, lease: dict[str, Any], image: bytes | None = None, **changes: Any) -> Any:
        image = picture(resolved(lease["settings"])) if image is None else image
        self.put_blob(image)
        self.done.append(lease["job_id"])
        return self.put_result(lease, measure_document(lease, image, **changes))

    def work(self, most: int = 1000) -> int:
        """Do every job there is; returns how many."""
        for count in range(most):
            leases = self.lease()
            if not leases:
                return count
            answer = self.finish(leases[0])
            assert answer.status_code == 201, answer.text
        return most


def capabilities(**changes: Any) -> dict[str, Any]:
    return {
        "platform": "linux",
        "machine": "x86_64",
        "os": "Debian 13",
        "cores": 2,
        "isa": "x86-64-v3",
        "agent_version": "0.1.0",
        "energy_methods": [{"method": "battery_gauge", "available": True, "scope": "whole machine", "reason": None}],
        "renderer": {"name": "fake", "version": "1", "settings_schema": SCHEMA},
    } | changes


def sweep(**changes: Any) -> dict[str, Any]:
    """A small sweep of one axis."""
    return {
        "name": "small",
        "scenes": ["box"],
        "settings": {"width": 32, "height": 32},
        "axes": {"global_photons": [10_000, 50_000]},
        "repeats": 2,
        "measure": {"window_s": 1.0, "min_windows": 2, "max_windows": 2, "max_seconds": 10},
        "exposure": 1.0,
    } | changes


def contract(folder: Path, name: str) -> Any:
    """A sample document that both sides of the network accept."""
    return json.loads((folder / f"{name}.json").read_text())
