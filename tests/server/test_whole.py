"""From an empty server to a recommendation, with a device that answers by a formula."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
from fake_device import picture, resolved, sha256
from joulebox_server.analysis.difference import Display, compare
from joulebox_server.analysis.images import read_picture
from server_testing import Server, serving


@pytest.fixture
def measured(server: Server) -> tuple[Server, dict[str, Any]]:
    """A server with a sweep of one axis, measured to its end."""
    sweep = server.add_sweep(axes={"global_photons": [10_000, 50_000, 100_000]})
    assert server.device().work() == 3 * 2 + 2
    return server, server.wait(sweep["id"], "done")


def test_jobs_and_state(measured: tuple[Server, dict[str, Any]]) -> None:
    server, sweep = measured
    assert sweep["jobs"] == {"total": 8, "queued": 0, "leased": 0, "done": 8, "failed": 0, "cancelled": 0}
    assert sweep["devices"] == ["laptop"]
    assert sweep["differences_pending"] == 0
    jobs = server.get(f"/sweeps/{sweep['id']}/jobs")["items"]
    seeds = {(job["purpose"], job["repeat"]): job["settings"]["seed"] for job in jobs}
    assert seeds == {("measure", 0): 0, ("measure", 1): 1, ("reference", 0): 1000, ("noise_floor", 0): 2000}
    reference = next(job for job in jobs if job["purpose"] == "reference")
    assert reference["settings"] == {"preset": "reference", "width": 32, "height": 32, "seed": 1000}


def test_tradeoff_is_what_the_pictures_say(measured: tuple[Server, dict[str, Any]], tmp_path: Path) -> None:
    """The server's values equal the metric computed here on the same pictures."""
    server, sweep = measured
    found = server.get(f"/sweeps/{sweep['id']}/tradeoff")

    def shown(settings: dict[str, Any]) -> Any:
        path = tmp_path / "picture.npy"
        path.write_bytes(picture(resolved(settings)))
        return read_picture(path)

    film = {"width": 32, "height": 32}
    reference = shown({**film, "preset": "reference", "seed": 1000})
    for point in found["points"]:
        photons = point["settings"]["global_photons"]
        expected = [
            compare(reference, shown({**film, "global_photons": photons, "seed": seed}), Display()).value
            for seed in (0, 1)
        ]
        assert point["difference"]["value"] == pytest.approx(sum(expected) / 2, rel=1e-6)
        assert point["energy_j"]["value"] == pytest.approx(10 * (0.1 + photons / 100_000), abs=1e-6)
        assert point["repeats"] == 2
        assert point["opinions"].keys() == {"flip_mean", "ssim", "rmse_srgb", "relmse"}
    floor = compare(reference, shown({**film, "preset": "reference", "seed": 2000}), Display()).value
    assert found["noise_floor"]["value"] == pytest.approx(floor, rel=1e-6)
    assert found["limit"] == pytest.approx(100 * 32 * 32 / 65_536)
    assert found["energy_quality"] == "measured"
    assert found["axes"] == ["global_photons"]
    assert found["reference"]["energy_j"]["value"] == pytest.approx(26.0)


def test_recommendation_meets_the_budget(measured: tuple[Server, dict[str, Any]]) -> None:
    server, sweep = measured
    path = f"/sweeps/{sweep['id']}/recommendation"
    generous = {"difference_limit": 1e6}
    by_joules = server.get(path, budget_j=7, **generous)
    assert by_joules["answer"] == "settings"
    assert by_joules["settings"]["global_photons"] == 50_000
    assert by_joules["energy_j"]["high"] <= 7
    assert by_joules["saves_share"] == pytest.approx(1 - 6 / 26)
    # 7 J an image are 7 Wh for 3600 images
    assert server.get(path, budget_wh=7, images=3600, **generous)["label"] == by_joules["label"]
    assert server.get(path, budget_s=0.3, **generous)["settings"]["global_photons"] == 10_000
    nothing = server.get(path, budget_j=0.5)
    assert nothing["answer"] == "none"
    assert len(nothing["nearest"]) == 2


def test_charts(measured: tuple[Server, dict[str, Any]]) -> None:
    server, sweep = measured
    charts = f"/v1/sweeps/{sweep['id']}/charts"
    for name in ("tradeoff", "stages"):
        spec = server.client.get(f"{charts}/{name}.vl.json")
        assert spec.json()["$schema"].startswith("https://vega.github.io/schema/vega-lite/")
    svg = server.client.get(f"{charts}/tradeoff.svg", params={"x": "time_s", "budget": 0.5})
    assert svg.headers["content-type"] == "image/svg+xml"
    assert svg.text.startswith("<svg")
    png = server.client.get(f"{charts}/tradeoff.png", params={"y": "difference_per_pixel", "scale": "log"})
    assert png.content.startswith(b"\x89PNG")


def test_pictures(measured: tuple[Server, dict[str, Any]]) -> None:
    server, sweep = measured
    point = server.get(f"/sweeps/{sweep['id']}/tradeoff")["points"][0]
    pair = {"reference": point["reference_image_sha256"], "test": point["image_sha256"]}
    found = server.get("/compare", **pair)
    assert found["metric"] == "ltdiff-style"
    assert math.isfinite(found["value"])
    delta = server.client.get(f"/v1/images/{found['delta_sha256']}.png")
    assert delta.content.startswith(b"\x89PNG")
    assert sha256(delta.content) == found["delta_sha256"]
    small = server.client.get(f"/v1/images/{pair['test']}.png", params={"exposure": 3, "width": 8})
    assert small.headers["content-type"] == "image/png"
    assert "immutable" in small.headers["cache-control"]
    # another display is another difference, computed on the spot
    assert server.get("/compare", **pair, exposure=3.0)["value"] != found["value"]


def test_export(measured: tuple[Server, dict[str, Any]]) -> None:
    server, sweep = measured
    lines = server.client.get("/v1/results", params={"format": "ndjson", "sweep": sweep["id"]}).text.splitlines()
    assert len(lines) == 8
    first_page = server.get("/results", limit=5)
    rest = server.get("/results", limit=5, cursor=first_page["next"])
    assert [row["id"] for row in first_page["items"] + rest["items"]] == [json.loads(line)["id"] for line in lines]
    assert rest["next"] is None
    table = server.client.get("/v1/results", params={"format": "csv"}).text.splitlines()
    assert len(table) == 9
    assert table[0].startswith("id,sweep_id,job_id,scene,device,purpose")


def test_same_seed_policy(server: Server) -> None:
    """Each repeat is compared with the reference of its own seed."""
    sweep = server.add_sweep(
        axes={}, settings={"width": 32, "height": 32, "seed": 7}, reference={"settings": {}, "seed_policy": "same"}
    )
    server.device().work()
    server.wait(sweep["id"], "done")
    jobs = server.get(f"/sweeps/{sweep['id']}/jobs")["items"]
    seeds = sorted((job["purpose"], job["settings"]["seed"]) for job in jobs)
    assert seeds == [("measure", 7), ("measure", 8), ("noise_floor", 2007), ("reference", 7), ("reference", 8)]
    found = server.get(f"/sweeps/{sweep['id']}/tradeoff")
    assert found["seed_policy"] == "same"
    assert len(found["points"]) == 1


def test_two_devices_and_scenes(server: Server) -> None:
    """Each device measures every scene; a scene's defines make it another one."""
    server.add_scene("bunny")
    devices = [server.device(name) for name in ("one", "two")]
    sweep = server.add_sweep(
        scenes=[
            "box",
            {"name": "bunny", "defines": {"detail": "948"}},
            {"name": "bunny", "defines": {"detail": "3850"}},
        ],
        devices=["one", devices[1].device_id],
        repeats=1,
    )
    assert sweep["jobs"]["total"] == 2 * 3 * (2 + 2)
    assert [device.work() for device in devices] == [12, 12]
    done = server.wait(sweep["id"], "done")
    assert done["scenes"] == ["box", "bunny detail=948", "bunny detail=3850"]
    assert done["devices"] == ["one", "two"]
    found = server.get(f"/sweeps/{sweep['id']}/tradeoff", scene="bunny detail=948", device="two")
    assert (found["scene"], found["device"]) == ("bunny detail=948", "two")
    assert all(point["difference"] for point in found["points"])
    ambiguous = server.client.get(f"/v1/sweeps/{sweep['id']}/tradeoff", params={"scene": "bunny"})
    assert ambiguous.status_code == 404
    assert "bunny detail=948, bunny detail=3850" in ambiguous.json()["detail"]


@pytest.mark.parametrize("policy", ["other", "same"])
def test_reference_that_comes_last(tmp_path: Path, executor: Any, policy: str) -> None:
    """Pictures that were measured before their reference wait for it."""
    with serving(tmp_path, executor, release_pause_s=60) as server:
        server.add_scene()
        sweep = server.add_sweep(reference={"preset": "reference", "seed_policy": policy})
        device = server.device()
        references = [lease for lease in device.lease(max_jobs=3) if lease["purpose"] == "reference"]
        device.boot_id = "boot-2"  # gives all of them back; the references are then put off
        for lease in device.lease(max_jobs=3):
            if lease["purpose"] == "reference":
                path = f"/v1/attempts/{lease['attempt_id']}/release"
                server.client.post(path, headers=device.headers, json={"reason": "warm"})
            else:
                device.finish(lease)
        device.work()
        points = server.get(f"/sweeps/{sweep['id']}/tradeoff")["points"]
        assert [point["difference"] for point in points] == [None, None]
        server.clock.ahead_s = 61
        assert device.work() == len(references) == (2 if policy == "same" else 1)
        server.wait(sweep["id"], "done")
        found = server.get(f"/sweeps/{sweep['id']}/tradeoff")
        assert [point["repeats"] for point in found["points"]] == [2, 2]
        assert all(point["difference"]["value"] > 0 for point in found["points"])
        assert found["noise_floor"]["value"] > 0
