"""The command: documents it writes, lines it speaks, and how it refuses."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joulebox_render import __version__, cli
from joulebox_render.images import read_exr
from joulebox_render.scene import list_scenes
from joulebox_render.settings import make_settings, settings_schema

COMMAND = [sys.executable, "-c", "from joulebox_render.cli import main; main()"]
QUICK = [
    "--set", "width=16", "--set", "height=12", "--set", "global_photons=2000", "--set", "caustic_photons=300",
    "--set", "final_gather_rays=8", "--set", "shadow_rays=4", "--set", "samples_per_pixel=1",
]  # fmt: skip
STAGES = {"photon_map", "precomputed_irradiance", "direct", "indirect", "caustics"}


def run(*arguments: str | Path, timeout_s: float = 120) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, as a user's shell would start it."""
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=timeout_s, check=False
    )


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """call(*arguments) -> (exit code, stdout, stderr), in this process: no second start of Python."""

    def call_(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["joulebox-render", *map(str, arguments)])
        capfd.readouterr()
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capfd.readouterr()
        return code, out, err

    return call_


def refused(answer: tuple[int, str, str], code: int, *words: str) -> None:
    """One sentence on stderr that holds the words, nothing on stdout, the exit code."""
    got, out, err = answer
    assert got == code, err
    assert out == ""
    assert "Traceback" not in err
    lines = [line for line in err.splitlines() if line.strip() and not line.startswith("note: ")]
    assert len(lines) == 1, err
    assert lines[0].startswith("joulebox-render: ")
    for word in words:
        assert word in lines[0]


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


# --- loop ---


def lines_of(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


@pytest.fixture(scope="module")
def spoken(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[dict[str, Any]], Path]:
    """Lines of a loop of three images, and the file it left."""
    exr = tmp_path_factory.mktemp("loop") / "last.exr"
    done = run("loop", "cornell-spheres", *QUICK, "--max-images", "3", "-o", exr)
    assert done.returncode == 0, done.stderr
    return lines_of(done.stdout), exr


def test_the_loop_speaks_in_order(spoken: tuple[list[dict[str, Any]], Path]) -> None:
    lines, _ = spoken
    events = [line["event"] for line in lines]
    assert events[0] == "ready"
    assert events[-1] == "done"
    assert set(events[1:-1]) == {"stage", "image"}
    assert [line["image"] for line in lines if line["event"] == "image"] == [0, 1, 2]
    image = 0
    for line in lines[1:-1]:
        assert line["image"] == image
        image += line["event"] == "image"
    assert lines[-1]["images"] == 3


def test_ready_says_all_that_is_known_before(spoken: tuple[list[dict[str, Any]], Path]) -> None:
    ready = spoken[0][0]
    assert ready["protocol"] == 1
    assert ready["scene"] == "cornell-spheres"
    assert set(ready["settings"]) == set(settings_schema()["properties"])
    assert ready["build"]["name"] == "joulebox-render"
    assert {"version", "intersector", "isa", "threads"} <= set(ready["build"])
    assert set(ready["setup"]) == {"load_s", "bvh_s", "compile_s"}
    assert set(ready["plan"]) == {"run", "left_out"}
    assert len(ready["scene_sha256"]) == 64


def test_intervals_are_disjoint_and_inside_their_image(spoken: tuple[list[dict[str, Any]], Path]) -> None:
    lines, _ = spoken
    clock = lines[0]["time_s"]
    images = [line for line in lines if line["event"] == "image"]
    for image in images:
        assert {"time_s", "cpu_s", "width", "height", "pixel_sha256", "photons"} <= set(image)
        assert image["start_s"] >= clock
        assert image["end_s"] - image["start_s"] == pytest.approx(image["time_s"], abs=1e-6)
        at = image["start_s"]
        stages = [line for line in lines if line["event"] == "stage" and line["image"] == image["image"]]
        assert {stage["name"] for stage in stages} == set(lines[0]["plan"]["run"])
        for stage in stages:
            assert {"name", "start_s", "end_s", "cpu_s", "rays"} <= set(stage)
            assert at <= stage["start_s"] <= stage["end_s"] <= image["end_s"]
            at = stage["end_s"]
        clock = image["end_s"]
    assert lines[-1]["end_s"] >= clock


def test_every_image_of_the_loop_is_the_same_and_the_last_is_kept(
    spoken: tuple[list[dict[str, Any]], Path], call: Callable[..., Any]
) -> None:
    lines, exr = spoken
    hashes = {line["pixel_sha256"] for line in lines if line["event"] == "image"}
    assert hashes == {hashlib.sha256(read_exr(exr).astype("<f4").tobytes()).hexdigest()}
    assert lines[-1]["image_file"] == str(exr)
    rendered = json.loads(call("render", "cornell-spheres", "--json", *QUICK)[1])
    assert hashes == {rendered["image"]["pixel_sha256"]}


def test_the_loop_ends_after_its_time_but_renders_once(call: Callable[..., Any]) -> None:
    code, out, _ = call("loop", "point-light", *QUICK, "--max-seconds", "0")
    assert code == 0
    assert lines_of(out)[-1]["images"] == 1
    start = time.perf_counter()
    code, out, _ = call("loop", "point-light", *QUICK, "--max-seconds", "0.3")
    assert lines_of(out)[-1]["images"] >= 1
    assert time.perf_counter() - start < 20
    assert lines_of(out)[-1]["image_file"] is None


@pytest.fixture
def long_loop() -> Any:
    """A loop over an image that would take an hour, once it is ready."""
    hour = ["--set", "samples_per_pixel=4096", "--set", "shadow_rays=256"]
    process = subprocess.Popen(
        [*COMMAND, "loop", "cornell-boxes", *hour], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["event"] == "ready"
    yield process
    process.kill()
    process.communicate()


@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM handlers on Windows")
def test_sigterm_ends_the_loop_within_an_image(long_loop: Any) -> None:
    """Promptly, though the image would take an hour, with its `done` line and exit code 0."""
    time.sleep(0.5)
    start = time.perf_counter()
    long_loop.send_signal(signal.SIGTERM)
    out, err = long_loop.communicate(timeout=60)
    assert time.perf_counter() - start < 20
    assert long_loop.returncode == 0, err
    assert err == ""
    assert lines_of(out)[-1]["event"] == "done"
    assert lines_of(out)[-1]["images"] == 0


def test_a_reader_that_goes_away_ends_the_loop_quietly() -> None:
    process = subprocess.Popen(
        [*COMMAND, "loop", "point-light", *QUICK], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.wait(timeout=60) == 1
    assert process.stderr.read() == ""
    process.stderr.close()


def test_an_image_is_finite_and_lit(tmp_path: Path, call: Callable[..., Any]) -> None:
    for entry in list_scenes():
        exr = tmp_path / f"{entry.name}.exr"
        assert call("render", entry.name, *QUICK, "-o", exr)[0] == 0
        pixels = read_exr(exr)
        assert np.isfinite(pixels).all()
        assert pixels.min() >= 0
        assert pixels.mean() > 1e-3
