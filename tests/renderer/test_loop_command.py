"""`joulebox-render loop`: the lines it speaks, and how it ends."""

from __future__ import annotations

import hashlib
import io
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
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


def do_jobs(*jobs: object) -> subprocess.CompletedProcess[str]:
    """`jobs` with a line for each: a list is a job's arguments, a text goes as it is."""
    told = "".join((job if isinstance(job, str) else json.dumps([str(word) for word in job])) + "\n" for job in jobs)
    return subprocess.run([*COMMAND, "jobs"], input=told, capture_output=True, text=True, timeout=120, check=False)


def test_jobs_in_one_process_give_the_pixels_of_their_own(
    spoken: tuple[list[dict[str, Any]], Path], tmp_path: Path
) -> None:
    """Each as it would alone, whatever was rendered before it: another scene, other settings, the same again."""
    spheres = ["cornell-spheres", *QUICK, "--max-images", "1", "-o", tmp_path / "last.exr"]
    done = do_jobs(spheres, ["point-light", *QUICK, "--max-images", "2"], spheres)
    assert done.returncode == 0, done.stderr
    lines = lines_of(done.stdout)
    events = [line["event"] for line in lines if line["event"] != "stage"]
    one = ["waiting", "ready", "image", "done"]
    assert events == [*one, "waiting", "ready", "image", "image", "done", *one, "waiting"]
    images = [line for line in lines if line["event"] == "image"]
    alone = {line["pixel_sha256"] for line in spoken[0] if line["event"] == "image"}
    assert {images[0]["pixel_sha256"], images[3]["pixel_sha256"]} == alone
    assert images[1]["pixel_sha256"] == images[2]["pixel_sha256"] not in alone
    assert hashlib.sha256(read_exr(tmp_path / "last.exr").astype("<f4").tobytes()).hexdigest() in alone


@pytest.mark.parametrize(
    ("job", "sentence"),
    [
        (["cornell-spheres", "--set", "widdth=8"], "setting 'widdth' is unknown: did you mean 'width'?"),
        ("rendering, please", "a job is a JSON array of the arguments of `loop`"),
        ('["cornell-spheres", 3]', "all of them texts, not '[\"cornell-spheres\", 3]'"),
    ],
)
def test_a_bad_job_ends_the_process_with_its_sentence(job: object, sentence: str) -> None:
    done = do_jobs(job, ["cornell-spheres", *QUICK, "--max-images", "1"])
    assert done.returncode == 2
    assert sentence in done.stderr
    assert [line["event"] for line in lines_of(done.stdout)] == ["waiting"]


def test_jobs_that_leave_too_much_memory_end_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    from joulebox_render import loop

    out, done = io.StringIO(), []
    monkeypatch.setattr(loop, "MOST_KEPT_BYTES", 2 * psutil.Process().memory_info().rss)

    def one(words: list[str]) -> bool:
        done.append(words)
        monkeypatch.setattr(loop, "MOST_KEPT_BYTES", 1 if len(done) == 2 else loop.MOST_KEPT_BYTES)
        return True

    loop.run_jobs(io.StringIO('["a"]\n["b"]\n["c"]\n'), out, one)
    assert done == [["a"], ["b"]]
    assert len(lines_of(out.getvalue())) == 2


@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM handlers on Windows")
def test_sigterm_ends_jobs_at_work_and_at_rest() -> None:
    """At work with the job's `done`, and nothing after it; at rest at once."""
    for at_work in (True, False):
        with subprocess.Popen([*COMMAND, "jobs"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            more = ["--set", "samples_per_pixel=4096", "--set", "shadow_rays=256"] if at_work else ["--max-images", "1"]
            process.stdin.write(json.dumps(["cornell-boxes", *QUICK[:2], *more]) + "\n")
            process.stdin.flush()
            wanted = ["waiting", "ready"] if at_work else ["waiting", "ready", "stage", "image", "done", "waiting"]
            while wanted:
                event = json.loads(process.stdout.readline())["event"]
                wanted = wanted[1:] if event == wanted[0] else wanted
            process.send_signal(signal.SIGTERM)
            rest = lines_of(process.communicate(timeout=20)[0])
            assert [line["event"] for line in rest if line["event"] != "stage"] == (["done"] if at_work else [])
            assert process.returncode == (0 if at_work else -signal.SIGTERM)
