"""The sample documents of tests/contract: the server takes in and gives out exactly such."""

import json
from pathlib import Path
from typing import Any

import pytest
from fake_device import contract, measure_document, picture, resolved
from joulebox_server.analysis.documents import Recommendation, Tradeoff
from joulebox_server.schemas.device import Capabilities, Lease
from joulebox_server.schemas.measure import MeasureDocument
from joulebox_server.schemas.sweep import SweepDefinition
from server_testing import Server

MODELS: dict[str, Any] = {
    "lease": Lease,
    "measure": MeasureDocument,
    "capabilities": Capabilities,
    "sweep": SweepDefinition,
    "tradeoff": Tradeoff,
    "recommendation": Recommendation,
}
FREE = ("settings", "changed", "conditions", "photons", "plan", "settings_schema", "defines", "axes", "stages",
        "left_out", "stages_left_out")  # fmt: skip
"""Objects whose names are not ours to fix."""
UNITS = ("_j", "_s", "_uj", "_us", "_wh", "_w", "_m", "_bytes", "_deg", "_cd_m2", "_percent")
UNITLESS = {
    *("schema", "images", "windows", "min_windows", "max_windows", "half_width", "confidence"),
    *("max_seconds", "cores", "threads", "rays", "repeats", "limit", "limit_per_pixel", "width", "height"),
    *("exposure", "metric_version", "share_of_limit", "saves_share", "flip_mean", "ssim", "rmse_srgb", "relmse"),
    *("difference", "difference_per_pixel", "noise_floor"),
    *("energy_share", "time_share", "difference_share"),
    *("elasticity", "cost_ratio", "difference_start", "difference_end", "slope", "start", "end"),
}


def shape(document: Any) -> Any:
    """Names and nesting; of a list what its first item looks like."""
    if isinstance(document, dict):
        return {key: key if key in FREE else shape(value) for key, value in document.items()}
    if isinstance(document, list):
        return [shape(item) for item in document[:1]]
    return "value"


@pytest.mark.parametrize("name", MODELS)
def test_samples_are_of_the_model(contract_dir: Path, name: str) -> None:
    """Nothing unknown inside, and every field survives a round trip."""
    sample = contract(contract_dir, name)
    read = MODELS[name].model_validate_json(json.dumps(sample))
    written = read.model_dump(mode="json", by_alias=True, exclude_unset=True)
    if name == "sweep":  # a scene's name alone is short for an object
        sample["scenes"] = [{"name": entry} if isinstance(entry, str) else entry for entry in sample["scenes"]]
    assert written == sample


@pytest.mark.parametrize("name", MODELS)
def test_numbers_carry_units(contract_dir: Path, name: str) -> None:
    """Each numeric field at the border has a unit in its name, is inside one that has, or is known to have none."""

    def carries(key: str) -> bool:
        return key.endswith(UNITS) or "_j_per_" in key or "_s_per_" in key or key in UNITLESS

    def walk(value: Any, key: str) -> None:
        if isinstance(value, dict):
            for inner, item in value.items():
                if inner not in FREE:
                    walk(item, key if carries(key) and key not in MODELS else inner)
        elif isinstance(value, list):
            for item in value:
                walk(item, key)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            assert carries(key), key

    walk(contract(contract_dir, name), name)


def test_the_samples_in_one_session(server: Server, contract_dir: Path) -> None:
    """The sample sweep and capabilities are accepted; what comes back has the samples' shape."""
    for scene in ("cornell-boxes", "cornell-bunny"):
        server.add_scene(scene)
    device = server.device(**contract(contract_dir, "capabilities"))
    answer = server.client.post("/v1/sweeps", json=contract(contract_dir, "sweep"), headers=server.operator)
    assert answer.status_code == 201, answer.text
    sample = contract(contract_dir, "measure")
    while leased := device.lease():
        lease = leased[0]
        assert shape(lease) == shape(contract(contract_dir, "lease"))
        image = picture(resolved(lease["settings"]))
        device.put_blob(image)
        own = {"scene", "scene_sha256", "settings", "image_blob", "pixel_sha256"}
        document = sample | {key: value for key, value in measure_document(lease, image).items() if key in own}
        assert device.put_result(lease, document).json() == {"accepted": "ok"}
    sweep_id = answer.json()["id"]
    server.wait(sweep_id, "done")
    for name, params in (("tradeoff", {}), ("recommendation", {"budget_j": 1000, "difference_limit": 1000})):
        found = server.get(f"/sweeps/{sweep_id}/{name}", **params)
        assert shape(found) == shape(contract(contract_dir, name))


def test_measure_sample_is_stored_exactly(server: Server, contract_dir: Path) -> None:
    """To a microjoule and a microsecond."""
    server.add_sweep(axes={}, repeats=1)
    device = server.device()
    lease = device.lease()[0]
    document = contract(contract_dir, "measure")
    document["settings"] = lease["settings"]
    document["image_blob"] = device.put_blob(b"picture")
    assert device.put_result(lease, document).status_code == 201
    row = server.get("/results")["items"][0]
    assert row["energy_j"] == pytest.approx(document["energy_j_per_image"]["gross"]["value"], abs=5e-7)
    assert row["time_high_s"] == pytest.approx(document["time_s_per_image"]["high"], abs=5e-7)
