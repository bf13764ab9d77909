"""One example of every document of the API, shown in its OpenAPI description; tests hold them to the models."""

from typing import Any, Final

_ID: Final = "01990000-0000-7000-8000-000000000001"
_DEVICE: Final = "01990000-0000-7000-8000-000000000002"
_SHA: Final = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
_AT: Final = "2026-11-22T10:15:00.000Z"
_TIME: Final = {"value": 1.21, "low": 1.19, "high": 1.23}
_ENERGY: Final = {"value": 20.4, "low": 20.1, "high": 20.7}
_SETTINGS: Final = {"width": 256, "height": 256, "seed": 0, "gather_count": 100}
_DEFINITION: Final[dict[str, Any]] = {
    "name": "photons",
    "scenes": ["cornell-boxes", {"name": "cornell-bunny", "defines": {"detail": "948"}}],
    "requires": {"machine": "x86_64", "energy_method": "battery_gauge"},
    "preset": "balanced",
    "axes": {"gather_count": [50, 100, 200]},
    "rule": "one_at_a_time",
    "repeats": 3,
    "controls": 1,
    "measure": {"window_s": 60, "min_windows": 5, "max_windows": 20, "half_width": 0.05, "max_seconds": 1800},
}
_COUNTS: Final = {"total": 30, "queued": 20, "leased": 1, "done": 9, "failed": 0, "cancelled": 0}
_SUMMARY: Final[dict[str, Any]] = {
    "id": _ID,
    "name": "photons",
    "state": "running",
    "created_at": _AT,
    "jobs": _COUNTS,
    "differences_pending": 1,
    "scenes": ["cornell-boxes"],
    "devices": ["laptop"],
}
_CONTROLS: Final = {
    "scene": "cornell-boxes",
    "device": "laptop",
    "time_ratios": [1.0, 1.02],
    "energy_ratios": [1.0, 1.01],
}
_WHOLE: Final = {
    **_SUMMARY,
    "definition": {"name": "photons", "scenes": [{"name": "cornell-boxes"}]},
    "controls": [_CONTROLS],
}
_CAPABILITIES: Final[dict[str, Any]] = {
    "platform": "Linux-6.12.43-amd64-x86_64-with-glibc2.41",
    "machine": "x86_64",
    "os": "Linux",
    "cores": 8,
    "isa": "x86-64-v3",
    "agent_version": "0.1.0",
    "energy_methods": [{"method": "battery_gauge", "available": True, "scope": "whole machine", "reason": None}],
    "renderer": {"name": "joulebox-render", "version": "0.1.0"},
}
_HEALTH: Final = {"health": "good", "health_reason": None, "failures_in_row": 0}
_SEEN: Final = {"created_at": _AT, "last_seen_at": _AT, "last_seen_age_s": 4.2, "leased_jobs": 1}
_KNOWN: Final = {
    "id": _DEVICE,
    "name": "laptop",
    **_HEALTH,
    **_SEEN,
    "capabilities": _CAPABILITIES,
    "disagreements": 0,
    "flags": [
        {
            "code": "other_build",
            "message": "renders with joulebox-render 0.2.0, most of the fleet with joulebox-render 0.1.0",
        }
    ],
}
_MEASURE_RULE: Final = {
    "window_s": 60.0,
    "min_windows": 5,
    "max_windows": 20,
    "half_width": 0.05,
    "max_seconds": 1800.0,
    "meter": True,
}
_LEASE: Final = {
    "attempt_id": _ID,
    "job_id": _ID,
    "sweep_id": _ID,
    "purpose": "measure",
    "expires_at": _AT,
    "scene": {"name": "cornell-boxes", "bundle_sha256": _SHA},
    "defines": {},
    "settings": _SETTINGS,
    "measure": _MEASURE_RULE,
}
_JOB: Final = {
    "id": _ID,
    "scene": "cornell-boxes",
    "device": "laptop",
    "purpose": "measure",
    "configuration_id": _ID,
    "settings": _SETTINGS,
    "repeat": 0,
    "metered": True,
    "state": "queued",
    "attempts": 1,
    "reason": "the measurement was voided: mains power appeared at 12.3 s",
}
_SCENE: Final = {"name": "cornell-boxes", "bundle_sha256": _SHA, "created_at": _AT}
_ROW: Final = {
    "id": _ID,
    "sweep_id": _ID,
    "job_id": _ID,
    "scene": "cornell-boxes",
    "device": "laptop",
    "purpose": "measure",
    "configuration_id": _ID,
    "repeat": 0,
    "seed": 0,
    "method": "battery_gauge",
    "quality": "measured",
    "accepted": "ok",
    "void": None,
    "images": 248,
    "windows": 5,
    "time_s": 1.21,
    "time_low_s": 1.19,
    "time_high_s": 1.23,
    "cpu_s": 2.31,
    "energy_j": 20.4,
    "energy_low_j": 20.1,
    "energy_high_j": 20.7,
    "difference": 61.5,
    "pixel_sha256": _SHA,
    "image_sha256": _SHA,
    "received_at": _AT,
    "settings": '{"gather_count":100,"width":256}',
}
_DISAGREEMENT: Final = {
    "id": _ID,
    "device": "laptop",
    "other_device": "handheld",
    "scene": "cornell-boxes",
    "settings": _SETTINGS,
    "same_class": False,
    "render_class": "joulebox-render 0.1.0, Linux, x86-64-v3",
    "other_render_class": "joulebox-render 0.1.0, Linux, aarch64",
    "p99_jnd": 1.4,
    "pixel_sha256": _SHA,
    "other_pixel_sha256": _SHA[::-1],
    "image_sha256": _SHA,
    "other_image_sha256": _SHA[::-1],
    "result_id": _ID,
    "other_result_id": _ID,
}

_DIFFERENCE: Final = {
    "metric": "ltdiff-style",
    "version": 1,
    "value": 61.5,
    "reference_sha256": _SHA,
    "test_sha256": _SHA[::-1],
    "delta_sha256": _SHA,
}


def _page(item: dict[str, Any]) -> dict[str, Any]:
    return {"items": [item], "next": None}


EXAMPLES: Final[dict[str, Any]] = {
    "Problem": {
        "type": "urn:joulebox:problem:invalid",
        "title": "The request cannot be used",
        "status": 422,
        "detail": "the sweep cannot be used: axes.gather_count[1]: 0 must be at least 1",
        "code": "invalid",
        "request_id": _ID,
        "errors": [{"field": "axes.gather_count[1]", "message": "0 must be at least 1"}],
    },
    "EnrollmentRequest": {"name": "the blue laptop"},
    "EnrollmentDocument": {
        "code": "H7KM-Q2XA-9RWD",
        "expires_at": _AT,
        "join": "joulebox-agent enroll --server http://192.168.1.5:8473 --code H7KM-Q2XA-9RWD && joulebox-agent doctor",
    },
    "DeviceRequest": {"code": "H7KM-Q2XA-9RWD", "name": "laptop", "boot_id": "4f1c2e8a"},
    "DeviceToken": {"device_id": _DEVICE, "token": "jb_shown-this-once"},
    "DeviceId": {"device_id": _DEVICE},
    "HealthRequest": {"health": "good"},
    "Capabilities": _CAPABILITIES,
    "Device": _KNOWN,
    "DevicePage": _page(_KNOWN),
    "DisagreementPage": _page(_DISAGREEMENT),
    "SceneBundle": {"name": "cornell-boxes", "bundle_sha256": _SHA},
    "ScenePage": _page(_SCENE),
    "SweepDefinition": _DEFINITION,
    "SweepPage": _page(_SUMMARY),
    "Sweep": _WHOLE,
    "RetriedSweep": {**_WHOLE, "retried": 3},
    "ActionRequest": {"action": "pause"},
    "Preview": {
        "configurations": 4,
        "jobs": {"total": 17, "measure": 12, "reference": 1, "noise_floor": 1, "control": 3, "metered": 16},
        "devices": 1,
        "time_s": {"low": 5140.0, "high": 19_540.0},
        "power_w": 17.2,
        "energy_j": 88_408.0,
        "battery_charges": 0.85,
        "battery_full_j": 172_800.0,
    },
    "JobPage": _page(_JOB),
    "LeaseRequest": {"boot_id": "4f1c2e8a", "conditions": {"battery_charge_share": 0.81}, "max_jobs": 1, "wait_s": 20},
    "Leases": {"leases": [_LEASE]},
    "ReleaseRequest": {"reason": "on mains power", "failed": False},
    "MeasureDocument": {
        "schema": 1,
        "scene": "cornell-boxes",
        "scene_sha256": _SHA,
        "settings": _SETTINGS,
        "renderer": {"name": "joulebox-render", "version": "0.1.0", "intersector": "embree", "isa": "x86-64-v3"},
        "method": "battery_gauge",
        "quality": "measured",
        "scope": "whole machine",
        "images": 248,
        "windows": 5,
        "window_s": 60.0,
        "time_s_per_image": _TIME,
        "cpu_s_per_image": _TIME,
        "energy_j_per_image": {"gross": _ENERGY, "net": None, "counter": None},
        "stages": {"direct": {"time_s": 0.4, "cpu_s": 0.8, "energy_j": {"equation_2": 6.7}}},
        "pixel_sha256": _SHA,
        "image_blob": _SHA,
    },
    "Accepted": {"accepted": "ok"},
    "StoredBlob": {"sha256": _SHA},
    "ResultPage": _page(_ROW),
    "DifferenceDocument": _DIFFERENCE,
    "DifferenceVersions": {"items": [_DIFFERENCE]},
    "Recomputed": {"metric": "ltdiff-style", "version": 2, "asked": 40, "kept": 0},
    "ConfirmRequest": {"count": 3},
    "Confirmed": {"queued_jobs": 9, "proposals": [{"label": "gather_count=50", "basis": "predicted"}]},
    "Alive": {"status": "ok", "version": "0.1.0"},
    "Ready": {"status": "ok", "free_bytes": 71_000_000_000},
    "FleetPage": _page(
        {
            "device": "laptop",
            "result_at": _AT,
            "battery": {"charge_share": 0.71, "full_j": 172_800.0, "on_mains": False},
            "meter": {
                "method": "battery_gauge",
                "scope": "whole machine",
                "quality": "measured",
                "refresh_s": 1.02,
                "half_width_share": 0.021,
            },
            "control": {
                "sweep_id": _ID,
                "scene": "cornell-boxes",
                "time_ratio": 1.02,
                "energy_ratio": 1.01,
                "at": _AT,
            },
        }
    ),
    "Progress": {
        "sweep_id": _ID,
        "state": "running",
        "started_at": _AT,
        "last_result_at": _AT,
        "remaining_s": {"value": 5400.0, "low": 4900.0, "high": 5900.0},
        "reason": None,
    },
    "ReadSweep": {
        "definition": _DEFINITION,
        "notes": ["../scenes/cornell-boxes is taken to be the scene cornell-boxes that this server has"],
    },
}
