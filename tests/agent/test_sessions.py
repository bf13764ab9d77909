"""Sessions of several configurations on a machine of accelerated time: blocks, faults, charges, resumption."""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from joulebox_agent.errors import AgentError, UsageError
from joulebox_agent.measuring.blocks import Course, control_drift, shuffled
from joulebox_agent.measuring.charging import Band, Charging
from joulebox_agent.measuring.configurations import read_configurations
from joulebox_agent.measuring.journal import Journal
from joulebox_agent.measuring.meter import Meter, StoppedError
from joulebox_agent.measuring.rule import MeasureRule
from joulebox_agent.measuring.session import Configuration, Session
from joulebox_agent.measuring.several import build_results
from joulebox_agent.measuring.visit import Job
from joulebox_agent.sources.choose import choose
from simulated import FULL_WH, Machine, SimulatedLoop, SimulatedSampler, true_energy_j

RULE = MeasureRule(window_s=30.0, min_windows=4, max_windows=8, max_seconds=3600.0)
MIXES = [
    {"photon_map": 0.6, "direct": 0.2, "indirect": 0.2},
    {"photon_map": 0.1, "direct": 0.8, "indirect": 0.1},
    {"photon_map": 0.2, "direct": 0.2, "indirect": 0.9},
]


class Words:
    """A listener that remembers."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def note(self, text: str) -> None:
        self.said.append(text)

    def words(self, text: str) -> None: ...
    def progress(self, elapsed_s: float, windows: int, wanted: int, estimate: str) -> None: ...


class Bench:
    """A session on a machine."""

    def __init__(
        self,
        machine: Machine,
        tmp_path: Path,
        mixes: list[dict[str, float]],
        rule: MeasureRule = RULE,
        timed: int = 0,
        **options: Any,
    ) -> None:
        self.machine, self.words, self.stop = machine, Words(), threading.Event()
        choice = choose("auto", machine.root)

        def sampler() -> SimulatedSampler:
            return SimulatedSampler(choose("auto", machine.root).source, machine)

        self.meter = Meter(choice, sampler, machine, machine.root, self.stop, self.words)
        self.configurations = [
            Configuration(
                Job([], ["cornell", *(f"{name}={seconds}" for name, seconds in mix.items())], tmp_path / f"{i}.exr"),
                f"mix {i}",
                i >= len(mixes) - timed,
            )
            for i, mix in enumerate(mixes)
        ]  # fmt: skip
        self.rule = rule
        self.course = options.pop("course", Course("blocks", seed=1))
        options["make_loop"] = lambda command, arguments, clock, words: SimulatedLoop(machine, arguments)
        self.session = Session(self.configurations, rule, self.meter, self.course, **options)

    def documents(self) -> list[Any]:
        found = build_results(self.session, self.configurations, self.rule, self.course)
        return [result.document if result else None for result in found.results]


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path / "sys")


def at(machine: Machine, seconds: float, act: Callable[[Machine], None]) -> None:
    """Something that happens once, that many seconds from now."""
    due_s = machine.now_s() + seconds

    def fault(m: Machine) -> None:
        if m.now_s() >= due_s:
            m.faults.remove(fault)
            act(m)

    machine.faults.append(fault)


def test_blocks_hold_every_configuration_once_and_price_the_timed_ones(machine: Machine, tmp_path: Path) -> None:
    rule = RULE.model_copy(update={"idle_s": 60.0, "min_windows": 6})
    timed = {"photon_map": 0.5, "direct": 0.5, "indirect": 0.5}
    bench = Bench(machine, tmp_path, [*MIXES, timed], rule, timed=1)
    bench.session.run()
    documents = bench.documents()
    for record in bench.session.records[:3]:
        assert sorted(set(record.blocks))[:6] == list(range(6))
        assert len(record.idle) == max(record.blocks) + 2  # before the first block and after every one
    for mix, document in zip(MIXES, documents[:3], strict=True):
        energy = document.energy_j_per_image
        assert energy.gross.value == pytest.approx(true_energy_j(mix), rel=0.01)  # its coverage is tests/energy's
        assert energy.net.value == pytest.approx(true_energy_j(mix) - 5.0 * sum(mix.values()), rel=0.03)
        for name, watts in {"photon_map": 24.0, "direct": 17.0, "indirect": 14.0}.items():
            found = document.stages[name].energy_intervals_j.regressed
            # nine intervals at once: twice their half-width is 4 sigma
            assert abs(found.value - watts * mix[name]) <= 2 * found.half_width
    priced = documents[3]
    assert (priced.method, priced.quality) == ("stage_power_model", "estimated")
    gross = priced.energy_j_per_image.gross
    assert gross.low <= true_energy_j(timed) <= gross.high
    assert gross.half_width < 0.1 * gross.value
    assert all(window.energy_j is None for window in priced.window_data)


def test_the_order_is_random_seeded_and_kept() -> None:
    orders = [shuffled(range(6), 1, block) for block in range(8)]
    assert len({tuple(order) for order in orders}) > 4
    assert all(sorted(order) == list(range(6)) for order in orders)
    assert shuffled({5, 4, 3, 2, 1, 0}, 1, 3) == orders[3]
    assert shuffled(range(6), 2, 3) != orders[3]


def test_a_control_that_drifts_is_flagged_and_what_follows_is_marked(machine: Machine, tmp_path: Path) -> None:
    import simulated

    rule = RULE.model_copy(update={"min_windows": 4, "max_windows": 8, "half_width": 0.0001})
    bench = Bench(machine, tmp_path, MIXES[:2], rule)
    before = dict(simulated.STAGES_W)

    def hotter(m: Machine) -> None:
        simulated.STAGES_W.update({name: 1.1 * watts for name, watts in before.items()})

    at(machine, 470.0, hotter)
    try:
        bench.session.run()
    finally:
        simulated.STAGES_W.update(before)
    drift = bench.session.drift
    assert drift is not None
    assert drift.seen == pytest.approx(1.1 * drift.expected.value, rel=0.02)
    documents = bench.documents()
    assert all("the control configuration drifted" in document.suspect for document in documents)


def test_a_steady_control_is_rarely_flagged() -> None:
    """At a level of 5 % over a run; 400 runs of 5 + 15 windows alarm 20 times, sigma 4.4: never above 38 (4 sigma)."""
    from random import Random

    random = Random(3)
    alarms = sum(control_drift([random.gauss(10, 0.3) for _ in range(20)], 5) is not None for _ in range(400))
    assert alarms <= 38
    assert control_drift([10.0, 10.1, 9.9, 10.0, 10.05, 10.02, 11.5], 5) is not None
    assert control_drift([10.0, 11.0], 2) is None


FAULTS: dict[str, tuple[Callable[[Machine], None], Callable[[Machine], None] | None, str]] = {
    "sleep": (lambda m: m.suspend(40.0), None, "slept for 40.0 s"),
    "throttling": (lambda m: setattr(m, "throttles", 3), None, "throttled 3 times"),
    "a frozen gauge": (lambda m: setattr(m, "frozen", True), lambda m: setattr(m, "frozen", False), "froze"),
    "a mains flap": (lambda m: setattr(m, "plugged", True), lambda m: setattr(m, "plugged", False), "mains power"),
    "a broken sensor": (lambda m: setattr(m, "broken", True), lambda m: setattr(m, "broken", False), ""),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_voids_its_window_and_another_takes_its_place(machine: Machine, tmp_path: Path, name: str) -> None:
    act, undo, words = FAULTS[name]
    at(machine, 65.0, act)
    if undo is not None:
        at(machine, 65.0 + (2.0 if name == "a mains flap" else 25.0), undo)
    bench = Bench(machine, tmp_path, MIXES[:1], course=Course("sequence"))
    (record,) = bench.session.run()
    assert record.void is None
    assert len(record.windows) >= RULE.min_windows
    assert len(record.voided) >= 1
    assert words in record.voided[0].reason
    (document,) = bench.documents()
    gross = document.energy_j_per_image.gross
    assert gross.low <= true_energy_j(MIXES[0]) <= gross.high
    assert document.void_windows[0].reason == record.voided[0].reason
    for voided in record.voided:
        assert all(window.end_s <= voided.start_s or window.start_s >= voided.end_s for window in record.windows)


@pytest.mark.parametrize("name", ["a mains flap", "a broken sensor"])
def test_what_does_not_pass_ends_the_measurement(machine: Machine, tmp_path: Path, name: str) -> None:
    at(machine, 100.0, FAULTS[name][0])
    bench = Bench(machine, tmp_path, MIXES[:1], course=Course("sequence"))
    (record,) = bench.session.run()
    assert record.void is not None
    assert record.environment
    assert machine.now_s() < 1000.0 + 250.0
    assert bench.documents()[0].energy_j_per_image.gross is None


def test_what_is_complete_when_the_cable_comes_stays(machine: Machine, tmp_path: Path) -> None:
    at(machine, 400.0, lambda m: setattr(m, "plugged", True))
    bench = Bench(machine, tmp_path, MIXES, course=Course("sequence"))
    first, _, last = bench.session.run()
    assert first.void is None
    assert "it ended early" in str(first.notes) or len(first.windows) >= RULE.min_windows
    assert last.void is not None


def script(folder: Path, machine: Machine) -> str:
    """A smart plug: a hook that writes what it was told."""
    file = folder / "plug"
    file.write_text(f'#!/bin/sh\necho "$1" >> "{folder}/plug.log"\n')
    file.chmod(0o755)

    def follow(m: Machine) -> None:
        log = folder / "plug.log"
        if log.exists():
            m.plugged = log.read_text().split()[-1] == "on"

    machine.faults.append(follow)
    return str(file)


def test_a_sweep_goes_on_across_charges(tmp_path: Path) -> None:
    machine = Machine(tmp_path / "sys", gauge_s=4.0, charge_wh=0.31 * FULL_WH, charger_w=200.0)
    charging = Charging(Band(0.34, 0.3), machine.root, "battery_gauge", script(tmp_path, machine))
    rule = RULE.model_copy(update={"window_s": 150.0, "half_width": 0.5})
    assert charging.forecast(3600.0, 18.0).charges == 10  # 18 Wh: 0.48 Wh to start with, 1.92 a charge
    bench = Bench(machine, tmp_path, MIXES[:2], rule, charging=charging)
    records = bench.session.run()
    assert [record.void for record in records] == [None, None]
    plug = (tmp_path / "plug.log").read_text().split()
    assert plug == ["on", "off"] * (len(plug) // 2)
    assert len(plug) >= 2
    for mix, document in zip(MIXES[:2], bench.documents(), strict=True):
        assert document.windows >= 4
        gross = document.energy_j_per_image.gross
        assert gross.value == pytest.approx(true_energy_j(mix), rel=0.01)
    assert any("discharging from 35%" in text for text in bench.words.said), bench.words.said
    assert sum(len(record.voided) for record in records) == 0  # nothing of what was measured is lost


def test_a_hook_that_fails_is_one_sentence(machine: Machine, tmp_path: Path) -> None:
    machine.charge_wh = 0.2 * FULL_WH
    machine.advance(machine.now_s() + 2)
    charging = Charging(Band(), machine.root, "battery_gauge", "false")
    with pytest.raises(AgentError, match="charge hook false on left with code 1"):
        Bench(machine, tmp_path, MIXES[:1], charging=charging).session.run()


def test_a_plug_that_fails_later_leaves_what_was_measured(tmp_path: Path) -> None:
    machine = Machine(tmp_path / "sys", gauge_s=4.0, charge_wh=0.335 * FULL_WH, charger_w=200.0)
    charging = Charging(Band(0.34, 0.3), machine.root, "battery_gauge", "false")
    bench = Bench(machine, tmp_path, MIXES[:2], RULE.model_copy(update={"half_width": 0.5}), charging=charging)
    records = bench.session.run()
    done, missing = [[r for r in records if (len(r.windows) >= RULE.min_windows) is enough] for enough in (True, False)]
    assert done
    assert missing
    assert all(record.void is None for record in done)
    for record in missing:
        assert record.environment
        assert "The charge hook false on left with code 1" in str(record.void)


def test_charge_behaviour_is_used_where_the_kernel_has_it(machine: Machine, tmp_path: Path) -> None:
    file = machine.battery / "charge_behaviour"
    file.write_text("auto inhibit-charge [force-discharge]")
    machine.charge_wh = 0.2 * FULL_WH
    machine.advance(machine.now_s() + 2)
    charging, said = Charging(Band(), machine.root), list[str]()
    assert "goes up to 90%" in str(charging.step(0.0, said.append))
    assert file.read_text() == "auto"
    assert said == ["the charge is 20%: charging to 90%", "plug the power cable in"]
    file.write_text("[auto] inhibit-charge force-discharge")
    machine.plugged, machine.charge_wh = True, 0.95 * FULL_WH
    machine.advance(machine.now_s() + 2)
    assert "pull the power cable out" in str(charging.step(10.0, said.append))
    assert file.read_text() == "force-discharge"
    machine.plugged = False
    machine.advance(machine.now_s() + 2)
    assert charging.step(20.0, said.append) is None


@pytest.mark.parametrize("hook", ["", " ", "/no/such/plug on", '"unclosed'])
def test_a_hook_is_checked_before_it_is_needed(tmp_path: Path, hook: str) -> None:
    with pytest.raises(UsageError, match="The charge hook"):
        Charging(Band(), tmp_path, "battery_gauge", hook)


@pytest.mark.parametrize("text", ["30-90", "90", "a-b", "110-20", "90-90", "nan-3"])
def test_a_charge_band_is_checked(text: str) -> None:
    with pytest.raises(UsageError, match="two percentages"):
        Band.parse(text)


def test_a_killed_sweep_resumes_where_it_was(machine: Machine, tmp_path: Path) -> None:
    file, plan = tmp_path / "progress.ndjson", {"what": "mixes"}
    bench = Bench(machine, tmp_path, MIXES[:2], journal=Journal(file, plan))
    at(machine, 250.0, lambda m: bench.stop.set())
    with pytest.raises(StoppedError):
        bench.session.run()
    done = [len(record.windows) for record in bench.session.records]
    assert sum(done) >= 3
    with file.open("ab") as torn:
        torn.write(b'{"commit": {"samples": [[')  # the kill came while a line was written
    machine.reboot()
    again = Bench(machine, tmp_path, MIXES[:2], journal=Journal(file, plan))
    records = again.session.run()
    assert [record.void for record in records] == [None, None]
    assert "3 windows of earlier are kept" in str(again.words.said) or sum(done) != 3
    for record, before in zip(records, bench.session.records, strict=True):
        assert [w.wall_s for w in record.windows[: len(before.windows)]] == pytest.approx(
            [w.wall_s for w in before.windows]
        )
        assert sorted(set(record.blocks)) == list(range(max(record.blocks) + 1))
    for mix, document in zip(MIXES[:2], again.documents(), strict=True):
        gross = document.energy_j_per_image.gross
        assert gross.low <= true_energy_j(mix) <= gross.high
        assert all(window.start_s >= 0 for window in document.window_data)
    with pytest.raises(UsageError, match="progress of another measurement"):
        Bench(machine, tmp_path, MIXES[:2], journal=Journal(file, {"what": "else"})).session.run()
    file.write_text("not ours\n")
    with pytest.raises(UsageError, match=r"Line 1 of .* is no progress of ours"):
        Bench(machine, tmp_path, MIXES[:2], journal=Journal(file, plan)).session.run()


@pytest.mark.parametrize("content", [b"a letter that ends without a line break", b"[1]", b"letter\n", b'{"begins": 1'])
def test_a_file_of_somebody_else_is_left_alone(tmp_path: Path, machine: Machine, content: bytes) -> None:
    file = tmp_path / "letter.txt"
    file.write_bytes(content)
    with pytest.raises(UsageError, match="no progress of ours"):
        Bench(machine, tmp_path, MIXES[:1], journal=Journal(file, {})).session.run()
    assert file.read_bytes() == content


@pytest.mark.parametrize("change", [
    {"commit": {}}, {"commit": 5}, {"commit": {"samples": [{}], "companions": [], "idle": [], "records": []}},
    {"commit": {"samples": [], "companions": [], "idle": [3], "records": []}},
    {"commit": {"samples": [], "companions": [], "idle": [], "records": [{"windows": [{}]}]}},
    {"commit": {"samples": [], "companions": [], "idle": [], "records": [3]}},
    {"commit": {"samples": [], "companions": [], "idle": [], "records": [{"windows": [], "blocks": [], "voided": [],
     "ready": 3, "last_image": None, "spent_s": 0}]}},
    {"begin": {}, "start_s": 1e999}, {"begin": {}, "start_s": None},
])  # fmt: skip
def test_damaged_progress_is_one_sentence(tmp_path: Path, machine: Machine, change: dict[str, Any]) -> None:
    file = tmp_path / "progress"
    file.write_text("\n".join(json.dumps(line) for line in ({"begin": {}, "start_s": 5.0}, change)) + "\n")
    with pytest.raises(UsageError, match=r"is damaged: .*; remove it|no progress of ours") as caught:
        Bench(machine, tmp_path, MIXES[:1], journal=Journal(file, {})).session.run()
    assert len(str(caught.value).splitlines()) == 1


def test_windows_hold_fifteen_refreshes_of_a_slow_gauge(tmp_path: Path) -> None:
    machine = Machine(tmp_path / "sys", gauge_s=8.0, noise_w=0.4)
    rule = MeasureRule(min_windows=3, max_windows=3, max_seconds=3600)
    (record,) = Bench(machine, tmp_path, MIXES[:1], rule, course=Course("sequence")).session.run()
    assert [window.wall_s for window in record.windows] == pytest.approx([120.0] * 3, rel=0.25)


def test_a_temperature_is_waited_for(machine: Machine, tmp_path: Path) -> None:
    zone = machine.root / "class/thermal/thermal_zone0"
    zone.mkdir(parents=True)
    (zone / "type").write_text("x86_pkg_temp")
    (zone / "temp").write_text("70000")
    at(machine, 90.0, lambda m: (zone / "temp").write_text("45000") and None)
    bench = Bench(machine, tmp_path, MIXES[:1], course=Course("sequence", cool_to_c=50.0))
    (record,) = bench.session.run()
    assert record.windows[0].start_s >= 1090.0
    assert "cooling down from 70 C to 50 C" in bench.words.said


def test_configuration_files(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text('[[configurations]]\ngather_count = 50\ncaustics = true\n'
                    '[[configurations]]\nname = "b"\ntimed_only = true\nsettings = {indirect = "path"}\n')  # fmt: skip
    first, second = read_configurations(file)
    assert first.arguments() == ["--set", "gather_count=50", "--set", "caustics=true"]
    assert (second.label, second.timed_only, second.arguments()) == ("b", True, ["--set", "indirect=path"])
    file = tmp_path / "c.json"
    file.write_text(json.dumps([{"gather_count": 5}]))
    assert read_configurations(file)[0].label == "gather_count=5"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[", "is not JSON"),
        ("{}", "holds no configurations"),
        ("[]", "holds no configurations"),
        ("[3]", "Configuration 1"),
        ('[{"a": 1}, {"a": [1]}]', "Configuration 2"),
        ('[{"settings": {"a": 1}, "timed": true}]', "'timed' beside its settings"),
        ('[{"settings": {"a": 1}, "timed_only": 3}]', "timed_only true or false"),
    ],
)
def test_a_bad_configuration_file_is_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "c.json"
    file.write_text(text)
    with pytest.raises(UsageError, match=words):
        read_configurations(file)


@pytest.mark.parametrize("row", ["1979-05-27", "{a = 1979-05-27}"])
def test_a_date_is_no_setting(tmp_path: Path, row: str) -> None:
    file = tmp_path / "c.toml"
    file.write_text(f"configurations = [{row}]")
    with pytest.raises(UsageError, match=r"Configuration 1 .*date"):
        read_configurations(file)


def test_a_lent_job_ends_at_the_lower_end_of_the_band(tmp_path: Path) -> None:
    """Who does not wait for charges gives back what is no answer yet, and blames the job after a whole charge only."""
    machine = Machine(tmp_path / "sys", charge_wh=0.31 * FULL_WH)  # 0.48 Wh are 100 s of rendering
    charging = Charging(Band(0.9, 0.3), machine.root, waits=False)
    bench = Bench(machine, tmp_path, MIXES[:1], charging=charging)
    (record,) = bench.session.run()
    assert 1 <= len(record.windows) < RULE.min_windows
    assert record.void == (
        f"the charge is 30%, the lower end of its band 90-30 %, after {len(record.windows)} of 4 windows"
    )
    assert record.environment
    again = Machine(tmp_path / "again", charge_wh=0.31 * FULL_WH)
    narrow = Charging(Band(0.31, 0.3), again.root, waits=False)
    (record,) = Bench(again, tmp_path, MIXES[:1], charging=narrow).session.run()
    assert record.void is not None
    assert not record.environment


def test_windows_that_are_an_answer_are_kept_at_a_low_charge(tmp_path: Path) -> None:
    machine = Machine(tmp_path / "sys", charge_wh=0.325 * FULL_WH)  # 1.2 Wh are 220 s of rendering
    rule = RULE.model_copy(update={"half_width": 0.0005})  # asks for the most windows, of 240 s
    bench = Bench(machine, tmp_path, MIXES[:1], rule, charging=Charging(Band(), machine.root, waits=False))
    (record,) = bench.session.run()
    assert record.void is None
    assert RULE.min_windows <= len(record.windows) < RULE.max_windows
    assert "the lower end of its band 90-30 %" in str(record.notes)


def test_no_charge_is_waited_for_after_the_last_window(tmp_path: Path) -> None:
    """The charge falls below the band within the last window that was wanted."""
    machine = Machine(tmp_path / "sys", charge_wh=0.314 * FULL_WH)  # 0.67 Wh, and the four windows take 0.62 to 0.7
    bench = Bench(machine, tmp_path, MIXES[:1], charging=Charging(Band(), machine.root))
    at(machine, 1000.0, lambda m: bench.stop.set())  # ends a wait for a charge that nobody gives
    (record,) = bench.session.run()
    assert len(record.windows) == RULE.min_windows
    assert machine.charge_wh / FULL_WH <= 0.3
    assert not any("charging to" in text for text in bench.words.said)


def test_a_wait_that_is_broken_off_leaves_no_battery_draining(machine: Machine, tmp_path: Path) -> None:
    file = machine.battery / "charge_behaviour"
    file.write_text("[auto] inhibit-charge force-discharge")
    charging = Charging(Band(0.34, 0.3), machine.root)
    machine.charge_wh, machine.charger_w = 0.2 * FULL_WH, 2000.0
    machine.advance(machine.now_s() + 2)
    bench = Bench(machine, tmp_path, MIXES[:1], charging=charging)
    at(machine, 5.0, lambda m: setattr(m, "plugged", True))

    def wait(m: Machine) -> None:
        if file.read_text() == "force-discharge":
            file.write_text("auto inhibit-charge [force-discharge]")  # as the kernel shows what it was told
            bench.stop.set()

    machine.faults.append(wait)
    with pytest.raises(StoppedError):
        bench.session.run()
    assert file.read_text() == "auto"
