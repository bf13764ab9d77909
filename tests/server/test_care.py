"""Devices that fail, drift or disagree: noticed, told, and never given work that they waste."""

import time
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_device import FakeDevice, measure_document, picture, resolved, sha256
from joulebox_server.store.database import number
from server_testing import Server, serving
from test_errors import told


def give_back(server: Server, device: FakeDevice, lease: dict[str, Any], **body: Any) -> Any:
    path = f"/v1/attempts/{lease['attempt_id']}/release"
    return server.client.post(path, headers=device.headers, json={"reason": "no such filter", **body})


def test_a_device_that_loops_in_failure_becomes_suspect(server: Server) -> None:
    """Five failures in a row, of whatever jobs; a good result begins the row anew; an operator clears it."""
    server.add_sweep(axes={"gather_count": list(range(1, 9))}, repeats=1)
    device = server.device()
    for _ in range(4):
        assert give_back(server, device, device.lease()[0], failed=True).status_code == 204
    assert device.finish(device.lease()[0]).status_code == 201
    for _ in range(4):
        give_back(server, device, device.lease()[0], failed=True)
    shown = server.get("/devices/laptop")
    assert (shown["health"], shown["failures_in_row"], shown["flags"]) == ("good", 4, [])
    give_back(server, device, device.lease()[0], failed=True)
    assert device.lease() == []
    shown = server.get("/devices/laptop")
    assert (shown["health"], shown["failures_in_row"]) == ("suspect", 5)
    assert shown["health_reason"] == "5 failures in a row, the last: no such filter"
    assert [flag["code"] for flag in shown["flags"]] == ["suspect"]
    cleared = server.client.patch("/v1/devices/laptop", headers=server.operator, json={"health": "good"}).json()
    assert (cleared["health"], cleared["failures_in_row"], cleared["health_reason"]) == ("good", 0, None)
    assert device.lease()


def test_releases_blame_nobody(server: Server) -> None:
    server.add_sweep(axes={}, repeats=1)
    device = server.device()
    for _ in range(8):
        give_back(server, device, device.lease()[0])
    assert server.get("/devices/laptop")["failures_in_row"] == 0


def test_failures_back_off(tmp_path: Path, executor: Any) -> None:
    """The second try of a job waits 10 s, the third 20 s; the fourth is none."""
    with serving(tmp_path, executor, retry_pause_s=10, longest_retry_pause_s=1000, suspect_after=100) as server:
        server.add_scene()
        server.add_sweep(axes={}, repeats=1)
        device = server.device()
        waits = []
        job_id = ""
        for _ in range(2):
            lease = device.lease(max_jobs=1)[0]
            job_id = job_id or lease["job_id"]
            others = device.lease(max_jobs=20)
            assert lease["job_id"] == job_id
            give_back(server, device, lease, failed=True)
            before_s = server.clock.ahead_s
            while not (again := device.lease(max_jobs=1)):
                server.clock.ahead_s += 1
            waits.append(server.clock.ahead_s - before_s)
            for other in [*others, *again]:
                give_back(server, device, other)
            server.clock.ahead_s += 6  # the pause after a release
    assert waits == [pytest.approx(10, abs=1), pytest.approx(20, abs=1)]


def test_revoking_gives_the_jobs_back_at_once(server: Server) -> None:
    sweep = server.add_sweep(axes={}, repeats=1)
    device = server.device()
    device.lease(max_jobs=2)
    assert server.client.delete("/v1/devices/laptop", headers=server.operator).status_code == 204
    jobs = server.get(f"/sweeps/{sweep['id']}")["jobs"]
    assert (jobs["leased"], jobs["queued"]) == (0, 3)


def test_if_match(server: Server) -> None:
    """A change is refused when another came between; without the header nothing is asked."""
    server.device()
    sweep = server.add_sweep()
    for path, change, other in (
        ("/v1/devices/laptop", {"health": "maintenance"}, {"health": "good"}),
        (f"/v1/sweeps/{sweep['id']}", {"action": "pause"}, {"action": "resume"}),
    ):
        tag = server.client.get(path).headers["etag"]
        guarded = server.operator | {"If-Match": tag}
        first = server.client.patch(path, headers=guarded, json=change)
        assert (first.status_code, first.headers["etag"] != tag) == (200, True)
        told(server.client.patch(path, headers=guarded, json=other), 412, "precondition_failed", tag)
        for allowed in (f'"v9", {first.headers["etag"]}', "*"):
            headers = server.operator | {"If-Match": allowed}
            assert server.client.patch(path, headers=headers, json=other).status_code == 200
            server.client.patch(path, headers=server.operator, json=change)
            tag = server.client.patch(path, headers=server.operator, json=change).headers["etag"]
            first = server.client.get(path)


def test_capability_matching(server: Server) -> None:
    """Each requirement keeps out a device that lacks it, and lets in one that has it."""
    renderer = {"name": "joulebox-render", "version": "2.0", "settings_schema": None}
    fit = {"machine": "aarch64", "os": "Linux", "isa": "neon", "cores": 8, "renderer": renderer}
    wishes: list[tuple[dict[str, Any], dict[str, Any]]] = [
        ({"machine": "AArch"}, {"machine": "x86_64"}),
        ({"os": "linux"}, {"os": "Windows"}),
        ({"isa": "neon"}, {"isa": "x86-64-v3"}),
        ({"min_cores": 8}, {"cores": 7}),
        ({"energy_method": "battery_gauge"}, {"energy_methods": []}),
        ({"renderer": "joulebox"}, {"renderer": renderer | {"name": "other"}}),
        ({"renderer_version": "2.0"}, {"renderer": renderer | {"version": "2.0.1"}}),
        ({"renderer_version": "2.0"}, {"renderer": None}),
    ]
    good, bad = server.device("good", **fit), server.device("bad")
    for wish, lack in wishes:
        bad.tell_capabilities(**fit | lack)
        sweep = server.add_sweep(axes={}, repeats=1, requires=wish)
        assert bad.lease() == [], wish
        assert len(good.lease()) == 1, wish
        server.client.patch(f"/v1/sweeps/{sweep['id']}", headers=server.operator, json={"action": "cancel"})


def test_a_device_on_another_build_is_flagged(server: Server) -> None:
    for name in ("one", "two"):
        server.device(name)
    server.device("odd", renderer={"name": "fake", "version": "2"})
    flags = {device["name"]: [flag["code"] for flag in device["flags"]] for device in server.get("/devices")["items"]}
    assert flags == {"odd": ["other_build"], "one": [], "two": []}
    assert "fake 2, most of the fleet with fake 1" in server.get("/devices/odd")["flags"][0]["message"]


def test_devices_in_pages(server: Server) -> None:
    for count in range(5):
        server.device(f"device-{count}")
    first = server.get("/devices", limit=3)
    rest = server.get("/devices", limit=3, cursor=first["next"])
    assert [device["name"] for device in first["items"] + rest["items"]] == [f"device-{n}" for n in range(5)]
    assert rest["next"] is None


def test_control_runs(server: Server) -> None:
    """They lie evenly in each block, are measured like others, and tell the drift; the trade-off ignores them."""
    sweep = server.add_sweep(axes={"gather_count": list(range(1, 9))}, repeats=2, controls=2)
    assert sweep["jobs"]["total"] == 2 * (8 + 2) + 2
    device = server.device()
    slower, order, calls = 1.0, [], 0
    jobs = {job["id"]: job for job in server.get(f"/sweeps/{sweep['id']}/jobs", limit=200)["items"]}
    while leased := device.lease():
        lease = leased[0]
        purpose = jobs[lease["job_id"]]["purpose"]
        assert lease["purpose"] == ("measure" if purpose == "control" else purpose)
        image = picture(resolved(lease["settings"]))
        device.put_blob(image)
        body = measure_document(lease, image)
        if purpose == "control":
            order.append(calls)
            for quantity in (body["time_s_per_image"], body["energy_j_per_image"]["gross"]):
                quantity.update({key: value * slower for key, value in quantity.items()})
            slower += 0.01
        calls += 1
        assert device.put_result(lease, body).json() == {"accepted": "ok"}
    assert order == [2, 7, 12, 17]  # after the reference and its noise floor: first and in the middle of each block
    found = server.wait(sweep["id"], "done")
    assert [series["scene"] for series in found["controls"]] == ["box"]
    assert found["controls"][0]["time_ratios"] == pytest.approx([1, 1.01, 1.02, 1.03], abs=1e-5)
    assert found["controls"][0]["energy_ratios"] == pytest.approx([1, 1.01, 1.02, 1.03], abs=1e-5)
    assert [point["repeats"] for point in server.get(f"/sweeps/{sweep['id']}/tradeoff")["points"]] == [2] * 8


def test_meter_few(server: Server) -> None:
    """Everything is timed; metered are the references, the controls and the configurations least alike."""
    rules = {"window_s": 30, "min_windows": 5, "max_windows": 9, "max_seconds": 600}
    sweep = server.add_sweep(
        axes={"gather_count": list(range(1, 11)), "global_photons": [1, 2, 3, 4]},
        repeats=2,
        controls=1,
        measure=rules | {"meter": "few", "metered_windows": 20},
    )
    jobs = server.get(f"/sweeps/{sweep['id']}/jobs", limit=200)["items"]
    metered = [job for job in jobs if job["metered"]]
    by_purpose = {purpose: sum(job["purpose"] == purpose for job in metered) for purpose in ("measure", "reference")}
    assert by_purpose == {"measure": 4, "reference": 1}
    assert {job["purpose"] for job in metered} == {"measure", "reference", "control"}
    corners = {(job["settings"]["gather_count"], job["settings"]["global_photons"])
               for job in metered if job["purpose"] == "measure"}  # fmt: skip
    assert corners == {(1, 1), (10, 4), (1, 4), (10, 1)}
    device = server.device()
    leases = [lease for _ in range(5) for lease in device.lease(max_jobs=20)]
    state = {job["id"]: job for job in jobs}
    assert len(leases) == len(jobs) == 2 * (40 + 1) + 2
    for lease in leases:
        job, measure = state[lease["job_id"]], lease["measure"]
        assert measure["meter"] == job["metered"]
        if job["purpose"] == "measure":
            asked = (measure["window_s"], measure["min_windows"], measure["max_windows"])
            assert asked == ((30, 5, 9) if job["metered"] else (10, 2, 2))


def test_meter_none(server: Server) -> None:
    """Every job is one image and its time: references and controls too."""
    sweep = server.add_sweep(axes={"gather_count": [1, 2]}, repeats=2, controls=1, measure={"meter": "none"})
    jobs = server.get(f"/sweeps/{sweep['id']}/jobs", limit=200)["items"]
    assert len(jobs) == 2 * (2 + 1) + 2
    assert not any(job["metered"] for job in jobs)
    assert [lease["measure"]["meter"] for lease in server.device().lease(max_jobs=20)] == [False] * len(jobs)


def disagreement(server: Server, device: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = server.get(f"/devices/{device}/disagreements")["items"]
    assert server.get(f"/devices/{device}")["disagreements"] == len(found)
    return found


def test_pictures_agree_or_not_within_a_class(server: Server) -> None:
    """Same build, system and instruction set: one bit is enough, and both devices show it."""
    fleet = {name: server.device(name) for name in ("one", "two", "three")}
    sweep = server.add_sweep(axes={}, repeats=1, devices=list(fleet))
    for name, device in fleet.items():
        while leased := device.lease():
            lease = leased[0]
            pixels = sha256(b"other" if name == "three" and lease["purpose"] == "reference" else b"same")
            image = picture(resolved(lease["settings"]))
            device.put_blob(image)
            device.put_result(lease, measure_document(lease, image, pixel_sha256=pixels))
    server.wait(sweep["id"], "done")
    assert disagreement(server, "two") == []
    (found,) = disagreement(server, "three")
    assert found == disagreement(server, "one")[0]
    assert (found["same_class"], found["device"], found["other_device"]) == (True, "three", "one")
    assert found["render_class"] == found["other_render_class"] == "fake 1, Debian 13, none"
    assert [flag["code"] for flag in server.get("/devices/three")["flags"]] == ["pictures_disagree"]


@pytest.mark.parametrize(("wrong", "count"), [(0.0, 0), (0.3, 1)])
def test_pictures_across_classes(server: Server, wrong: float, count: int) -> None:
    """Other bits are nothing as long as 99 % of the pixels differ by less than one JND."""
    server.device("laptop")
    server.device("phone", os="Android")
    fleet = {"laptop": 0.0, "phone": wrong}
    sweep = server.add_sweep(axes={}, repeats=1, devices=list(fleet), settings={"width": 64, "height": 64})
    tokens = {name: server.client.post(f"/v1/devices/{name}/token", headers=server.operator).json() for name in fleet}
    for step, (name, error) in enumerate(fleet.items()):
        device = FakeDevice(server.client, tokens[name]["token"], tokens[name]["device_id"])
        while leased := device.lease():
            lease = leased[0]
            image = np.full((64, 64, 3), 0.4, np.float32) + np.float32(step) * np.float32(1e-7)
            image[20:40, 20:40] += error if lease["purpose"] == "measure" else 0
            out = BytesIO()
            np.save(out, image)
            device.finish(lease, out.getvalue())
    server.wait(sweep["id"], "done")
    wait_for_checks(server)
    found = disagreement(server, "phone")
    assert len(found) == count
    for check in found:
        assert (check["same_class"], check["p99_jnd"] >= 1) == (False, True)
        assert {check["render_class"], check["other_render_class"]} == {
            "fake 1, Debian 13, none",
            "fake 1, Android, none",
        }


def wait_for_checks(server: Server) -> None:
    """Until no picture waits for its difference."""
    ends_s = time.monotonic() + 10
    while server.store.read(number, "SELECT count(*) FROM picture_check WHERE agrees IS NULL"):
        assert time.monotonic() < ends_s
        time.sleep(0.02)


def test_deleting_a_sweep_takes_its_checks_along(server: Server) -> None:
    """And leaves no file behind."""
    fleet = [server.device("laptop"), server.device("phone", os="Android")]
    sweep = server.add_sweep(axes={}, repeats=1, devices=["laptop", "phone"])
    fleet[0].work()
    while leased := fleet[1].lease():
        out = picture(resolved(leased[0]["settings"]) | {"seed": 99})
        fleet[1].finish(leased[0], out)
    server.wait(sweep["id"], "done")
    wait_for_checks(server)
    pair = {job["purpose"]: job for job in server.get("/results")["items"]}
    server.get(
        "/compare", reference=pair["reference"]["image_sha256"], test=pair["measure"]["image_sha256"], exposure=2.0
    )
    assert server.client.delete(f"/v1/sweeps/{sweep['id']}", headers=server.operator).status_code == 204
    files = [path for path in server.store.blob_dir.rglob("*") if path.is_file()]
    assert len(files) == 1  # the scene
    assert server.get("/devices/phone")["disagreements"] == 0
