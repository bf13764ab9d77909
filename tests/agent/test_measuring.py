"""`measure` from the command line to the document, against a scripted program that speaks the loop protocol."""

import hashlib
import json
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from agent_testing import FAKE_COMMAND, RENDERER, ScriptedClock
from joulebox_agent.errors import RendererError
from joulebox_agent.loop import RendererLoop
from joulebox_agent.measuring.document import MeasureDocument
from joulebox_agent.measuring.measure import Measurement
from joulebox_agent.measuring.meter import StoppedError
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.measuring.result import build_result
from joulebox_agent.measuring.rule import MeasureRule
from joulebox_agent.measuring.visit import LEAD_REFRESHES, LEAD_SHARE, Job
from joulebox_agent.sampling.sampler import Sampler
from joulebox_agent.sources.choose import Choice, choose
from joulebox_agent.sources.reading import Reading
from joulebox_agent.sources.replay import Replay, bundled_trace

Agent = Callable[..., tuple[int, str, str]]
SHORT = ("--renderer", RENDERER, "--window-s", "0.15", "--min-windows", "3", "--max-windows", "3")
RULE = MeasureRule(window_s=0.15, min_windows=3, max_windows=3)


def measured(tmp_path: Path, rule: MeasureRule = RULE, source: str = "replay@0.1", **settings: object) -> Recording:
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    job = Job(FAKE_COMMAND, ["cornell", *words], tmp_path / "last.exr")
    return Measurement(job, rule, choose(source)).run()


def test_replayed_measurement_is_complete_and_labelled(agent: Agent, tmp_path: Path) -> None:
    keep, file = tmp_path / "keep", tmp_path / "result.json"
    code, out, err = agent("measure", "scenes/cornell", *SHORT, "--source", "replay@0.1", "--set", "seed=7",
                           "-D", "detail=948", "--json", "-o", file, "--keep", keep)  # fmt: skip
    assert code == 0
    document = json.loads(out)
    assert document == json.loads(file.read_text())
    assert document["schema"] == 1
    assert document["scene"] == "cornell"
    assert document["settings"]["seed"] == 7
    assert (document["method"], document["quality"]) == ("replay", "replayed")
    assert "REPLAYED" in err
    assert document["void"] is None
    assert document["windows"] == len(document["window_data"]) == 3
    assert document["images"] == sum(window["images"] for window in document["window_data"])
    gross = document["energy_j_per_image"]["gross"]
    assert gross["low"] <= gross["value"] <= gross["high"]
    assert document["energy_j_per_image"]["net"] is None
    time_s = document["time_s_per_image"]["value"]
    assert 0.02 <= time_s < 0.1
    assert gross["value"] / time_s == pytest.approx(16.8, rel=0.2)  # watts of the trace; gaps cost a little
    assert document["stages"]["indirect"]["rays"] == 301
    blobs = {path.stem: path.read_bytes() for path in keep.iterdir()}
    assert {document["power_samples"], document["image_blob"]} == set(blobs)
    assert all(hashlib.sha256(content).hexdigest() == name for name, content in blobs.items())
    assert "power_w" in json.loads(blobs[document["power_samples"]].splitlines()[0])


def test_stage_energies_follow_equation_2(tmp_path: Path) -> None:
    record = measured(tmp_path)
    document = build_result(record, RULE, tmp_path / "last.exr").document
    joules = sum(w.energy_j or 0.0 for w in document.window_data)
    walls = sum(w.time_s for w in document.window_data)
    for name, stage in document.stages.items():
        spent = sum(w.stages_s[name] / w.time_s * (w.energy_j or 0.0) for w in document.window_data)
        assert stage.energy_j.equation_2 == pytest.approx(spent / document.images)
        assert stage.energy_j.integrated is None
    total = sum(stage.energy_j.equation_2 or 0.0 for stage in document.stages.values())
    assert 0.8 * joules / document.images < total <= joules / document.images
    assert sum(sum(w.stages_s.values()) for w in document.window_data) <= walls


def test_without_a_source_there_is_time_and_no_energy(agent: Agent) -> None:
    code, out, err = agent("measure", "cornell", *SHORT, "--source", "none", "--json")
    document = json.loads(out)
    assert code == 0
    assert (document["quality"], document["method"]) == ("none", "none")
    assert document["energy_j_per_image"] == {"gross": None, "net": None, "counter": None}
    assert document["power_samples"] is None
    assert all(stage["energy_j"]["equation_2"] is None for stage in document["stages"].values())
    assert document["time_s_per_image"]["value"] > 0
    assert document["cpu_s_per_image"]["value"] == pytest.approx(0.004)
    assert "time and CPU seconds only" in err


def test_the_warm_up_image_is_in_no_window(tmp_path: Path) -> None:
    record = measured(tmp_path, source="none")
    assert record.warm_up is not None
    assert record.warm_up.image == 0
    assert record.windows[0].start_s == record.warm_up.end_s
    assert [w.start_s for w in record.windows[1:]] == [w.end_s for w in record.windows[:-1]]
    assert {w.end_s for w in record.windows} <= {image.end_s for image in record.images}
    assert sum(w.images for w in record.windows) <= len(record.images)


def test_windows_know_how_long_their_load_went_on_around_them(tmp_path: Path) -> None:
    record = measured(tmp_path, source="replay@0.1")
    assert record.warm_up is not None
    assert record.last_image is not None
    load_s = (record.warm_up.start_s, record.last_image.end_s)
    assert [window.load_s for window in record.windows] == [pytest.approx(load_s)] * len(record.windows)
    lead_s = min(LEAD_REFRESHES * 0.1, LEAD_SHARE * RULE.window_s)
    assert record.windows[0].lead_s >= lead_s - 0.01
    assert record.windows[-1].trail_s >= lead_s - 0.01


def test_net_energy_needs_idle_time(tmp_path: Path) -> None:
    rule = RULE.model_copy(update={"idle_s": 0.5})
    record = measured(tmp_path, rule)
    energy = build_result(record, rule, tmp_path / "last.exr").document.energy_j_per_image
    assert len(record.idle) == 2
    assert energy.gross is not None
    assert energy.net is not None
    assert energy.net.value < 0.2 * energy.gross.value  # the replayed gauge knows nothing of the renderer
    assert energy.net.low < 0 < energy.net.high  # window by window: it does not scatter with the pictures' times


def test_without_a_meter_one_long_image_is_rendered(tmp_path: Path) -> None:
    rule = RULE.model_copy(update={"meter": False, "min_windows": 1, "max_windows": 1})
    record = measured(tmp_path, rule, image_s=0.2)
    document = build_result(record, rule, tmp_path / "last.exr").document
    assert (document.images, document.windows, document.quality) == (1, 1, "none")
    assert document.image_blob is not None
    assert document.time_s_per_image is not None
    assert record.last_image is not None
    assert document.time_s_per_image.value == record.last_image.time_s >= 0.2


def test_without_a_meter_short_images_are_rendered_as_long_as_they_begin_in_the_window(tmp_path: Path) -> None:
    rule = RULE.model_copy(update={"meter": False, "min_windows": 1, "max_windows": 1})
    record = measured(tmp_path, rule, image_s=0.04)
    document = build_result(record, rule, tmp_path / "last.exr").document
    begins_s = [image.start_s - record.images[0].start_s for image in record.images]
    assert document.images == len(begins_s) > 1
    assert begins_s[-1] < rule.window_s  # the renderer's clock starts before its first image
    assert document.time_s_per_image is not None
    assert document.time_s_per_image.value == pytest.approx(
        sum(image.time_s for image in record.images) / len(begins_s)
    )
    assert document.stages["indirect"].rays == 301
    assert MeasureRule(meter=False).timed_s == 1.0  # whatever the window, not longer than this


def test_the_time_limit_keeps_what_there_is(tmp_path: Path) -> None:
    rule = MeasureRule(window_s=0.3, min_windows=5, max_windows=5, max_seconds=0.8)
    record = measured(tmp_path, rule, source="none")
    document = build_result(record, rule, tmp_path / "last.exr").document
    assert 1 <= document.windows < 5
    assert document.void is None
    assert "limit of 0.8 s" in str(document.conditions.after["notes"])


def test_a_picture_that_was_not_written_is_rendered_once_more(tmp_path: Path) -> None:
    record = measured(tmp_path, source="none", write="never_on_term")
    assert (tmp_path / "last.exr").exists()
    assert record.void is None


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("die", "died with code 1: Segmentation fault in the gather kernel."),
        ("garbage", "is not JSON: 'Rendering is going well so far'"),
        ("nested", "is not JSON: '[[["),
        ("number", "breaks the loop protocol"),
        ("backwards", "perf_counter"),
        ("other_clock", "perf_counter"),
        ("stop", "ended by itself"),
    ],
)
def test_a_renderer_that_misbehaves_is_one_sentence(agent: Agent, how: str, words: str) -> None:
    code, out, err = agent("measure", "cornell", *SHORT, "--source", "none", "--set", f"misbehave={how}", "--json")
    assert code == 1
    assert out == ""
    assert words in err.splitlines()[-1]


def test_a_hung_renderer_is_ended(tmp_path: Path) -> None:
    rule = RULE.model_copy(update={"silence_s": 0.5})
    with pytest.raises(RendererError, match=r"said nothing for 0\.5 s"):
        measured(tmp_path, rule, source="none", misbehave="hang_at_once")
    with pytest.raises(RendererError, match=r"said nothing for 0\.5 s"):
        measured(tmp_path, rule, source="none", misbehave="hang")


def test_refused_settings_are_wrong_use(agent: Agent) -> None:
    code, _, err = agent("measure", "cornell", *SHORT, "--source", "none", "--set", "image_ss=1")
    assert code == 2
    assert err.splitlines()[-1].endswith("There is no setting 'image_ss'; did you mean 'image_s'?")


def test_a_changing_picture_voids(agent: Agent, tmp_path: Path) -> None:
    file = tmp_path / "r.json"
    code, _, err = agent("measure", "cornell", *SHORT, "--source", "replay@0.1", "--set", "misbehave=flicker",
                         "-o", file)  # fmt: skip
    assert code == 1
    assert "The measurement is void: the picture changed between images" in err
    document = MeasureDocument.model_validate_json(file.read_text())
    assert document.void is not None
    assert document.energy_j_per_image.gross is None
    assert document.image_blob is None


@pytest.mark.parametrize(
    "words",
    [
        ("--set", "seed"),
        ("-D", "=3"),
        ("--settings", "/no/such/file.json"),
        ("--window-s", "0"),
        ("--window-s", "nan"),
        ("--min-windows", "9", "--max-windows", "3"),
        ("--half-width", "1.5"),
        ("--source", "solar"),
        ("--source", "replay:/no/such/trace.csv"),
        ("--renderer", "/no/such/renderer"),
        ("--output", "/proc/nowhere/r.json"),
        ("--sysfs-root", "/no/such/root"),
    ],
)
def test_wrong_use_is_one_sentence_and_code_2(agent: Agent, words: tuple[str, ...]) -> None:
    code, out, err = agent("measure", "cornell", "--renderer", RENDERER, *words)
    assert code == 2
    assert out == ""
    assert err.strip()


def test_a_named_source_that_cannot_be_read_says_the_remedy(agent: Agent, tmp_path: Path) -> None:
    code, _, err = agent("measure", "cornell", *SHORT, "--source", "rapl", "--sysfs-root", tmp_path)
    assert code == 1
    assert "rapl cannot be read" in err
    assert "modprobe" in err


class PluggedIn(Replay):
    """A gauge on whose machine a cable appears at the nth reading."""

    def __init__(self, after: int) -> None:
        super().__init__(bundled_trace(), 0.1)
        self.left = after

    def read(self) -> Reading:
        self.left -= 1
        return Reading(refusal="mains power online (AC)") if self.left < 0 else super().read()


def test_a_cable_that_appears_voids_and_stops(tmp_path: Path) -> None:
    source = PluggedIn(after=6)
    job = Job(FAKE_COMMAND, ["cornell"], tmp_path / "last.exr")
    rule = MeasureRule(window_s=60)
    began = time.monotonic()
    record = Measurement(job, rule, Choice(source, source.report())).run()
    assert time.monotonic() - began < 10
    document = build_result(record, rule, job.image_file).document
    assert document.void is not None
    assert document.void.startswith("mains power online (AC) at ")
    assert record.environment
    assert document.energy_j_per_image.gross is None


def test_a_machine_that_slept_voids_a_stretch_and_a_lost_sensor_ends_it() -> None:
    clock = ScriptedClock()
    sampler = Sampler(Replay(bundled_trace(), 0.1, clock), clock, lost_after_s=5.0)
    sampler.sample()
    clock.time_s += 3.0
    clock.asleep_s = 42.0
    sampler.sample()
    assert sampler.void_reason(1000.0, 1001.0) == "the machine slept for 42.0 s, noticed at 3.0 s"
    assert sampler.void_reason(1003.0, 1004.0) is None
    assert sampler.trouble() is None

    class Broken(Replay):
        def read(self) -> Reading:
            return Reading(problem="power_now: EIO")

    clock = ScriptedClock()
    sampler = Sampler(Broken(bundled_trace(), 0.1, clock), clock, lost_after_s=5.0)
    sampler.sample()
    assert sampler.trouble() is None  # one bad sample voids itself only
    assert sampler.void_reason(1000.0, 1001.0) is None
    clock.time_s += 6.0
    sampler.sample()
    assert sampler.trouble() == "the sensor was lost at 6.0 s (power_now: EIO)"


def test_a_stop_ends_the_renderer(tmp_path: Path) -> None:
    stop = threading.Event()
    job = Job(FAKE_COMMAND, ["cornell"], tmp_path / "last.exr")
    threading.Timer(0.5, stop.set).start()
    with pytest.raises(StoppedError):
        Measurement(job, MeasureRule(), choose("none"), stop=stop).run()


def test_the_renderer_never_outlives_its_block() -> None:
    with RendererLoop(FAKE_COMMAND, ["cornell", "--set", "misbehave=ignore_term"]) as loop:
        assert loop.next_event(10.0) is not None
        process = loop._process
        loop.stop(within_s=0.2)
    assert process.returncode == -signal.SIGKILL
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


def test_numbers_at_the_border_carry_their_unit(tmp_path: Path) -> None:
    """Every numeric field of the document says its unit, or is in the list of what has none."""
    unitless = {"schema", "images", "windows", "confidence", "rays", "threads", "value", "low", "high", "equation_2",
                "block", "battery_cycle_count", "throttle_count", "load_1_min"}  # fmt: skip
    suffixes = ("_s", "_j", "_w", "_c", "_share", "_wh", "_m", "_bytes")
    record = measured(tmp_path)
    document = build_result(record, RULE, tmp_path / "last.exr").document.to_json()
    named = []

    def walk(name: str, value: object) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                if key not in ("settings", "photons", "plan"):  # the renderer's own words
                    walk(name if name in ("stages_s",) else key, inner)
        elif isinstance(value, list):
            for inner in value:
                walk(name, inner)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            named.append(name)

    walk("", document)
    assert len(set(named)) > 10
    assert [name for name in named if name not in unitless and not name.endswith(suffixes)] == []


def test_several_configurations_from_the_command_line(agent: Agent, tmp_path: Path) -> None:
    file, plot, progress = tmp_path / "c.toml", tmp_path / "p.svg", tmp_path / "progress.ndjson"
    file.write_text("[[configurations]]\nseed = 1\n[[configurations]]\nseed = 2\n[[configurations]]\nseed = 3\n")
    code, out, _ = agent(
        *("measure", "cornell", *SHORT, "--source", "replay@0.1", "--configurations", file, "--meter", "2"),
        *("--idle-s", "0", "--plot", plot, "--resume", progress, "--state-dir", tmp_path, "--json"),
    )
    assert code == 0
    document = json.loads(out)
    assert [c["settings"]["seed"] for c in document["configurations"]] == [1, 2, 3]
    assert [c["quality"] for c in document["configurations"]] == ["replayed", "replayed", "none"]
    assert "need 12 metered windows; there are 6" in document["stage_powers_reason"]
    assert [w["block"] for w in document["configurations"][0]["window_data"]] == [1, 2, 3]
    assert document["control"] == {"configuration": 1, "order": "blocks", "order_seed": 0, "drift": None}
    assert plot.read_text().startswith("<svg")
    assert not progress.exists()  # the result is where it belongs


def test_a_configuration_that_fails_is_said_and_costs_its_own_result_only(agent: Agent, tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("[[configurations]]\nseed = 1\n[[configurations]]\nsead = 2\n")
    words = ("measure", "cornell", *SHORT, "--source", "replay@0.1", "--idle-s", "0", "--state-dir", tmp_path)
    code, out, err = agent(*words, "--configurations", file)
    assert code == 0
    assert "cornell: " in out
    assert "configuration 2 has no result: The renderer refused: There is no setting 'sead'" in err


def test_a_plot_that_cannot_be_written_costs_no_result(agent: Agent, tmp_path: Path) -> None:
    plot = tmp_path / "p.svg"
    plot.mkdir()
    code, out, err = agent("measure", "cornell", *SHORT, "--source", "replay@0.1", "--plot", plot, "--json")
    assert code == 1
    assert json.loads(out)["void"] is None
    assert "cannot be written" in err


@pytest.mark.parametrize(
    "words",
    [
        ("--meter", "2"),
        ("--order", "random", "--configurations", "FILE"),
        ("--control", "3", "--configurations", "FILE"),
        ("--charge-band", "90-30", "--source", "replay"),
        ("--plot", "p.pdf"),
        ("--configurations", "/no/such/file.toml"),
    ],
)
def test_wrong_use_of_a_session_is_one_sentence(agent: Agent, tmp_path: Path, words: tuple[str, ...]) -> None:
    file = tmp_path / "c.json"
    file.write_text('[{"seed": 1}, {"seed": 2}]')
    given = [file if word == "FILE" else word for word in words]
    code, out, err = agent("measure", "cornell", "--renderer", RENDERER, *given)
    assert (code, out) == (2, "")
    assert len(err.strip().splitlines()) == 1


def test_a_full_disk_costs_the_file_and_not_the_result(agent: Agent, tmp_path: Path) -> None:
    code, out, err = agent("measure", "cornell", *SHORT, "--source", "none", "--json", "-o", "/dev/full")
    assert code == 1
    assert json.loads(out)["windows"] == 3
    assert "/dev/full cannot be written: No space left on device." in err
