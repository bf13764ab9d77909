"""A scripted discharge read by the agent's own code: a fake sysfs tree, its sources, sampler, windows, estimates.

The tree is in memory, as opening files takes most of the time; a test shows that files on disk give the same. Time
is the script's: the tree is written at every refresh of the gauge and polled at the first poll that would
see it, since polls that see nothing new change nothing.
"""

import errno
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joulebox_agent.estimates.energies import IDLE_PIECES, WindowEnergies, idle_power, window_energies
from joulebox_agent.estimates.estimate import Interval, net_of_idle, two_stage_interval, windows_needed
from joulebox_agent.estimates.windows import Window
from joulebox_agent.measuring.visit import LEAD_REFRESHES, LEAD_SHARE
from joulebox_agent.sampling.sampler import Sampler
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.battery_counter import PackCounter
from joulebox_agent.sources.battery_gauge import PackGauge
from joulebox_agent.sources.power_supply import PowerSupplyClass
from joulebox_agent.sources.sysfs import Sysfs

from .discharge import Discharge, Gauge, Image, Machine, configured, gauge_updates, script

SOURCES = {"battery_gauge": PackGauge, "battery_counter": PackCounter}


@dataclass(frozen=True)
class Rule:
    """How it is measured: the agent's own settings;
    blocks: one window each of two configurations in random order, drawn anew in every run."""

    source: str = "battery_gauge"
    window_s: float = 60.0
    pilot: int = 5
    most: int = 5
    half_width: float = 0.05
    idle: bool = False
    blocks: bool = False


@dataclass(frozen=True)
class Measured:
    """Joules per image as measured, None where not resolvable; what was really drawn; whose windows they are."""

    machine: Machine
    gross: Interval | None
    net: Interval | None
    drawn_j: float
    windows: list[Window]
    energies: WindowEnergies
    drawn_in_windows_j: list[float]


class ScriptedTime:
    """The clock of the sampler."""

    now = 0.0

    def now_s(self) -> float:
        return self.now

    def slept_s(self) -> float:
        return 0.0


class Tree(Sysfs):
    """A laptop's power_supply class, in memory or, when `root` is a folder that exists, in files below it."""

    def __init__(self, root: Path | None, full_j: float) -> None:
        super().__init__(root or Path("/sys"))
        supplies = self.root / "class" / "power_supply"
        self._battery, cable = supplies / "BAT0", supplies / "AC"
        self._folders = {supplies: [cable, self._battery]}
        self._power, self._energy = self._battery / "power_now", self._battery / "energy_now"
        self._texts: dict[str, str] | None = None if root else {}
        for folder, files in (
            (cable, {"type": "Mains", "online": "0"}),
            (self._battery, {"type": "Battery", "present": "1", "status": "Discharging", "voltage_now": "11800000",
                             "energy_full": str(round(full_j / 3600 * 1e6))}),
        ):  # fmt: skip
            for name, text in files.items():
                self._put(folder / name, text)

    def show(self, power_uw: int, energy_uwh: int) -> None:
        """What the gauge says from now on."""
        self._put(self._power, str(power_uw))
        self._put(self._energy, str(energy_uwh))

    def _put(self, path: Path, text: str) -> None:
        if self._texts is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + "\n")
        else:
            self._texts[str(path)] = text

    def text(self, path: Path) -> str:
        if self._texts is None:
            return super().text(path)
        try:
            return self._texts[str(path)]
        except KeyError:
            raise OSError(errno.ENOENT, "not in this tree", str(path)) from None

    def children(self, folder: Path) -> list[Path]:
        return super().children(folder) if self._texts is None else self._folders.get(folder, [])


class Run:
    """One discharge, read up to any moment; from files when `root` is given."""

    def __init__(
        self, rng: np.random.Generator, discharge: Discharge, gauge: Gauge, source: str, root: Path | None = None
    ) -> None:
        self.discharge = discharge
        self._times_s, self._power_uw, self._energy_uwh = gauge_updates(rng, discharge, gauge)
        self._tree, self._next = Tree(root, gauge.full_j), 0
        self._clock = ScriptedTime()
        self._first_poll_s = discharge.edges_s[0] + rng.uniform(0.0, 0.5)
        self._update()
        self.source = SOURCES[source](PowerSupplyClass(self._tree))
        self.resolution_j = self.source.report().resolution_j
        self._sampler = Sampler(self.source, self._clock, lost_after_s=1e9)

    def _update(self) -> None:
        self._tree.show(self._power_uw[self._next], self._energy_uwh[self._next])
        self._next += 1

    def read_until(self, until_s: float) -> PowerSeries:
        """Plays the tree up to a moment, polls it as the agent would, and looks once at that moment."""
        while self._next < len(self._times_s) and self._times_s[self._next] <= until_s:
            at_s = float(self._times_s[self._next])
            self._update()
            poll_s = (
                self._first_poll_s + math.ceil((at_s - self._first_poll_s) / self.source.poll_s) * self.source.poll_s
            )
            upcoming_s = self._times_s[self._next] if self._next < len(self._times_s) else math.inf
            if poll_s < min(upcoming_s, until_s):
                self._look(poll_s)
        self._look(until_s)
        assert self._sampler.trouble() is None
        return PowerSeries(self._sampler.samples())

    def _look(self, at_s: float) -> None:
        self._clock.now = max(at_s, self._clock.now)
        self._sampler.sample()


class _Image(NamedTuple):
    """What a window takes from an image's event; making thousands of those would take longer than reading the tree."""

    image: int
    start_s: float
    end_s: float
    time_s: float
    cpu_s: float = 0.0


class _Stage(NamedTuple):
    """The same of a stage's event."""

    name: str
    start_s: float
    end_s: float
    cpu_s: float = 0.0
    rays: float = 0.0
    through_specular: bool = False


def lead_s(gauge: Gauge, window_s: float) -> float:
    """How long the agent renders before the first window and after the last."""
    return min(LEAD_REFRESHES * gauge.refresh_s, LEAD_SHARE * window_s)


def windows_of(block: list[Image], window_s: float, before_s: float) -> list[Window]:
    """The windows the agent would make of these images; the first image is its warm-up."""
    begin_s, last_s = block[0][0][1], block[-1][-1][2]
    windows: list[Window] = []
    now: Window | None = None
    for number, image in enumerate(block):
        start_s, end_s = image[0][1], image[-1][2]
        if now is not None:
            now.add(_Image(number, start_s, end_s, end_s - start_s), [_Stage(*stage) for stage in image])
            if now.wall_s >= window_s:
                windows.append(now)
        if (now is None and end_s >= begin_s + before_s) or now in windows:
            now = Window(end_s, lead_s=end_s - begin_s)
    for window in windows:
        window.trail_s = last_s - window.end_s
    return windows


def measure(seed: int, machine: Machine, gauge: Gauge, rule: Rule, root: Path | None = None) -> Measured:
    """One measurement as `joulebox-agent measure` would make it: pilot, Stein's second stage, intervals."""
    rng = np.random.default_rng(seed)
    if rule.blocks:
        machine = configured(rng, machine)
    discharge, windows = _measured(rng, machine, rule, lead_s(gauge, rule.window_s))
    run = Run(rng, discharge, gauge, rule.source, root)
    count, found = rule.pilot, _energies(run, windows[: rule.pilot])
    if rule.most > rule.pilot and None not in found.gross_j:
        pilot = _per_image(found, windows[:count])
        needed = windows_needed(pilot, rule.half_width, least_share=found.least_share)
        count = min(rule.most, needed)
        found = _energies(run, windows[:count])
    windows = windows[:count]
    idle_w = None
    if rule.idle:
        blocks = [(discharge.edges_s[0], discharge.edges_s[0] + machine.idle_s),
                  (discharge.edges_s[-1] - machine.idle_s, discharge.edges_s[-1] - 1e-6)]  # fmt: skip
        series = run.read_until(blocks[-1][1])
        idle_w = idle_power(series, run.source, blocks, found.lag_s)
    drawn_j = [discharge.energy_j(w.start_s, w.end_s) for w in windows]
    per_image = [energy_j / w.images for energy_j, w in zip(drawn_j, windows, strict=True)]
    gross = net = None
    if None not in found.gross_j:
        values_j = _per_image(found, windows)
        least_half_j = found.least_share * float(np.mean(values_j))
        gross = two_stage_interval(values_j, rule.pilot, least_half=least_half_j)
        if idle_w is not None:
            times_s = [w.wall_s / w.images for w in windows]
            net = net_of_idle(values_j, times_s, idle_w, 2 * IDLE_PIECES, rule.pilot, least_half_j)
    return Measured(machine, gross, net, float(np.mean(per_image)), windows, found, drawn_j)


def _measured(
    rng: np.random.Generator, machine: Machine, rule: Rule, before_s: float
) -> tuple[Discharge, list[Window]]:
    """A discharge and the machine's windows in it: one after the other, or among those of another configuration."""
    around_s = 2 * before_s + 3 * machine.image_s
    if not rule.blocks:
        discharge = script(rng, [machine], rule.most * (rule.window_s + 1.2 * machine.image_s) + around_s)
        return discharge, windows_of(discharge.blocks[0], rule.window_s, before_s)[: rule.most]
    pair = (machine, configured(rng, machine))
    order = [int(member) for _ in range(rule.most) for member in rng.permutation(2)]
    discharge = script(rng, [pair[member] for member in order], rule.window_s + around_s)
    mine = [block for block, member in zip(discharge.blocks, order, strict=True) if member == 0]
    return discharge, [windows_of(block, rule.window_s, before_s)[0] for block in mine]


def _energies(run: Run, windows: list[Window]) -> WindowEnergies:
    """As the agent tells them when it leaves: the load goes on for a moment after the last window."""
    series = run.read_until(windows[-1].load_s[1])
    return window_energies(series, run.source, windows, run.resolution_j)


def _per_image(found: WindowEnergies, windows: list[Window]) -> list[float]:
    return [e / w.images for e, w in zip(found.gross_j, windows, strict=True) if e is not None]
