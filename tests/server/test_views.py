"""What the dashboard asks beside the documents themselves: devices, progress, pasted files, points, traces, pixels."""

import io
import json
import time
from typing import Any

import numpy as np
import pytest
from fake_device import picture, resolved
from server_testing import Server

WINDOWS = [{"start_s": 1.0, "time_s": 2.0, "images": 4, "energy_j": 20.0}]
SAMPLES = b"".join(json.dumps({"time_s": 0.5 * k, "power_w": 10.0 + k}).encode() + b"\n" for k in range(8))


@pytest.fixture
def filled(server: Server) -> Server:
    """A sweep whose first metered job has a discharge trace and a battery."""
    server.add_scene()
    device = server.device()
    server.add_sweep(controls=1)
    battery = {"battery_charge_share": 0.5, "battery_full_j": 100_000.0, "mains_online": False}
    for lease in iter(lambda: device.lease(), []):
        samples = device.put_blob(SAMPLES)
        traced = {"power_samples": samples, "window_data": WINDOWS, "conditions": {"before": {}, "after": battery}}
        assert device.finish(lease[0], **traced).status_code == 201
    server.wait(server.get("/sweeps/small")["id"], "done")
    return server


def test_the_fleet_tells_battery_meter_and_control_run(filled: Server) -> None:
    filled.device("new")
    told = {state["device"]: state for state in filled.get("/fleet")["items"]}
    assert told["new"] == {"device": "new", "result_at": None, "battery": None, "meter": None, "control": None}
    assert told["laptop"]["battery"] == {"charge_share": 0.5, "full_j": 100_000.0, "on_mains": False}
    assert told["laptop"]["meter"]["half_width_share"] in (None, pytest.approx(0.02))
    control = told["laptop"]["control"]
    assert (control["scene"], control["time_ratio"]) == ("box", pytest.approx(1.0))


def test_the_fleet_comes_in_pages(server: Server) -> None:
    for name in ("a", "b", "c"):
        server.device(name)
    first = server.get("/fleet", limit=2)
    assert [state["device"] for state in first["items"]] == ["a", "b"]
    assert [state["device"] for state in server.get("/fleet", cursor=first["next"])["items"]] == ["c"]


def test_an_end_is_expected_from_the_jobs_that_are_done(server: Server) -> None:
    """Every job takes 100 s: what is left takes 100 s each, and scatters not at all."""
    server.add_scene()
    sweep = server.add_sweep()["id"]
    assert "no device has taken a job" in server.get(f"/sweeps/{sweep}/progress")["reason"]
    device = server.device()
    total = server.get(f"/sweeps/{sweep}")["jobs"]["total"]
    for _ in range(3):
        (lease,) = device.lease()
        server.clock.ahead_s += 100
        device.finish(lease)
    told = server.get(f"/sweeps/{sweep}/progress")
    assert told["reason"] is None
    left = told["remaining_s"]
    assert left["value"] == pytest.approx(100 * (total - 3), rel=0.05)
    assert left["low"] <= left["value"] <= left["high"]
    server.client.patch(f"/v1/sweeps/{sweep}", headers=server.operator, json={"action": "pause"})
    assert "resume" in server.get(f"/sweeps/{sweep}/progress")["reason"]


TWICE = '{"name": "x", "name": "y"}'


def read(server: Server, text: str) -> Any:
    headers = server.operator | {"Content-Type": "text/plain"}
    return server.client.post("/v1/sweeps:read", content=text.encode(), headers=headers)


def test_a_pasted_file_is_read_as_toml_or_json(server: Server) -> None:
    server.add_scene()
    toml = 'name = "x"\nscenes = ["../scenes/box", {path = "there/box", defines = {a = "1"}}, "box", "hall"]\n'
    told = read(server, toml).json()
    assert told["definition"]["scenes"] == [{"name": "box"}, {"name": "box", "defines": {"a": "1"}}, "box", "hall"]
    assert len(told["notes"]) == 2
    assert read(server, '{"name": "x", "scenes": ["box"]}').json()["definition"] == {"name": "x", "scenes": ["box"]}
    for wrong, word in (
        ("name = ", "TOML"),
        ("{", "JSON"),
        (TWICE, "stands twice"),
        ("", "holds nothing"),
        ("[" * 5000, "TOML"),
    ):
        answer = read(server, wrong)
        assert answer.status_code == 422
        assert word in answer.json()["detail"]


def test_one_point(filled: Server) -> None:
    points = filled.get("/sweeps/small/tradeoff")["points"]
    assert filled.get(f"/sweeps/small/points/{points[0]['configuration_id']}") == points[0]
    answer = filled.client.get("/v1/sweeps/small/points/none")
    assert answer.status_code == 404
    assert "has no result on laptop" in answer.json()["detail"]


def test_a_trace_shows_power_and_windows(filled: Server) -> None:
    point = filled.get("/sweeps/small/tradeoff")["points"][0]["configuration_id"]
    spec = filled.get("/sweeps/small/charts/trace.vl.json", point=point)
    windows, line = (layer["data"]["values"] for layer in spec["layer"])
    assert [(row["time_s"], row["end_s"], row["told"]) for row in windows] == [(1.0, 3.0, "4 image(s) in 2 s, 20 J")]
    assert [row["power_w"] for row in line] == [10.0 + k for k in range(8)]
    assert filled.client.get(f"/v1/sweeps/small/charts/trace.svg?point={point}").content.startswith(b"<svg")


def test_without_a_meter_there_is_no_trace(server: Server) -> None:
    server.add_scene()
    device = server.device()
    server.wait(server.add_sweep()["id"], "running")
    device.work()
    point = server.get("/sweeps/small/tradeoff")["points"][0]["configuration_id"]
    answer = server.client.get(f"/v1/sweeps/small/charts/trace.vl.json?point={point}")
    assert (answer.status_code, answer.json()["code"]) == (422, "not_answerable")


def test_pictures_as_numbers(filled: Server) -> None:
    """A portable float map: last row first, little-endian, to the bit what the device sent."""
    point = filled.get("/sweeps/small/tradeoff")["points"][0]
    content = filled.client.get(f"/v1/images/{point['image_sha256']}.pfm").content
    head, size, scale, rest = content.split(b"\n", 3)
    width, height = map(int, size.split())
    assert (head, scale) == (b"PF", b"-1.0")
    sent = np.load(io.BytesIO(picture(resolved(point["settings"]))))
    found = np.frombuffer(rest, "<f4").reshape(height, width, 3)[::-1]
    assert np.array_equal(found, sent)


def test_charts_are_sent_again_only_when_they_changed(server: Server) -> None:
    """The same ETag is 304; a new result, or another view, is another chart."""
    server.add_scene()
    device = server.device()
    sweep = server.add_sweep()["id"]
    path = f"/v1/sweeps/{sweep}/charts/tradeoff.vl.json"
    tags = []
    for more in (0, 3, 0, 100):
        device.work(more)
        while server.get(f"/sweeps/{sweep}")["differences_pending"]:
            time.sleep(0.02)
        tags.append(server.client.get(path).headers["etag"])
    assert tags[1] == tags[2]
    assert len({tags[0], tags[1], tags[3]}) == 3
    assert server.client.get(path, headers={"If-None-Match": tags[3]}).status_code == 304
    assert server.client.get(path + "?y=difference_per_pixel", headers={"If-None-Match": tags[3]}).status_code == 200
    told = [server.get(f"/sweeps/{sweep}/charts/tradeoff.vl.json", colour_by="global_photons")["usermeta"]]
    told.append(server.get(f"/sweeps/{sweep}/tradeoff"))
    assert told[0]["point_count"] == len(told[1]["points"])
