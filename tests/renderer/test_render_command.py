"""The command: documents it writes, and how it refuses; the lines of `loop` are in test_loop_command."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import QUICK, refused, run
from joulebox_render import __version__
from joulebox_render.images import read_exr
from joulebox_render.scene import list_scenes
from joulebox_render.settings import make_settings, settings_schema

STAGES = {"photon_map", "precomputed_irradiance", "direct", "indirect", "caustics"}


# --- render ---


def test_render_writes_picture_preview_and_report(tmp_path: Path) -> None:
    exr, png, report = tmp_path / "a.exr", tmp_path / "a.png", tmp_path / "r.json"
    done = run("render", "cornell-spheres", *QUICK, "-o", exr, "--png", png, "--report", report)
    assert done.returncode == 0, done.stderr
    document = json.loads(report.read_text())
    pixels = read_exr(exr)
    assert pixels.shape == (12, 16, 3)
    assert document["image"]["pixel_sha256"] == hashlib.sha256(pixels.astype("<f4").tobytes()).hexdigest()
    assert (document["image"]["width"], document["image"]["height"]) == (16, 12)
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert {
        "scene", "scene_sha256", "settings", "build", "setup", "image", "stages", "thesis_stages", "plan", "photons",
        "peak_rss_bytes",
    } <= set(document)  # fmt: skip
    assert document["scene"] == "cornell-spheres"
    assert len(document["scene_sha256"]) == 64
    assert set(document["settings"]) == set(settings_schema()["properties"])
    assert document["settings"]["width"] == 16
    assert {"version", "intersector", "isa", "threads"} <= set(document["build"])
    assert document["build"]["version"] == __version__
    assert set(document["setup"]) == {"load_s", "bvh_s", "compile_s"}
    assert set(document["stages"]) == set(document["plan"]["run"]) == STAGES
    for row in document["stages"].values():
        assert {"time_s", "cpu_s", "rays"} <= set(row)
        assert row["time_s"] > 0
    assert {"global_stored", "global_emitted", "caustic_stored", "caustic_emitted"} <= set(document["photons"])
    assert document["photons"]["global_stored"] == 2000
    assert document["peak_rss_bytes"] > 10_000_000


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="only Linux counts a starter's memory")
def test_peak_memory_is_not_that_of_whoever_started_the_renderer() -> None:
    """A starter that holds 400 MB is larger than an imported renderer, which takes about 150 MB."""
    held = np.ones(50_000_000)
    code = "from joulebox_render.session import peak_rss_bytes; print(peak_rss_bytes())"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert 20e6 < int(said) < held.nbytes


def test_stages_add_up_to_the_image_in_both_bookings(call: Callable[..., Any]) -> None:
    """Within 2 %, at a size where the image takes a good part of a second."""
    code, out, _ = call("render", "cornell-spheres", "--json", "--set", "width=96", "--set", "height=96")
    assert code == 0
    document = json.loads(out)
    image = document["image"]
    assert image["time_s"] > 0.1
    for booking in ("stages", "thesis_stages"):
        for value, least in (("time_s", 0.98), ("cpu_s", 0.95)):
            total = sum(row[value] for row in document[booking].values())
            assert least * image[value] <= total <= image[value] * 1.0001
    stages, thesis = document["stages"], document["thesis_stages"]
    assert set(thesis) == {"photon_map", "direct", "indirect", "caustics"}
    rays = sum(row["rays"] for row in stages.values())
    assert sum(row["rays"] for row in thesis.values()) == rays
    # Precomputation is booked under the map; what is seen through mirror and glass under direct light.
    assert thesis["photon_map"]["time_s"] == pytest.approx(
        stages["photon_map"]["time_s"] + stages["precomputed_irradiance"]["time_s"]
    )
    assert thesis["direct"]["rays"] > stages["direct"]["rays"]
    assert thesis["indirect"]["rays"] < stages["indirect"]["rays"]
    parts = stages["photon_map"]
    assert parts["emission_s"] + parts["construction_s"] == pytest.approx(parts["time_s"])


def test_settings_from_file_preset_and_command_line(call: Callable[..., Any], tmp_path: Path) -> None:
    """--set wins over the file, the file over the preset."""
    file = tmp_path / "s.toml"
    file.write_text("shadow_rays = 9\nseed = 5\n")
    code, out, _ = call(
        "render", "point-light", "--json", "--preset", "draft", "--settings", file, *QUICK, "--set", "seed=6"
    )
    settings = json.loads(out)["settings"]
    assert code == 0
    assert (settings["shadow_rays"], settings["seed"], settings["irradiance_cache_tolerance"]) == (4, 6, 1.0)
    assert make_settings(settings).model_dump() == settings


def test_the_same_picture_from_the_report_and_from_json(call: Callable[..., Any], tmp_path: Path) -> None:
    hashes = {json.loads(call("render", "cornell-boxes", "--json", *QUICK)[1])["image"]["pixel_sha256"] for _ in "12"}
    assert len(hashes) == 1


def test_an_image_is_finite_and_lit(tmp_path: Path, call: Callable[..., Any]) -> None:
    for entry in list_scenes():
        exr = tmp_path / f"{entry.name}.exr"
        assert call("render", entry.name, *QUICK, "-o", exr)[0] == 0
        pixels = read_exr(exr)
        assert np.isfinite(pixels).all()
        assert pixels.min() >= 0
        assert pixels.mean() > 1e-3


# --- what is refused ---


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["cornell-boxes", "--set", "shadow_ray=3"], ["setting 'shadow_ray' is unknown", "'shadow_rays'"]),
        (
            ["cornell-boxes", "--set", "shadow_rays=0"],
            ["setting 'shadow_rays' cannot be 0", "greater than or equal to 1"],
        ),
        (["cornell-boxes", "--set", "gather_distance_m=NaN"], ["gather_distance_m", "finite"]),
        (["cornell-boxes", "--set", "shadow_rays"], ["key=value"]),
        (["cornell-boxes", "--preset", "best"], ["preset 'best' is unknown"]),
        (["cornell-boxes", "--settings", "nowhere.json"], ["nowhere.json", "No such file"]),
        (["cornell-box"], ["there is no scene 'cornell-box'", "cornell-boxes"]),
        (["no/such/folder"], ["there is no scene"]),
        (["cornell-boxes", "-D", "detial=3"], ["detial"]),
        (["cornell-boxes", "-D", "detail"], ["name=value"]),
        (["furnace", "-D", "reflectance=much"], ["much", "line 34"]),
    ],
)
def test_wrong_use_ends_with_2_and_a_sentence(
    call: Callable[..., Any], tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    target = tmp_path / "a.exr"
    refused(call("render", *arguments, "-o", target), 2, *words)
    assert not target.exists()


@pytest.mark.parametrize("command", ["plan", "loop"])
def test_other_commands_refuse_alike(call: Callable[..., Any], command: str) -> None:
    refused(call(command, "cornell-boxes", "--set", "sed=1"), 2, "setting 'sed' is unknown")
    refused(call(command, "nowhere"), 2, "there is no scene")


@pytest.mark.parametrize(
    "arguments", [["render"], ["paint"], ["render", "cornell-boxes", "--colour"], ["loop", "x", "--max-images", "0"]]
)
def test_wrong_command_lines_end_with_2(call: Callable[..., Any], arguments: list[str]) -> None:
    code, out, err = call(*arguments)
    assert code == 2
    assert "Traceback" not in err
    assert out + err


def test_nothing_to_keep_is_refused(call: Callable[..., Any]) -> None:
    refused(call("render", "cornell-boxes"), 2, "nothing would be kept")


@pytest.mark.parametrize(
    ("option", "name", "word"),
    [
        ("-o", "missing/a.exr", "no folder"),
        ("--png", "missing/a.png", "no folder"),
        ("--report", "missing/r.json", "no folder"),
        ("-o", "a.jpg", "ends in .exr"),
        ("--png", "a.exr", "ends in .png"),
        ("-o", "folder.exr", "folder"),
        ("--report", "folder.exr", "folder"),
    ],
)
def test_a_target_that_cannot_be_written_is_refused_before_the_work(
    call: Callable[..., Any], tmp_path: Path, option: str, name: str, word: str
) -> None:
    """The settings ask for hours; the refusal comes at once."""
    (tmp_path / "folder.exr").mkdir()
    hours = ["--set", "samples_per_pixel=65536", "--set", "width=4096", "--set", "height=4096"]
    start = time.perf_counter()
    refused(call("render", "cornell-boxes", *hours, option, tmp_path / name), 2, word)
    assert time.perf_counter() - start < 20


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_is_said(call: Callable[..., Any]) -> None:
    refused(call("render", "point-light", *QUICK, "--report", "/dev/full"), 1, "/dev/full", "No space left")


def test_a_truncated_mesh_is_refused(call: Callable[..., Any], tmp_path: Path) -> None:
    shipped = {entry.name: entry.path for entry in list_scenes()}["caustic-ring"]
    mesh = (shipped / "ring.ply").read_bytes()
    (tmp_path / "scene.xml").write_bytes((shipped / "scene.xml").read_bytes())
    (tmp_path / "ring.ply").write_bytes(mesh[: len(mesh) // 2])
    refused(call("render", tmp_path, "-o", tmp_path / "a.exr"), 2, "ring.ply")
    (tmp_path / "ring.ply").unlink()
    refused(call("render", tmp_path, "-o", tmp_path / "a.exr"), 2, "ring.ply")


def test_no_traceback_reaches_a_user() -> None:
    """Also in a process of its own, with the entry point as installed."""
    done = run("render", "cornell-boxes", "--set", "seed=-1", "--json")
    refused((done.returncode, done.stdout, done.stderr), 2, "setting 'seed' cannot be -1")


# --- plan, schema, scenes, version ---


def test_plan(call: Callable[..., Any]) -> None:
    code, out, _ = call("plan", "cornell-boxes", "--json")
    document = json.loads(out)
    assert code == 0
    assert document["run"] == ["photon_map", "precomputed_irradiance", "direct", "indirect"]
    assert document["left_out"]["caustics"] == "no specular surface"
    code, out, _ = call("plan", "cornell-boxes")
    assert code == 0
    assert "no specular surface" in out


def test_schema(call: Callable[..., Any]) -> None:
    code, out, _ = call("schema")
    assert code == 0
    assert json.loads(out) == json.loads(json.dumps(settings_schema()))


def test_scenes(call: Callable[..., Any]) -> None:
    code, out, _ = call("scenes", "list", "--json")
    assert code == 0
    entries = json.loads(out)
    assert {"cornell-boxes", "cornell-spheres"} <= {entry["name"] for entry in entries}
    assert all(set(entry) == {"name", "path", "title"} and Path(entry["path"]).is_dir() for entry in entries)
    code, out, _ = call("scenes", "show", "cornell-boxes", "--json")
    facts = json.loads(out)
    assert code == 0
    assert (facts["width"], facts["lights"]) == (256, 1)
    assert call("scenes", "check", "cornell-boxes")[0] == 0
    refused(call("scenes", "check", "nowhere"), 2, "there is no scene")


def test_version(call: Callable[..., Any]) -> None:
    assert call("--version")[:2] == (0, f"joulebox-render {__version__}\n")
