"""Answers that change: predicted combinations confirmed by new runs, differences by another version of the metric."""

from typing import Any

import pytest
from fake_device import interval, measure_document, picture, resolved
from joulebox_server.analysis import difference as metric
from joulebox_server.store import differences
from server_testing import Server

AXES = {"global_photons": [10_000, 30_000, 60_000, 100_000], "gather_count": [50, 100, 200]}


@pytest.fixture
def sparse(server: Server) -> tuple[Server, Any, str]:
    """A sweep of thirteen of the fifteen combinations of two axes, measured to its end."""
    every = [{"global_photons": p, "gather_count": c} for p in AXES["global_photons"] for c in AXES["gather_count"]]
    listed = [each for k, each in enumerate(every) if k not in (6, 11)]
    more = [{"global_photons": 80_000, "gather_count": c} for c in AXES["gather_count"]]
    sweep = server.add_sweep(rule="list", axes={}, configurations=[*listed, *more])
    device = server.device()
    device.work()
    server.wait(sweep["id"], "done")
    return server, device, sweep["id"]


def test_proposals_are_queued_measured_and_then_answer(sparse: tuple[Server, Any, str]) -> None:
    server, device, sweep = sparse
    path = f"/sweeps/{sweep}/recommendation"
    # A limit that the best points keep by their values but not by their bounds: what promises to keep it is proposed.
    best = [
        p["difference"]["value"] for p in server.get(f"/sweeps/{sweep}/tradeoff")["points"] if p["time_s"]["value"] > 1
    ]
    asked = {"budget_j": 13.0, "difference_limit": 1.02 * max(best)}
    assert len(best) == 2
    assert server.get(path, **asked)["answer"] == "none"
    answer = server.client.post(f"/v1{path}:confirm", params=asked, json={"count": 3}, headers=server.operator)
    assert answer.status_code == 200, answer.text
    proposed = answer.json()["proposals"]
    assert [choice["basis"] for choice in proposed].count("predicted") == 1
    assert len(proposed) == 3  # two others are within the limit by their values alone: more seeds will tell
    assert answer.json()["queued_jobs"] == 2 * len(proposed)
    assert server.get(f"/sweeps/{sweep}")["state"] == "running"
    again = server.client.post(f"/v1{path}:confirm", params=asked, json={"count": 3}, headers=server.operator)
    assert again.json()["queued_jobs"] == 0  # they wait already
    assert device.work() == 2 * len(proposed)
    server.wait(sweep, "done")
    measured = server.get(f"/sweeps/{sweep}/tradeoff")["points"]
    points = {tuple(point["settings"][name] for name in AXES): point for point in measured}
    for choice in proposed:
        point = points[tuple(choice["settings"][name] for name in AXES)]
        assert point["repeats"] == (2 if choice["basis"] == "predicted" else 4)
        assert point["difference"] is not None
    assert all(choice["basis"] == "measured" for choice in server.get(path, **asked)["proposals"])


def test_with_seeds_of_their_own_what_is_confirmed_gets_new_ones_and_then_answers(server: Server) -> None:
    """Fifteen of sixteen combinations, each with seeds of its own; the one left out is the best for the budget."""
    every = [{"global_photons": p, "gather_count": c} for p in AXES["global_photons"] for c in (50, 100, 200, 400)]
    best = {"global_photons": 100_000, "gather_count": 50}
    sweep = server.add_sweep(rule="list", axes={}, seeds="own", configurations=[c for c in every if c != best])["id"]
    device = server.device()
    work_dearer(device)
    server.wait(sweep, "done")
    path = f"/sweeps/{sweep}/recommendation"
    asked = {"budget_j": 1.1 * energy_of(best)}
    before, known = server.get(path, **asked), seeds_of(server, sweep)
    assert before["settings"]["global_photons"] < 100_000
    confirm = {"params": asked, "json": {"count": 1}, "headers": server.operator}
    queued = server.client.post(f"/v1{path}:confirm", **confirm).json()
    assert [choice["configuration_id"] for choice in queued["proposals"]] == [None]  # it was never run
    assert queued["queued_jobs"] == 2
    assert server.get(path, **asked)["configuration_id"] == before["configuration_id"]  # nothing was measured yet
    assert work_dearer(device) == 2
    server.wait(sweep, "done")
    found, seeds = server.get(path, **asked), seeds_of(server, sweep)
    assert {name: found["settings"][name] for name in best} == best
    assert (found["answer"], found["basis"]) == ("settings", "measured")
    assert found["difference"]["high"] < before["difference"]["high"]
    assert len(seeds) == len(set(seeds)) == len(known) + 2
    assert set(known) < set(seeds)


def energy_of(settings: dict[str, Any]) -> float:
    """Joules of a device to which gathering matters."""
    return (1 + settings["global_photons"] / 10_000) * (settings["gather_count"] / 100) ** 0.5


def work_dearer(device: Any) -> int:
    """Do every job there is at that energy; returns how many."""
    count = 0
    while leases := device.lease():
        energy_j = energy_of(resolved(leases[0]["settings"]))
        document = measure_document(leases[0])
        energy = interval(energy_j) if document["energy_j_per_image"]["gross"] else None
        stages = {
            name: stage | {"energy_j": {"equation_2": share * energy_j, "integrated": None, "regressed": None}}
            for share, (name, stage) in zip((0.3, 0.2, 0.5), document["stages"].items(), strict=True)
        }
        told = {"energy_j_per_image": {"gross": energy, "net": None, "counter": energy}, "stages": stages}
        assert device.finish(leases[0], **told).status_code == 201
        count += 1
    return count


def seeds_of(server: Server, sweep: str) -> list[int]:
    """Of every measured repeat."""
    found = server.get("/results", sweep=sweep, limit=200)["items"]
    return [row["seed"] for row in found if row["purpose"] == "measure"]


def test_confirming_needs_an_operator_and_a_count(sparse: tuple[Server, Any, str]) -> None:
    server, _, sweep = sparse
    path = f"/v1/sweeps/{sweep}/recommendation:confirm"
    assert server.client.post(path, json={"count": 1}, headers=server.viewer).status_code == 403
    assert server.client.post(path, json={"count": 0}, headers=server.operator).status_code == 422
    assert server.client.post(path, json={"count": 1, "counts": 1}, headers=server.operator).status_code == 422
    server.client.patch(f"/v1/sweeps/{sweep}", json={"action": "cancel"}, headers=server.operator)


def test_a_share_of_a_battery_is_a_budget(server: Server) -> None:
    """The fake device's battery holds what its results say; until one does, the answer is a sentence."""
    sweep = server.add_sweep(axes={"global_photons": [10_000, 50_000]}, repeats=1)
    device = server.device()
    path = f"/sweeps/{sweep['id']}/recommendation"
    full_j = 36_000.0
    for number in range(4):
        lease = device.lease()[0]
        image = picture(resolved(lease["settings"]))
        device.put_blob(image)
        conditions = {"before": {"battery_full_j": full_j if number == 3 else None}, "after": {}}
        asked = {"battery_percent": 1, "images": 50, "difference_limit": 1e6}
        if number == 3:
            refused = server.client.get(f"/v1{path}", params=asked)
            assert refused.status_code == 422
            assert "capacity of this device's battery is not known" in refused.json()["detail"]
        device.put_result(lease, measure_document(lease, image, conditions=conditions))
    server.wait(sweep["id"], "done")
    found = server.get(path, **asked)
    assert found["budget_j"] == pytest.approx(0.01 * full_j / 50)
    assert any("1 % of a battery of 10.0 Wh for 50 images" in why for why in found["why"])


def test_another_metric_version_stands_beside_the_first(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = server.add_sweep(axes={"global_photons": [10_000]}, repeats=1)
    server.device().work()
    server.wait(sweep["id"], "done")
    point = server.get(f"/sweeps/{sweep['id']}/tradeoff")["points"][0]
    pair = {"reference": point["reference_image_sha256"], "test": point["image_sha256"]}
    path = "/v1/differences:recompute"
    assert server.client.post(path, headers=server.operator).json()["asked"] == 0
    monkeypatch.setattr(differences, "VERSION", 2)
    monkeypatch.setattr(metric, "_VALUE_SCALE", 2 * metric._VALUE_SCALE)
    assert server.client.post(path, headers=server.viewer).status_code == 403
    answer = server.client.post(path, params={"sweep": sweep["id"]}, headers=server.operator).json()
    assert (answer["asked"], answer["kept"]) == (2, 0)  # the repeat's, and the noise floor's
    for _ in range(200):
        if not server.get(f"/sweeps/{sweep['id']}")["differences_pending"]:
            break
    found = server.get("/compare/versions", **pair)["items"]
    assert [each["version"] for each in found] == [2, 1]
    assert found[0]["value"] == pytest.approx(2 * found[1]["value"])
    after = server.get(f"/sweeps/{sweep['id']}/tradeoff")["points"][0]
    assert after["difference"]["value"] == pytest.approx(2 * point["difference"]["value"])
    assert server.client.delete(f"/v1/sweeps/{sweep['id']}", headers=server.operator).status_code == 204
    assert server.get("/compare/versions", **pair)["items"] == []
