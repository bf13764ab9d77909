"""What RAPL's watts are worth at the battery: learnt on a machine that has both, kept, and used while it holds."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from agent_testing import RENDERER
from joulebox_agent.estimates.windows import Window
from joulebox_agent.measuring.calibrating import FILE, calibrate, calibration_for, stored
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.reading import Reading
from joulebox_agent.sources.sysfs import Sysfs

Agent = Callable[..., tuple[int, str, str]]
Tree = Callable[[str], Path]
A_W, B = 5.0, 1.25
IDLE_W, BUSY_W, RAMP_W_S = 3.0, 12.0, 0.6  # what RAPL says
SHORT = ("--renderer", RENDERER, "--window-s", "1.2", "--idle-s", "2.0")


def machine(root: Path) -> Path:
    """A laptop with a battery, RAPL, a panel at half brightness and a thermometer."""
    files = {
        "class/powercap/intel-rapl:0/name": "package-0",
        "class/powercap/intel-rapl:0/energy_uj": "0",
        "class/powercap/intel-rapl:0/max_energy_range_uj": "262143328850",
        "class/backlight/panel/brightness": "50",
        "class/backlight/panel/max_brightness": "100",
        "class/thermal/thermal_zone0/temp": "61000",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text + "\n")
    return root


def put(path: Path, text: str) -> None:
    """Replaces a file in one step, as the kernel's files change."""
    new = path.with_name("new")
    new.write_text(text + "\n")
    new.replace(path)


@contextmanager
def living(root: Path) -> Iterator[None]:
    """Lets the machine draw more and more, by RAPL from 3 W on and 0.6 W more each second; a battery that follows."""
    ended = threading.Event()

    def live() -> None:
        start_s = time.perf_counter()
        while not ended.wait(0.02):
            lived_s = time.perf_counter() - start_s
            rapl_w, used_j = IDLE_W + RAMP_W_S * lived_s, 100.0 + IDLE_W * lived_s + RAMP_W_S * lived_s**2 / 2
            put(root / "class/powercap/intel-rapl:0/energy_uj", str(round(used_j * 1e6)))
            put(root / "class/power_supply/BAT0/power_now", str(round((A_W + B * rapl_w) * 1e6)))

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_calibrate_learns_the_line_and_doctor_tells_it(agent: Agent, tree: Tree, tmp_path: Path) -> None:
    """P = 5 W + 1.25 P_rapl. The means of nine seconds and more lie 5 W apart; a gauge seen half a second late is 0.3 W
    off in all of them, and 0.4 W in one or another: the slope holds within 15 %, the line amid them within 5 %."""
    root, state = machine(tree("thinkpad_power_now")), tmp_path / "state"
    with living(root):
        code, out, err = agent("calibrate", "cornell", *SHORT, "--sysfs-root", root, "--state-dir", state, "--json")
    assert code == 0, err
    line = json.loads(out)
    assert line["b"] == pytest.approx(B, rel=0.15)
    middle_w = (line["lowest_rapl_w"] + line["highest_rapl_w"]) / 2
    assert line["a_w"] + line["b"] * middle_w == pytest.approx(A_W + B * middle_w, rel=0.05)
    assert line["pair_count"] == 7
    assert (line["temperature_c"], line["brightness"]) == (61.0, 0.5)
    assert json.loads((state / FILE).read_text()) == line

    def doctor() -> dict[str, object]:
        told = json.loads(agent("doctor", "--json", "--sysfs-root", root, "--state-dir", state)[1])
        return {name: told[name] for name in ("calibration", "calibration_unused")}

    assert doctor() == {"calibration": line, "calibration_unused": None}
    put(root / "class/backlight/panel/brightness", "100")
    assert doctor() == {
        "calibration": line,
        "calibration_unused": "the brightness was 0.5 of full and is 1 of full",
    }
    words = agent("doctor", "--sysfs-root", root, "--state-dir", state)[1]
    assert "not used now: the brightness was 0.5 of full" in words
    assert "calibrate SCENE learns it" in agent("doctor", "--sysfs-root", root, "--state-dir", tmp_path)[1]


def test_what_cannot_be_compared_is_refused(agent: Agent, tree: Tree, tmp_path: Path) -> None:
    root = tree("thinkpad_power_now")
    words = ("calibrate", "cornell", *SHORT, "--state-dir", tmp_path, "--sysfs-root")
    code, out, err = agent(*words, root)
    assert (code, out) == (1, "")
    assert "rapl: no package domain in class/powercap" in err
    code, out, err = agent(*words, machine(root), "--source", "replay")
    assert (code, out) == (1, "")
    assert "replay is no battery" in err
    put(root / "class/power_supply/AC/online", "1")
    code, out, err = agent(*words, root)
    assert (code, out) == (1, "")
    assert "battery_gauge: mains power online (AC)" in err
    assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / FILE).exists()


def recorded(root: Path, lag_s: float = 0.0, windows: int = 5) -> Recording:
    """Idle, windows, idle, a minute each, of a gauge that refreshes every 2 s and shows the mean of `lag_s`."""
    source = BatteryGauge(Sysfs(root))
    end_s = 60.0 * (windows + 2)
    times_s = [0.5 * poll for poll in range(round(2 * end_s) + 40)]

    def rapl_j(at_s: float) -> float:
        busy_s = min(max(at_s - 60.0, 0.0), 60.0 * windows)
        return IDLE_W * at_s + (BUSY_W - IDLE_W) * busy_s

    def gauge_w(at_s: float) -> float:
        shown_s, mean_s = 2.0 * (at_s // 2.0), max(lag_s, 0.01)
        return A_W + B * (rapl_j(shown_s) - rapl_j(shown_s - mean_s)) / mean_s + 1e-6 * (shown_s % 7)

    record = Recording(source, source.report(), 0.0)
    record.samples = [Sample(t, Reading(power_w=gauge_w(t), raw=(t // 2.0,))) for t in times_s]
    record.companion_samples = [Sample(t, Reading(counter_j=rapl_j(t), raw=(t,))) for t in times_s]
    record.windows = [Window(60.0 * (k + 1), 60.0 * (k + 2), images=20) for k in range(windows)]
    record.idle = [(0.0, 60.0), (end_s - 60.0, end_s)]
    record.after = {"temperature_c": 61.0, "brightness_share": 0.5}
    return record


def test_a_gauge_that_shows_the_mean_of_half_a_minute_gives_the_same_line(tree: Tree) -> None:
    """The first window's joules would be 15 s x 11.25 W / 2 short without its lag, and b 2 % low."""
    record = recorded(tree("thinkpad_power_now"), lag_s=30.0)
    line = calibrate([record], record.after)
    assert line.b == pytest.approx(B, rel=0.01)
    assert line.a_w == pytest.approx(A_W, rel=0.02)


def test_a_session_keeps_its_own_line_and_one_without_idle_uses_the_stored_one(tree: Tree, tmp_path: Path) -> None:
    record = recorded(tree("thinkpad_power_now"))
    own, (said,) = calibration_for([record], tmp_path)
    assert own is not None
    assert said.startswith("RAPL calibrated: P_battery = 5")
    assert own.b == pytest.approx(B, rel=0.01)  # a step is seen as a ramp of 2 s: 11 J of 1,200 at the first edge
    busy_only = replace(record, idle=[])
    assert calibration_for([busy_only], tmp_path) == (own, [f"stage energies use the stored calibration of RAPL: "
                                                            f"{own.words()}"])  # fmt: skip
    warm = replace(busy_only, after={"temperature_c": 75.0, "brightness_share": 0.5})
    assert calibration_for([warm], tmp_path) == (
        None,
        ["the stored calibration of RAPL is not used: the temperature was 61 °C and is 75 °C"],
    )
    assert calibration_for([replace(record, companion_samples=[])], tmp_path) == (None, [])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"made_at": (datetime.now(UTC) - timedelta(days=31)).isoformat()}, "is 31 days old"),
        ({"made_at": (datetime.now(UTC) + timedelta(days=2)).isoformat()}, "made in the future"),
        ({"device": "elsewhere"}, "is elsewhere's"),
        ({"temperature_c": None}, "the temperature was unknown and is 61"),
        ({"b": "x"}, "is damaged: calibrate again"),
        ({"residual_w": None}, "is damaged: calibrate again"),
    ],
)
def test_a_stored_line_is_used_only_while_it_holds(
    tree: Tree, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    record = recorded(tree("thinkpad_power_now"))
    calibration_for([record], tmp_path)
    assert stored(tmp_path, record.after).unused is None
    kept = json.loads((tmp_path / FILE).read_text())
    (tmp_path / FILE).write_text(json.dumps(kept | change))
    assert words in (stored(tmp_path, record.after).unused or "")


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"[" * 100_000, b"[1]", b'{"a_w": NaN}'])
def test_a_damaged_file_is_said_to_be(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE).write_bytes(content)
    assert stored(tmp_path, {}).unused == f"{tmp_path / FILE} is damaged: calibrate again"
    (tmp_path / FILE).unlink()
    assert stored(tmp_path, {}).unused == "there is none yet"
    (tmp_path / FILE).mkdir()
    assert "cannot be read" in (stored(tmp_path, {}).unused or "")


def test_a_session_that_reads_no_idle_and_kept_nothing_says_why(tree: Tree, tmp_path: Path) -> None:
    record = replace(recorded(tree("thinkpad_power_now")), idle=[])
    calibration, (said,) = calibration_for([record], tmp_path)
    assert calibration is None
    assert said.startswith("RAPL is not calibrated: RAPL lay between 12 and 12 W")
