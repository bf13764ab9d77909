"""The installed agent on a whole fake /sys that changes while it runs: umockdev gives the bed, we move what is in it.

Values are changed by putting another file in place of the old one, so that no reader sees half a value.
"""

import contextlib
import itertools
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pytest
from agent_testing import DATA, RENDERER

UMOCKDEV = shutil.which("umockdev-run")
AGENT = Path(sys.executable).with_name("joulebox-agent")
EXPECTED = json.loads((DATA / "expected.json").read_text())
SUPPLIES = "class/power_supply"
TIME_LIMIT_S = 60.0

pytestmark = [
    pytest.mark.skipif(UMOCKDEV is None, reason="umockdev-run is not installed (Debian, Ubuntu: apt install umockdev)"),
    pytest.mark.skipif(not AGENT.exists(), reason=f"the agent is not installed beside {sys.executable}"),
]


class Bed:
    """A running agent in its bed. `sys` is the folder that it takes for /sys."""

    def __init__(self, process: "subprocess.Popen[str]", sys_folder: Path) -> None:
        self._process = process
        self.sys = sys_folder

    def put(self, name: str, value: object) -> None:
        """Another value for a file below /sys."""
        file = self.sys / name
        new = file.with_name(file.name + ".new")
        new.write_text(f"{value}\n")
        new.replace(file)

    def go(self) -> None:
        """Lets the agent start."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()

    def wait_for(self, word: str) -> None:
        """Reads what the agent says to stderr until `word` is in a line."""
        stream: IO[str] | None = self._process.stderr
        assert stream is not None
        for line in stream:
            if word in line:
                return
        raise AssertionError(f"the agent ended without saying {word!r}")

    def result(self) -> tuple[int, str, str]:
        out, err = self._process.communicate(timeout=TIME_LIMIT_S)
        return self._process.returncode, out, err

    def document(self) -> dict[str, Any]:
        code, out, err = self.result()
        assert code == 0, err
        assert "Traceback" not in err
        return dict(json.loads(out))


@contextmanager
def bed(device: Path, *words: object) -> Iterator[Bed]:
    """The agent, held before its start so that the bed can be made first."""
    agent = shlex.join([str(AGENT), *map(str, words)])
    script = f'printf "%s\\n" "$UMOCKDEV_DIR"; read go; exec {agent}'
    process = subprocess.Popen(
        [str(UMOCKDEV), "--device", str(device), "--", "sh", "-c", script],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip

    def end() -> None:
        """Whatever the bed holds: the agent, its sampler, its renderer."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)

    ended = threading.Timer(TIME_LIMIT_S, end)
    ended.start()
    try:
        assert process.stdout is not None
        yield Bed(process, Path(process.stdout.readline().strip()) / "sys")
    finally:
        ended.cancel()
        end()
        process.communicate()


@contextmanager
def moving(step: Callable[[int], None], every_s: float) -> Iterator[None]:
    """Calls step(1), step(2), ... until left."""
    ended = threading.Event()

    def move() -> None:
        for count in itertools.count(1):
            if ended.wait(every_s):
                return
            try:
                step(count)
            except FileNotFoundError:  # the bed goes with the agent
                return

    thread = threading.Thread(target=move)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def device_of(name: str) -> Path:
    return DATA / name / "device.umockdev"


@pytest.mark.parametrize("name", EXPECTED)
def test_every_device_file_gives_the_watts_of_a_careful_reader(name: str) -> None:
    with bed(device_of(name), "doctor", "--json") as running:
        running.go()
        document = running.document()
    watts = EXPECTED[name]["expect_watts"]
    assert document["discharge_w"] == (None if watts is None else pytest.approx(watts, abs=1e-6))
    gauge = document["sources"][0]
    assert gauge["available"] == (watts is not None)
    assert gauge["reason"]
    assert gauge["remedy"] or gauge["available"]


def test_the_refresh_is_learnt_from_values_that_change() -> None:
    """Every 0.6 s another value, seen at polls of 0.5 s: 0.5 or 1.0 s apart, on a busy machine more."""
    with bed(device_of("thinkpad_power_now"), "doctor", "--json", "--watch", "4") as running:

        def step(count: int) -> None:
            running.put(f"{SUPPLIES}/BAT0/power_now", 5_000_000 + 1000 * count)

        with moving(step, 0.6):
            running.go()
            document = running.document()
    gauge = document["sources"][0]
    assert 0.4 <= gauge["refresh_s"] <= 1.6
    assert 5.0 <= gauge["power_w"] <= 5.1
    assert gauge["window_s_for_5_percent"] == pytest.approx(15 * gauge["refresh_s"])
    assert gauge["cpu_share"] < 0.05


@pytest.mark.parametrize(("file", "watts"), [("power_now", None), ("energy_now", 5.064)])
def test_a_file_that_answers_eio(file: str, watts: float | None) -> None:
    """/proc/self/mem answers EIO to a read at 0. Only what is needed counts."""
    with bed(device_of("thinkpad_power_now"), "doctor", "--json") as running:
        (running.sys / SUPPLIES / "BAT0" / file).unlink()
        (running.sys / SUPPLIES / "BAT0" / file).symlink_to("/proc/self/mem")
        running.go()
        document = running.document()
    assert document["discharge_w"] == watts
    if watts is None:
        assert f"BAT0/{file}: Input/output error" in document["reason"]


def measuring(*words: object) -> tuple[object, ...]:
    return ("measure", "cornell", "--renderer", RENDERER, "--json", "--max-seconds", "20", *words)


def drawing(running: Bed) -> Callable[[int], None]:
    """A gauge that lives: every reading is another one, from 5.00 to 5.02 W."""
    return lambda count: running.put(f"{SUPPLIES}/BAT0/power_now", 5_000_000 + 1000 * (count % 20))


def test_a_measurement_of_a_discharge() -> None:
    words = measuring("--window-s", "1.5", "--min-windows", "2", "--max-windows", "2")
    with bed(device_of("thinkpad_power_now"), *words) as running, moving(drawing(running), 0.2):
        running.go()
        document = running.document()
    assert (document["method"], document["quality"], document["scope"]) == (
        "battery_gauge",
        "measured",
        "whole machine",
    )
    assert document["void"] is None
    for window in document["window_data"]:
        assert 5.0 <= window["energy_j"] / window["time_s"] <= 5.02


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda running: running.put(f"{SUPPLIES}/AC/online", 1), "mains power online (AC)"),
        (lambda running: running.put(f"{SUPPLIES}/BAT0/status", "Not charging"), "BAT0 is Not charging"),
        (lambda running: (running.sys / SUPPLIES / "BAT0").unlink(), "no system battery"),
    ],
)
def test_what_ends_a_discharge_voids_the_measurement(change: Callable[[Bed], None], words: str) -> None:
    options = measuring("--window-s", "0.5", "--min-windows", "30", "--max-windows", "30")
    with bed(device_of("thinkpad_power_now"), *options) as running:
        with moving(drawing(running), 0.2):
            running.go()
            running.wait_for("rendering cornell")
            time.sleep(1.0)
        change(running)
        code, out, err = running.result()
    assert code == 1, err
    assert words in json.loads(out)["void"]
    assert words in err
    assert "Traceback" not in err


def test_a_sensor_that_fails_for_a_moment_does_not_end_a_measurement() -> None:
    options = measuring("--window-s", "1.5", "--min-windows", "2", "--max-windows", "2")
    with bed(device_of("thinkpad_power_now"), *options) as running:
        with moving(drawing(running), 0.2):
            running.go()
            running.wait_for("rendering cornell")
        rate = running.sys / SUPPLIES / "BAT0" / "power_now"
        rate.unlink()
        rate.symlink_to("/proc/self/mem")
        time.sleep(1.2)
        with moving(drawing(running), 0.2):
            document = running.document()
    assert document["void"] is None
    assert document["windows"] == 2
    for window in document["window_data"]:
        assert 5.0 <= window["energy_j"] / window["time_s"] <= 5.02


def test_rapl_that_wraps_while_it_is_watched(tmp_path: Path) -> None:
    """20 W over a range of 1200 J, 20 J short of its wrap: it comes within the first second.

    A fifth is allowed for writes that are late at the two ends of three seconds.
    """
    device = tmp_path / "rapl.umockdev"
    device.write_text(
        "P: /devices/virtual/powercap/intel-rapl:0\nE: SUBSYSTEM=powercap\n"
        "A: name=package-0\\n\nA: energy_uj=1180000000\\n\nA: max_energy_range_uj=1200000000\\n\n\n"
    )
    with bed(device, "doctor", "--json", "--watch", "3") as running:
        start_s = time.perf_counter()

        def step(count: int) -> None:
            used_uj = 1_180_000_000 + int((time.perf_counter() - start_s) * 20e6)
            running.put("class/powercap/intel-rapl:0/energy_uj", used_uj % 1_200_000_000)

        with moving(step, 0.01):
            running.go()
            document = running.document()
    rapl = next(row for row in document["sources"] if row["method"] == "rapl")
    assert rapl["available"]
    assert rapl["power_w"] == pytest.approx(20.0, rel=0.2)
    assert document["chosen"] == "rapl"
    assert document["discharge_w"] is None
