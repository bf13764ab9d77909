"""`joulebox diff`: its document, its table, its delta image, its errors."""

import json

import numpy as np
import pytest
import typer
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.images import read_picture
from joulebox_server.cli.diff import diff
from PIL import Image
from typer.testing import CliRunner

KEYS = ["metric", "version", "value", "value_per_pixel", "max_jnd", "p99_jnd", "share_above_3_jnd", "limit"]
KEYS += ["acceptable", "flip_mean", "ssim", "rmse_srgb", "relmse", "display"]


@pytest.fixture
def run(tmp_path):
    app = typer.Typer()
    app.command("diff")(diff)
    reference = np.random.default_rng(4).uniform(0.1, 0.3, (32, 48, 3)).astype(np.float32)
    np.save(tmp_path / "reference.npy", reference)
    np.save(tmp_path / "test.npy", reference * 1.05)
    np.save(tmp_path / "bright.npy", reference * 2)

    def run(*options, test="test.npy"):
        return CliRunner().invoke(app, [str(tmp_path / "reference.npy"), str(tmp_path / test), *map(str, options)])

    return run


def test_document(run):
    answer = run("--json", "--exposure", 2)
    assert answer.exit_code == 0, answer.output
    document = json.loads(answer.stdout)
    assert list(document) == KEYS
    assert (document["metric"], document["version"]) == ("ltdiff-style", 1)
    assert document["display"] == {
        "exposure": 2.0,
        "peak_cd_m2": 100.0,
        "black_cd_m2": 1.0,
        "pixels_per_degree": 4.0,
        "tone_map": "clip",
    }
    assert document["value"] > 0


def test_parameters_reach_the_metric(run):
    plain, wider = (json.loads(run("--json", *options).stdout) for options in ((), ("--ppd", 40)))
    assert wider["display"]["pixels_per_degree"] == 40
    assert wider["value"] != plain["value"]
    assert 0 < json.loads(run("--json", "--yee", test="bright.npy").stdout)["yee_failing_share"] <= 1


def test_table_says_what_it_is(run, tmp_path):
    answer = run("--delta", tmp_path / "d.png")
    assert answer.exit_code == 0, answer.output
    words = " ".join(answer.stdout.split())
    assert "not ltdiff itself" in words
    assert "Acceptable does not mean invisible" in words
    assert "acceptable: limit 2.344" in words
    with Image.open(tmp_path / "d.png") as delta:
        assert (delta.size, delta.mode) == ((48, 32), "L")
        assert np.asarray(delta).any()


def test_same_picture(run):
    document = json.loads(run("--json", test="reference.npy").stdout)
    assert [document[key] for key in ("value", "max_jnd", "flip_mean", "rmse_srgb", "relmse")] == [0] * 5
    assert document["acceptable"]


def test_errors_are_sentences(run, tmp_path):
    assert isinstance(run(test="none.exr").exception, AnalysisError)
    failed = run("--delta", tmp_path / "missing" / "d.png").exception
    assert isinstance(failed, AnalysisError)
    assert "d.png: No such file" in str(failed)
    assert "exposure is nan" in str(run("--exposure", "nan").exception)
    bad = read_picture(tmp_path / "test.npy")
    bad[3, 4] = np.nan
    np.save(tmp_path / "bad.npy", bad)
    assert "the test image has 1 pixel" in str(run(test="bad.npy").exception)
