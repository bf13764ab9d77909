"""Whose fault a failure is: a device's that fails where others do not, or the work's that fails everywhere."""

from typing import Any

from fake_device import FakeDevice
from server_testing import Server

MANY = {"gather_count": list(range(1, 13))}
"""More configurations than failures make a device suspect (five)."""


def give_back(server: Server, device: FakeDevice, lease: dict[str, Any], *, failed: bool) -> None:
    path = f"/v1/attempts/{lease['attempt_id']}/release"
    body = {"reason": "no such filter", "failed": failed}
    assert server.client.post(path, headers=device.headers, json=body).status_code == 204


def fail_all(server: Server, device: FakeDevice, most: int = 1000) -> int:
    """Fail in every job there is, or so many; returns how many."""
    for count in range(most):
        leases = device.lease()
        if not leases:
            return count
        give_back(server, device, leases[0], failed=True)
    return most


def health(server: Server, name: str) -> tuple[str, int]:
    shown = server.get(f"/devices/{name}")
    return shown["health"], shown["failures_in_row"]


def test_a_scene_that_nobody_renders_makes_no_device_suspect(server: Server) -> None:
    """One device alone: every job of the bad scene fails, and the next sweep's jobs are still given to it."""
    bad = server.add_sweep(axes=MANY, repeats=1)
    device = server.device()
    assert fail_all(server, device) == 3 * bad["jobs"]["total"]
    assert health(server, "laptop") == ("good", 3 * bad["jobs"]["total"])
    assert server.wait(bad["id"], "failed")["jobs"]["failed"] == bad["jobs"]["total"]
    server.add_scene("other")
    good = server.add_sweep(scenes=["other"], axes={}, repeats=1)
    device.work()
    assert server.wait(good["id"], "done")
    assert health(server, "laptop") == ("good", 0)


def test_unread_scenes_count_once_each(server: Server) -> None:
    """A device that fails at five scenes is suspect, whatever else may be wrong with them."""
    names = [f"scene-{number}" for number in range(5)]
    for name in names:
        server.add_scene(name)
    device = server.device()
    for number, name in enumerate(names):
        assert health(server, "laptop")[0] == "good", number
        swept = server.add_sweep(name=name, scenes=[name], axes=MANY, repeats=1)
        fail_all(server, device, 4)
        server.client.patch(f"/v1/sweeps/{swept['id']}", headers=server.operator, json={"action": "cancel"})
    assert health(server, "laptop")[0] == "suspect"


def test_work_that_fails_on_another_device_too_blames_neither(server: Server) -> None:
    """The scene renders, these settings do not: on the second device their failures do not count."""
    first, second = server.device("first"), server.device("second")
    proof = server.add_sweep(name="proof", axes={}, repeats=1, devices=["first", "second"])
    first.work()
    second.work()
    assert server.wait(proof["id"], "done")
    # Settings of their own, which nothing of the sweep before has done.
    settings = {"width": 64, "height": 64}
    server.add_sweep(name="hard", settings=settings, axes=MANY, repeats=1, devices=["first", "second"])
    assert fail_all(server, first) == 5
    assert health(server, "first")[0] == "suspect"  # nobody else had tried yet
    server.client.patch("/v1/devices/first", headers=server.operator, json={"health": "maintenance"})
    jobs = {job["id"]: job for job in server.get("/sweeps/hard/jobs", limit=200)["items"]}
    tried = {job["configuration_id"] for job in jobs.values() if job["device"] == "first" and job["attempts"]}
    failures = 0
    for _ in range(3):
        for lease in second.lease(max_jobs=20):
            failed = jobs[lease["job_id"]]["configuration_id"] in tried
            give_back(server, second, lease, failed=failed)
            failures += failed
    assert health(server, "second") == ("good", failures)
    assert failures > 5


def test_a_device_that_fails_where_another_does_not_is_suspect(server: Server) -> None:
    """It has rendered nothing itself, but the other has: five failures count as five."""
    good, bad = server.device("sound"), server.device("broken")
    server.add_sweep(axes=MANY, repeats=1, devices=["sound", "broken"])
    assert fail_all(server, bad, 6) == 6
    assert health(server, "broken") == ("good", 6)  # the scene may be at fault: nobody has rendered it
    good.work()
    assert fail_all(server, bad) == 1  # now it is known that it is not
    assert health(server, "broken") == ("suspect", 7)
    assert server.get("/devices/broken")["health_reason"] == "7 failures in a row, the last: no such filter"
    assert health(server, "sound") == ("good", 0)


def test_failing_in_company_is_no_excuse_for_work_that_is_done(server: Server) -> None:
    """Two devices fail, a third does the same work: both are suspect."""
    sound, *broken = [server.device(name) for name in ("sound", "one", "two")]
    server.add_sweep(axes=MANY, repeats=1, devices=["sound", "one", "two"])
    sound.work()
    for device in broken:
        assert fail_all(server, device) == 5
    assert [health(server, name)[0] for name in ("sound", "one", "two")] == ["good", "suspect", "suspect"]


def test_a_good_result_and_an_operator_forgive(server: Server) -> None:
    """What came before does not count again, beside five failures that count as one."""
    server.add_scene("other")
    server.add_sweep(axes=MANY, repeats=1)
    device = server.device()
    device.work(1)

    def good_result() -> None:
        assert device.work(1) == 1

    def operator() -> None:
        server.client.patch("/v1/devices/laptop", headers=server.operator, json={"health": "good"})

    for number, forgive in enumerate((good_result, operator)):
        assert fail_all(server, device, 4) == 4
        forgive()
        server.client.patch("/v1/sweeps/small", headers=server.operator, json={"action": "pause"})
        unread = server.add_sweep(name=f"unread {number}", scenes=["other"], axes=MANY, repeats=1)
        assert fail_all(server, device, 5) == 5
        assert health(server, "laptop") == ("good", 5)
        server.client.patch(f"/v1/sweeps/{unread['id']}", headers=server.operator, json={"action": "cancel"})
        server.client.patch("/v1/sweeps/small", headers=server.operator, json={"action": "resume"})
        operator()
