"""Leases end, results come late or twice, devices restart: nothing is lost and nothing is done twice."""

import io
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_device import FakeDevice, measure_document, picture, resolved, scene_zip, sha256
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.store import Store, blobs, devices, leases, planning, results, scenes
from joulebox_server.store.database import number, rows
from joulebox_server.store.jobs import LeaseRules
from server_testing import Server, serving

RULES = LeaseRules(
    slack_s=300, release_pause_s=0, retry_pause_s=0, longest_retry_pause_s=0, max_attempts=3, suspect_after=5
)
PAST_ANY_LEASE_S = 10_000.0


def state_of(server: Server, job_id: str) -> dict[str, Any]:
    jobs = server.get(f"/sweeps/{server.get('/sweeps')['items'][0]['id']}/jobs")["items"]
    return next(job for job in jobs if job["id"] == job_id)


def test_lease_says_what_to_do(server: Server) -> None:
    sweep = server.add_sweep(scenes=[{"name": "box", "defines": {"size": "small"}}])
    device = server.device()
    second, first = device.lease(max_jobs=2)
    assert (second["purpose"], first["purpose"]) == ("reference", "noise_floor")
    assert second["sweep_id"] == sweep["id"]
    assert second["defines"] == {"size": "small"}
    assert second["scene"] == {"name": "box", "bundle_sha256": server.get("/scenes")["items"][0]["bundle_sha256"]}
    assert second["measure"] == {
        "window_s": 1.0,
        "min_windows": 2,
        "max_windows": 2,
        "half_width": 0.05,
        "max_seconds": 10.0,
        "meter": True,
    }
    assert not first["measure"]["meter"]
    assert second["settings"] == {"preset": "reference", "width": 32, "height": 32, "seed": 1000}


def test_expiry_and_late_result(server: Server) -> None:
    """After the lease ended another may do the job; the late result is kept as an extra repeat."""
    sweep = server.add_sweep(axes={}, repeats=1)
    slow, quick = server.device("slow"), server.device("quick")
    lost = slow.lease()[0]
    assert quick.lease() == []  # the sweep's one target is the device that took its first job
    server.clock.ahead_s = PAST_ANY_LEASE_S
    again = slow.lease()[0]
    assert again["job_id"] == lost["job_id"]
    assert again["attempt_id"] != lost["attempt_id"]
    late = slow.finish(lost)
    assert (late.status_code, late.json()) == (201, {"accepted": "late"})
    assert state_of(server, lost["job_id"])["state"] == "leased"
    repeated = slow.finish(lost)
    assert (repeated.status_code, repeated.json()) == (200, {"accepted": "late"})
    assert slow.finish(again).json() == {"accepted": "ok"}
    slow.work()
    server.wait(sweep["id"], "done")
    found = [row["job_id"] for row in server.get("/results")["items"]]
    assert len(found) == 4
    assert found.count(lost["job_id"]) == 2


def test_late_result_answers_for_a_later_attempt_that_fails(server: Server) -> None:
    """While another attempt runs, a late result changes nothing; when that one is given back, nobody starts anew."""
    server.add_sweep(axes={}, repeats=1)
    device = server.device()
    slow = device.lease()[0]
    server.clock.ahead_s = PAST_ANY_LEASE_S
    again = device.lease()[0]
    assert again["job_id"] == slow["job_id"]
    assert device.finish(slow).json() == {"accepted": "late"}
    path = f"/v1/attempts/{again['attempt_id']}/release"
    server.client.post(path, headers=device.headers, json={"reason": "warm"})
    assert state_of(server, slow["job_id"])["state"] == "done"


def test_what_a_cancelled_sweep_gets_back_is_not_queued(server: Server) -> None:
    sweep = server.add_sweep(axes={}, repeats=1)
    device = server.device()
    lease = device.lease()[0]
    server.client.patch(f"/v1/sweeps/{sweep['id']}", headers=server.operator, json={"action": "cancel"})
    path = f"/v1/attempts/{lease['attempt_id']}/release"
    server.client.post(path, headers=device.headers, json={"reason": "stopped"})
    assert state_of(server, lease["job_id"])["state"] == "cancelled"


def test_late_result_answers_a_waiting_job(server: Server) -> None:
    server.add_sweep(axes={}, repeats=1)
    device = server.device()
    lease = device.lease()[0]
    server.clock.ahead_s = PAST_ANY_LEASE_S
    assert device.finish(lease).json() == {"accepted": "late"}
    assert state_of(server, lease["job_id"])["state"] == "done"


def test_expiry_spends_attempts(server: Server) -> None:
    """A job that silences its device three times fails, with the reason; retrying it is one request."""
    sweep = server.add_sweep(axes={}, repeats=1)
    device = server.device()
    for _ in range(3):
        lease = device.lease()[0]
        server.clock.ahead_s += PAST_ANY_LEASE_S
    device.lease()
    job = state_of(server, lease["job_id"])
    assert (job["state"], job["attempts"]) == ("failed", 3)
    assert "'laptop' fell silent" in job["reason"]
    device.boot_id = "boot-2"  # gives back what the last lease took
    device.work()
    server.wait(sweep["id"], "failed")
    retried = server.client.post(f"/v1/sweeps/{sweep['id']}:retry-failed", headers=server.operator).json()
    assert (retried["retried"], retried["state"]) == (1, "running")
    device.work()
    assert server.wait(sweep["id"], "done")["jobs"]["done"] == 3


def test_reaper_works_without_asking_devices(tmp_path: Path, executor: Any) -> None:
    with serving(tmp_path, executor, reap_every_s=0.05) as server:
        server.add_scene()
        server.add_sweep(axes={}, repeats=1)
        lease = server.device().lease()[0]
        server.clock.ahead_s = PAST_ANY_LEASE_S
        for _ in range(100):
            if state_of(server, lease["job_id"])["state"] == "queued":
                return
            threading.Event().wait(0.05)
        raise AssertionError("the lease was never taken back")


def test_same_and_other_body(server: Server) -> None:
    server.add_sweep()
    device = server.device()
    lease = device.lease()[0]
    first = device.finish(lease)
    assert (first.status_code, first.json()) == (201, {"accepted": "ok"})
    assert device.finish(lease).status_code == 200
    other = device.finish(lease, images=51)
    assert other.status_code == 409
    assert other.json()["code"] == "conflict"
    assert [row["images"] for row in server.get("/results")["items"]] == [50]


def test_release(server: Server) -> None:
    """Not fit to measure now spends no attempt; a renderer that refuses does."""
    server.add_sweep(axes={}, repeats=1)
    device = server.device()
    lease = device.lease()[0]
    path = f"/v1/attempts/{lease['attempt_id']}/release"
    for _ in range(2):  # the second time nothing happens
        answer = server.client.post(path, headers=device.headers, json={"reason": "on mains power"})
        assert answer.status_code == 204
    assert state_of(server, lease["job_id"])["attempts"] == 0
    for _ in range(3):
        lease = device.lease()[0]
        body = {"reason": "settings refused: no such filter", "failed": True}
        path = f"/v1/attempts/{lease['attempt_id']}/release"
        server.client.post(path, headers=device.headers, json=body)
    job = state_of(server, lease["job_id"])
    assert (job["state"], job["reason"]) == ("failed", "settings refused: no such filter")


def test_release_pause(tmp_path: Path, executor: Any) -> None:
    """A job given back unmeasured is not handed out again at once, or a warm device would spin."""
    with serving(tmp_path, executor, release_pause_s=60) as server:
        server.add_scene()
        server.add_sweep(axes={}, repeats=1)
        device = server.device()
        ids = set()
        for _ in range(3):
            lease = device.lease()[0]
            ids.add(lease["job_id"])
            path = f"/v1/attempts/{lease['attempt_id']}/release"
            server.client.post(path, headers=device.headers, json={"reason": "warm"})
        assert len(ids) == 3
        assert device.lease() == []
        server.clock.ahead_s = 61
        assert len(device.lease()) == 1


def test_a_clock_that_was_a_year_ahead(tmp_path: Path, executor: Any) -> None:
    """Set right, it leaves no lease and no pause that lasts until next year."""
    with serving(tmp_path, executor, reap_every_s=0.02, release_pause_s=60) as server:
        server.add_scene()
        server.add_sweep(axes={}, repeats=1)
        device = server.device()
        server.clock.ahead_s = 365 * 86_400
        silent, given_back = device.lease(max_jobs=2)
        path = f"/v1/attempts/{given_back['attempt_id']}/release"
        server.client.post(path, headers=device.headers, json={"reason": "warm"})
        server.clock.ahead_s = 0
        ends_s = time.monotonic() + 5
        while time.monotonic() < ends_s and server.store.read(last_end_us) > server.clock() + PAST_ANY_LEASE_S * 1e6:
            time.sleep(0.02)
        server.clock.ahead_s = PAST_ANY_LEASE_S
        again = {lease["job_id"] for lease in device.lease(max_jobs=20)}
        assert {silent["job_id"], given_back["job_id"]} <= again


def last_end_us(db: Any) -> int:
    """When the last lease ends."""
    return int(db.execute("SELECT max(expires_at_us) FROM attempt WHERE state = 'leased'").fetchone()[0])


def test_a_scene_sent_again_after_the_clock_was_set_back(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name means what was sent last, whatever the clock said when."""
    newer = scene_zip("<scene version='3.0.0' />")
    with monkeypatch.context() as ahead:
        ahead.setattr("joulebox_server.store.scenes.now_us", lambda: server.clock() + 3_600_000_000)
        server.add_scene("clocked")
    assert server.add_scene("clocked", newer)["bundle_sha256"] == sha256(newer)
    shown = {scene["name"]: scene["bundle_sha256"] for scene in server.get("/scenes")["items"]}
    assert shown["clocked"] == sha256(newer)


def test_restarted_device_gives_back_at_once(server: Server) -> None:
    server.add_sweep(axes={}, repeats=1)
    device = server.device()
    before = device.lease()[0]
    device.boot_id = "boot-2"
    again = device.lease(max_jobs=10)
    assert before["job_id"] in [lease["job_id"] for lease in again]
    assert device.finish(before).json() == {"accepted": "late"}


def test_a_lease_whose_answer_was_lost(server: Server) -> None:
    """A device that says what it holds gets back at once what it never heard of; one that does not say, does not."""
    server.add_sweep(axes={}, repeats=1)
    device = server.device()
    lost = device.lease()[0]
    kept = device.lease(holding=[lost["attempt_id"]])[0]
    assert kept["job_id"] != lost["job_id"]
    assert lost["job_id"] not in [lease["job_id"] for lease in device.lease(max_jobs=5)]
    again = device.lease(holding=[kept["attempt_id"]])[0]
    assert again["job_id"] == lost["job_id"]
    assert "never got the lease" in state_of(server, lost["job_id"])["reason"]
    assert device.finish(kept).json() == {"accepted": "ok"}
    assert device.finish(lost).json() == {"accepted": "late"}


def test_voided_measurement_is_measured_again(server: Server) -> None:
    server.add_sweep(axes={}, repeats=1)
    device = server.device()
    lease = device.lease()[0]
    void = {"void": "mains power appeared at 12.3 s", "time_s_per_image": None, "image_blob": None}
    assert device.put_result(lease, measure_document(lease, **void)).status_code == 201
    job = state_of(server, lease["job_id"])
    assert (job["state"], job["attempts"]) == ("queued", 1)
    assert "mains power appeared at 12.3 s" in job["reason"]


def test_health_and_requirements(server: Server) -> None:
    """A device in maintenance gets nothing; a target is taken only by a device that fits."""
    server.add_sweep(axes={}, repeats=1, requires={"machine": "aarch64", "min_cores": 4})
    laptop, phone = server.device(), server.device("phone", machine="aarch64", cores=8)
    assert laptop.lease() == []
    path = f"/v1/devices/{phone.device_id}"
    server.client.patch(path, headers=server.operator, json={"health": "maintenance"})
    assert phone.lease() == []
    server.client.patch(path, headers=server.operator, json={"health": "good"})
    assert len(phone.lease()) == 1


def test_pause_resume_cancel(server: Server) -> None:
    sweep = server.add_sweep()
    path = f"/v1/sweeps/{sweep['id']}"
    device = server.device()
    lease = device.lease()[0]

    def act(action: str) -> Any:
        return server.client.patch(path, headers=server.operator, json={"action": action})

    assert act("pause").json()["state"] == "paused"
    assert device.lease() == []
    assert act("resume").json()["state"] == "running"
    cancelled = act("cancel").json()
    assert (cancelled["state"], cancelled["jobs"]["cancelled"], cancelled["jobs"]["leased"]) == ("cancelled", 5, 1)
    assert device.finish(lease).json() == {"accepted": "ok"}  # what was being measured is kept
    assert act("resume").status_code == 409
    assert device.lease() == []


def test_revoked_device(server: Server) -> None:
    server.add_sweep()
    device = server.device()
    rotated = server.client.post(f"/v1/devices/{device.device_id}/token", headers=server.operator).json()["token"]
    old, device.token = device.token, rotated
    assert server.client.get("/v1/scenes", headers={"Authorization": f"Bearer {old}"}).status_code == 401
    assert device.lease()
    assert server.client.delete("/v1/devices/laptop", headers=server.operator).status_code == 204
    answer = server.client.post("/v1/leases", headers=device.headers, json={"boot_id": "b"})
    assert (answer.status_code, "revoked" in answer.json()["detail"]) == (401, True)
    assert server.get("/devices")["items"] == []
    server.device()  # the name is free again


def test_order_is_blocks_in_random_order(server: Server) -> None:
    """References first, then every configuration once a block, in an order of its own a block."""
    server.add_sweep(axes={"gather_count": list(range(1, 9))}, repeats=3)
    device = server.device()
    found = device.lease(max_jobs=20) + device.lease(max_jobs=20)
    assert {lease["purpose"] for lease in found[:2]} == {"reference", "noise_floor"}
    counts = [lease["settings"]["gather_count"] for lease in found[2:]]
    assert sorted(counts[:8]) == sorted(counts[8:16]) == list(range(1, 9))
    assert counts[:8] != counts[8:16]


def test_eight_threads_never_share_a_job(tmp_path: Path) -> None:
    """Eight threads on the store: every job leased once, every result kept, no lock error."""
    store = Store(tmp_path)
    with blobs.Incoming(store.incoming_dir, 1000) as incoming:
        incoming.write(b"bundle")
        bundle = incoming.finish()
        store.write(blobs.adopt, store.blob_dir, incoming, bundle)
    store.write(scenes.put, "box", bundle)
    definition = SweepDefinition(name="race", scenes=["box"], axes={"seed": list(range(120))}, repeats=1)  # type: ignore[list-item]
    device_id, _ = store.write(devices.enroll, "racer", "boot")
    store.write(planning.create_once, definition, None)
    now_us = 1_700_000_000_000_000

    def work(_: int) -> list[str]:
        taken = []
        while store.read(leases.work_waits, device_id, now_us):
            for lease in store.write(leases.lease, device_id, "boot", {}, 1, RULES, now_us):
                taken.append(lease.job_id)
                body = measure_document(lease.model_dump(), b"", image_blob=None)
                document = results.MeasureDocument.model_validate(body)
                store.write(results.accept, store.blob_dir, lease.attempt_id, device_id, document, RULES, now_us)
        return taken

    with ThreadPoolExecutor(8) as pool:
        taken = [job_id for jobs in pool.map(work, range(8)) for job_id in jobs]
    assert len(taken) == len(set(taken)) == 122
    assert store.read(number, "SELECT count(*) FROM result") == 122
    assert store.read(rows, "SELECT state FROM sweep") == [{"state": "done"}]
    store.close()


def test_eight_devices_over_http(live: Server) -> None:
    """Eight devices at once through a real port: each measures its own jobs, nothing is lost."""
    fleet = [live.device(f"device-{i}") for i in range(8)]
    sweep = live.add_sweep(devices=[device.device_id for device in fleet], repeats=1)
    with ThreadPoolExecutor(8) as pool:
        counts = list(pool.map(FakeDevice.work, fleet))
    assert counts == [4] * 8
    done = [job_id for device in fleet for job_id in device.done]
    assert len(set(done)) == 32
    assert live.wait(sweep["id"], "done")["jobs"]["done"] == 32
    assert len(live.get("/results", limit=200)["items"]) == 32


def test_long_poll_ends_with_the_first_job(live: Server) -> None:
    device = live.device()
    found: list[Any] = []
    waiting = threading.Thread(target=lambda: found.extend(device.lease(wait_s=15)))
    waiting.start()
    live.add_sweep(axes={}, repeats=1)
    waiting.join(10)
    assert len(found) == 1
    answer = live.client.post("/v1/leases", headers=device.headers, json={"boot_id": "boot-1", "max_jobs": 20})
    assert answer.status_code == 200
    empty = live.client.post("/v1/leases", headers=device.headers, json={"boot_id": "boot-1", "wait_s": 0.1})
    assert empty.status_code == 204
    assert int(empty.headers["retry-after"]) > 0


def test_pictures_that_cannot_be_compared(server: Server) -> None:
    """NaN pixels or another size: the sentence is on the job, the measured energy stays, the sweep ends."""
    sweep = server.add_sweep(axes={"gather_count": [10, 20, 30]}, repeats=1)
    device = server.device()

    def stored(image: Any) -> bytes:
        out = io.BytesIO()
        np.save(out, image.astype(np.float32))
        return out.getvalue()

    holes = np.ones((32, 32, 3))
    holes[3, 4] = np.nan
    odd = {10: stored(holes), 20: stored(np.ones((16, 32, 3))), 30: b"no picture at all"}
    while leased := device.lease():
        lease = leased[0]
        special = odd.get(lease["settings"].get("gather_count"))
        device.finish(lease, special or picture(resolved(lease["settings"])))
    assert server.wait(sweep["id"], "done")["jobs"]["done"] == 5
    reasons = {
        job["settings"].get("gather_count"): job["reason"]
        for job in server.get(f"/sweeps/{sweep['id']}/jobs")["items"]
        if job["purpose"] == "measure"
    }
    assert "the test image has 1 pixel with NaN or infinity, the first at row 3, column 4" in reasons[10]
    assert "the reference image is 32 x 32 pixels and the test image 32 x 16" in reasons[20]
    assert "the test image is no picture that can be read" in reasons[30]
    points = server.get(f"/sweeps/{sweep['id']}/tradeoff")["points"]
    assert [point["difference"] for point in points] == [None] * 3
    assert all(point["energy_j"] for point in points)
