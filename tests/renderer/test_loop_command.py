"""`joulebox-render loop`: the lines it speaks, and how it ends."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_line import COMMAND, QUICK, run
from joulebox_render.images import read_exr
from joulebox_render.settings import settings_schema


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
