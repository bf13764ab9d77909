"""A batch of two tiny pictures through a real server and a real agent; killed, it goes on where it was."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from joulebox_server.cli.connection import WrongUseError
from joulebox_server.thesis import discharge, dv
from joulebox_server.thesis.batch import Batch, Plan
from joulebox_server.thesis.evaluation import write
from joulebox_server.thesis.following import Follower
from joulebox_server.thesis.local import Local, can_meter
from joulebox_server.thesis.study import Study

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")

TINY = {"width": 16, "height": 16, "shadow_rays": 1, "gather_count": 20, "gather_distance_m": 0.1, "photon_spacing": 0,
        "samples_per_pixel": 1, "indirect": "direct_visualization", "caustics": False}  # fmt: skip
CODE = """
import sys
from pathlib import Path
import test_thesis_run
test_thesis_run.run(Path(sys.argv[1]), Path(sys.argv[2]))
"""


def sweeps(plan: Plan) -> list[dict]:
    """Two numbers of photons."""
    configurations = [{"global_photons": count} for count in (500, 2000)]
    sweep = {"name": "tiny", "scenes": ["cornell-spheres"], "settings": TINY, "rule": "list", "controls": 1}
    return [sweep | {"configurations": configurations, "reference": {"settings": {"global_photons": 2000}}}]


TINY_BATCH = Batch("tiny", "Tiny", "Two pictures.", sweeps, dv.FIGURES[4:5], ())


def run(folder: Path, scenes: Path, show=lambda done, total, doing: None, source: str = "none") -> Study:
    """The tiny batch in a folder, to its end: quick, or metered by a source."""
    study = Study.opened(folder, quick=source == "none", source=source)
    with Local(folder, 1, source) as local:
        study.run([TINY_BATCH], local.connection, scenes, Follower(show, local.check))
        if study.results().basis == "measured":
            discharge.keep_measured(study.folder, local.connection, study.rows())
    return study


def test_a_killed_study_goes_on_and_measures_nothing_twice(root: Path, tmp_path: Path) -> None:
    folder, seen = tmp_path / "out", tmp_path / "out/server/joulebox.db"
    here = {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", CODE, str(folder), str(root / "scenes")]
    with subprocess.Popen(command, env=os.environ | here) as process:
        while not (seen.is_file() and (folder / "processes.json").is_file()):
            assert process.poll() is None
            time.sleep(0.05)
        time.sleep(2)
        process.kill()
    left = json.loads((folder / "processes.json").read_text())
    told = []
    study = run(folder, root / "scenes", lambda done, total, doing: told.append((done, total)))
    assert told[-1] == (5, 5)
    rows = study.rows()
    purposes = sorted(row.purpose for row in rows)
    assert purposes == ["control", "measure", "measure", "noise_floor", "reference"]
    assert all(gone(pid) for pid in left)
    assert not (folder / "processes.json").exists()

    results = study.results()
    few, many = results.points("tiny", global_photons=500) + results.points("tiny", global_photons=2000)
    assert few.difference.value > 0
    assert many.difference.value == 0  # the reference's very settings and seed
    assert results.floor("tiny") > 0
    # direct light of what is seen in the mirror and glass is booked with the rest of direct light
    assert few.stage("direct").value + few.stage("indirect").value + few.stage("photon_map").value == pytest.approx(
        few.cost.value, rel=0.1
    )
    written = write(study, [TINY_BATCH], None)
    assert {path.name for path in written.files} == {"report.html", "claims.json", "figure-29.svg", "figure-29.png"}


LEAST_W, MOST_W = 12.2, 12.8
METER = (
    f"""exec:{sys.executable} -S -c 'import time; print("{{\\"power_w\\": %f}}" % ({LEAST_W} + time.time() % 0.6))'"""
)
"""An instrument that tells another value every time, as a real one does; a value that stands still is no reading."""


@pytest.mark.parametrize(
    ("source", "window_s", "basis"),
    [pytest.param(METER, 3.5, "measured", marks=pytest.mark.long), ("replay@0.1", 0.6, "replayed")],
)
def test_a_metered_study_rests_on_joules(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, window_s: float, basis: str
) -> None:
    """The whole path of a full run, with short windows: server, agent, meter, repeats, joules by stage, discharge."""
    rules = {"window_s": window_s, "min_windows": 2, "max_windows": 2, "max_seconds": 60.0}
    monkeypatch.setattr("joulebox_server.thesis.study.METERED", rules)
    monkeypatch.setattr("joulebox_server.thesis.study.FULL_REPEATS", 1)
    assert can_meter(source)
    study = run(tmp_path / "out", root / "scenes", source=source)
    assert study.metered
    results = study.results()
    assert (results.basis, results.unit) == (basis, "J")
    rows = [row for row in results.rows if row.purpose in ("measure", "reference", "control")]
    assert len(rows) == 4
    for row in rows:
        assert row.image.energy_j is not None
        if basis == "measured":
            # a window's energy is that of its wall time; between pictures a little of it belongs to none
            assert LEAST_W * row.image.time_s <= row.image.energy_j <= 1.25 * MOST_W * row.image.time_s
        by_stage = [cost.energy_j for cost in row.stages.values()]
        assert 0.5 * row.image.energy_j < sum(by_stage) <= row.image.energy_j * 1.001
    if basis == "measured":
        watts = [power_w for _, power_w in study.results().discharge.samples]
        assert len(set(watts)) > 2
        assert all(LEAST_W <= power_w <= MOST_W for power_w in watts)
    judged = write(study, [replace(TINY_BATCH, claims=dv.CLAIMS[1:2])], None).judged
    assert [one.basis for one in judged] == [basis]


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("gauge", "--source gauge: There is no energy source 'gauge'; known are auto"),
        ("exec:/nowhere/meter", "--source exec:/nowhere/meter: it cannot be read here"),
    ],
)
def test_a_source_that_cannot_meter_is_refused_before_the_study_begins(source: str, sentence: str) -> None:
    with pytest.raises(WrongUseError, match=re.escape(sentence)):
        can_meter(source)


def test_a_server_that_dies_is_a_sentence(root: Path, tmp_path: Path) -> None:
    def kill_it(done: int, total: int, doing: str) -> None:
        os.kill(json.loads((tmp_path / "out/server/server.json").read_text())["pid"], signal.SIGKILL)

    with pytest.raises(
        Exception, match=r"the server ended with exit code -9; the last line of its log .+ run the same"
    ):
        run(tmp_path / "out", root / "scenes", kill_it)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("text.txt", "is not empty and holds no study"),
        ("study.json", "study.json is damaged"),
    ],
)
def test_a_folder_of_something_else_is_left_alone(tmp_path: Path, content: str, sentence: str) -> None:
    (tmp_path / content).write_text("mine")
    with pytest.raises(WrongUseError, match=sentence):
        Study.opened(tmp_path, quick=True)
    assert [path.name for path in tmp_path.iterdir()] == [content]


def test_a_study_goes_on_as_it_began(tmp_path: Path) -> None:
    first = Study.opened(tmp_path / "out", quick=True)
    assert Study.opened(tmp_path / "out", quick=True) == first == Study.found(tmp_path / "out")
    with pytest.raises(WrongUseError, match="was started with --quick; go on with the same"):
        Study.opened(tmp_path / "out", quick=False)
    with pytest.raises(WrongUseError, match="was started without --server; go on"):
        Study.opened(tmp_path / "out", quick=True, server="http://127.0.0.1:1")
    with pytest.raises(WrongUseError, match="holds no study; run"):
        Study.found(tmp_path / "other")


def gone(pid: int) -> bool:
    """Whether a process ends within ten seconds."""
    deadline_s = time.monotonic() + 10
    while time.monotonic() < deadline_s:
        stat = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout.strip()
        if not stat or stat.startswith("Z"):
            return True
        time.sleep(0.05)
    return False
