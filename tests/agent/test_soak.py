"""Hours of measuring with random faults, in accelerated time: no crash, and no wrong number accepted.

Every accepted window's joules are compared with what the machine really drew in it. Tolerance of a window of 60 s
at 17 W (1,020 J): the gauge's 15 refreshes of 4 s with 0.4 W of white noise leave 6.2 J (sigma), of which six are
allowed; its two edges fall into a refresh of stages that differ by up to 10 W, by half a second on average. Together
47 J, 5 %. A window that a gauge frozen while idle is believed in is off by 60 %.
"""

from collections.abc import Sequence
from pathlib import Path
from random import Random
from threading import Event

import pytest
from joulebox_agent.errors import RendererError, SourceUnavailableError
from joulebox_agent.estimates.energies import window_energies
from joulebox_agent.measuring.meter import Meter
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.measuring.result import build_result
from joulebox_agent.measuring.rule import MeasureRule
from joulebox_agent.measuring.session import Configuration, Session
from joulebox_agent.measuring.visit import Job
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.choose import choose
from simulated import FULL_WH, STAGES_W, Machine, SimulatedLoop, SimulatedSampler

GAUGE_S = 4.0
TOLERANCE = 0.05
RULE = MeasureRule(max_windows=8, max_seconds=1500.0, silence_s=300.0)


class Trouble:
    """Random faults, one about every `every_s`; each is undone after a while of its own."""

    KINDS = ("sleep", "throttle", "freeze", "flap", "mains", "error", "dead sensor", "pull", "pause", "count", "dim")

    def __init__(self, machine: Machine, seed: int, every_s: float) -> None:
        self.random, self.every_s = Random(f"faults {seed}"), every_s
        self.undo: list[tuple[float, str]] = []
        self.happened: dict[str, int] = {}
        self.to_come: list[str] = []  # every kind once, in random order, before any comes again
        self.screen = machine.root / "class/backlight/panel"
        self.screen.mkdir(parents=True)
        (self.screen / "max_brightness").write_text("100")
        (self.screen / "brightness").write_text("60")
        machine.faults.append(self)

    def __call__(self, machine: Machine) -> None:
        for due in [due for due in self.undo if due[0] <= machine.now_s()]:
            self.undo.remove(due)
            self.set(machine, due[1], False)
        if self.random.random() < machine.gauge_s / self.every_s:
            self.to_come = self.to_come or self.random.sample(self.KINDS, len(self.KINDS))
            kind = self.to_come.pop()
            self.happened[kind] = self.happened.get(kind, 0) + 1
            lasts_s = {"flap": 4.0, "mains": 120.0, "error": 8.0, "dead sensor": 90.0, "freeze": 150.0, "pull": 6.0}
            self.set(machine, kind, True)
            self.undo.append((machine.now_s() + self.random.uniform(0.5, 1.5) * lasts_s.get(kind, 30.0), kind))

    def set(self, machine: Machine, kind: str, on: bool) -> None:
        if kind in ("flap", "mains"):
            machine.plugged = on
        elif kind in ("error", "dead sensor"):
            machine.broken = on
        elif kind == "freeze":
            machine.frozen = on
        elif kind == "pull":
            machine.pack = not on
        elif kind == "dim":
            (self.screen / "brightness").write_text("30" if on else "60")
        elif on and kind == "sleep":
            machine.suspend(self.random.uniform(1.0, 3000.0))
        elif on and kind == "throttle":
            machine.throttles += 1
        elif on and kind == "pause":
            machine.stand_still(self.random.uniform(6.0, 60.0))
        elif on and kind == "count":
            machine.charge_wh = min(FULL_WH, machine.charge_wh + self.random.uniform(-0.5, 0.5))


class DyingLoop(SimulatedLoop):
    """A renderer that now and then dies, and keeps the truth about every image."""

    def __init__(self, machine: Machine, arguments: list[str], truth: dict[float, float], random: Random) -> None:
        super().__init__(machine, arguments)
        self.truth = truth
        self.dies_at = random.randrange(40, 2000)

    def render(self) -> None:
        if self.image == self.dies_at:
            raise RendererError("The renderer died with code 1: Segmentation fault.")
        super().render()
        self.truth[self.machine.now_s()] = self.machine.used_j


def measured(machine: Machine, folder: Path, truth: dict[float, float], random: Random) -> Recording:
    """One measurement of a random mixture of stages."""
    words = [w for name in STAGES_W for w in ("--set", f"{name}={random.uniform(0.3, 2.5):.3f}")]
    source = choose("battery_gauge", machine.root)

    def sampler() -> SimulatedSampler:
        return SimulatedSampler(source.source, machine, poll_s=1.0)

    meter = Meter(source, sampler, machine, machine.root, Event(), Quiet())
    job = Job([], ["cornell", *words], folder / "last.exr")

    def loop(command: Sequence[str], arguments: Sequence[str], *rest: object) -> DyingLoop:
        return DyingLoop(machine, list(arguments), truth, random)

    session = Session([Configuration(job)], RULE, meter, make_loop=loop)
    (record,) = session.run()
    build_result(record, RULE, job.image_file)  # a document comes of everything that was recorded
    return record


class Quiet:
    def note(self, text: str) -> None: ...
    def words(self, text: str) -> None: ...
    def progress(self, elapsed_s: float, windows: int, wanted: int, estimate: str) -> None: ...


def soak(folder: Path, seed: int, hours: float, every_s: float) -> tuple[int, int, int, dict[str, int]]:
    """(windows accepted, windows void, measurements void, faults by kind) of that many hours."""
    machine = Machine(folder / "sys", seed, gauge_s=GAUGE_S)
    trouble, random = Trouble(machine, seed, every_s), Random(seed)
    accepted = voided = ended = 0
    while machine.now_s() < 1000.0 + 3600.0 * hours:
        machine.charge_wh = max(machine.charge_wh, 0.6 * FULL_WH)
        machine.advance(machine.now_s() + 60.0)  # idle, so that a gauge that freezes now holds a wrong power
        truth: dict[float, float] = {}
        try:
            record = measured(machine, folder, truth, random)
        except SourceUnavailableError:
            continue  # not fit now: it comes again
        except RendererError:
            ended += 1
            continue
        voided, ended = voided + len(record.voided), ended + (record.void is not None)
        if record.void is not None:
            continue
        found = window_energies(PowerSeries(record.samples), record.source, record.windows, None)
        for window, energy_j in zip(record.windows, found.gross_j, strict=True):
            true_j = truth[window.end_s] - truth[window.start_s]
            assert energy_j is None or energy_j == pytest.approx(true_j, rel=TOLERANCE), (
                seed,
                window,
                trouble.happened,
            )
            accepted += energy_j is not None
    return accepted, voided, ended, trouble.happened


@pytest.mark.parametrize("seed", [1, 3])
def test_two_hours_with_faults(tmp_path: Path, seed: int) -> None:
    accepted, voided, ended, happened = soak(tmp_path, seed, hours=2.0, every_s=200.0)
    assert accepted >= 10
    assert voided + ended >= 5
    assert len(happened) >= 4


@pytest.mark.long
@pytest.mark.parametrize("seed", range(10, 22))
def test_ten_hours_with_faults(tmp_path: Path, seed: int) -> None:
    accepted, voided, ended, happened = soak(tmp_path, seed, hours=10.0, every_s=(120.0, 300.0, 900.0)[seed % 3])
    assert accepted >= 40
    assert voided + ended >= 10
    assert set(happened) == set(Trouble.KINDS)
