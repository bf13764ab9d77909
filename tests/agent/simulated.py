"""A machine that exists in accelerated time: its battery in a fake tree, its renderer, its clock. Nothing waits.

The truth (watts of every stage and of idling) is stated here and shares no code with what estimates it.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from joulebox_agent.loop import Build, DoneEvent, ImageEvent, ReadyEvent, StageEvent
from joulebox_agent.sampling.sampler import Sampler

IDLE_W = 5.0
STAGES_W = {"photon_map": 24.0, "direct": 17.0, "indirect": 14.0}
FULL_WH = 48.0


@dataclass
class Machine:
    """Clock, battery and the tree that shows them. Time moves by `advance` alone.

    gauge_s   refresh interval of the gauge; it shows the mean power since its last refresh, with white noise
    faults    called at every refresh of the tree: what else happens on this machine
    """

    root: Path
    seed: int = 0
    gauge_s: float = 1.0
    noise_w: float = 0.4
    charge_wh: float = 0.85 * FULL_WH
    time_s: float = 1000.0
    asleep_s: float = 0.0
    power_w: float = IDLE_W
    plugged: bool = False
    charger_w: float = 60.0
    frozen: bool = False
    broken: bool = False
    throttles: int = 0
    pack: bool = True
    used_j: float = 0.0  # the truth: what the machine has drawn since it was made
    faults: list[Callable[["Machine"], None]] = field(default_factory=list)
    samplers: list[Sampler] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.random = Random(self.seed)
        self.battery = self.root / "class/power_supply/BAT0"
        self.cable = self.root / "class/power_supply/AC"
        throttle = self.root / "devices/system/cpu/cpu0/thermal_throttle"
        for folder in (self.battery, self.cable, throttle):
            folder.mkdir(parents=True)
        self.throttle_file = throttle / "core_throttle_count"
        self._written: dict[Path, str] = {}
        self._next_refresh_s = self.time_s + self.gauge_s
        self._drawn_j, self._since_s = 0.0, self.time_s
        for name, text in (("type", "Battery"), ("present", "1"), ("energy_full", f"{FULL_WH * 1e6:.0f}"),
                           ("energy_full_design", f"{FULL_WH * 1e6:.0f}")):  # fmt: skip
            (self.battery / name).write_text(text)
        (self.cable / "type").write_text("Mains")
        self.refresh()

    def now_s(self) -> float:
        return self.time_s

    def slept_s(self) -> float:
        return self.asleep_s

    def write(self, file: Path, text: str) -> None:
        if self._written.get(file) != text and file.parent.is_dir():
            file.write_text(text)
            self._written[file] = text

    def refresh(self) -> None:
        """What the kernel's files say now."""
        self.write(self.cable / "online", "1" if self.plugged else "0")
        self.write(self.throttle_file, str(self.throttles))
        self.write(self.battery / "present", "1" if self.pack else "0")
        self.write(self.battery / "status", "Charging" if self.plugged else "Discharging")
        if self.broken:
            self.write(self.battery / "power_now", "junk")
            self.write(self.battery / "energy_now", "junk")
        elif not self.frozen:
            since_s = self.time_s - self._since_s
            mean_w = self._drawn_j / since_s if since_s > 0 else self.power_w
            shown_w = mean_w + self.random.gauss(0.0, self.noise_w)
            self.write(self.battery / "power_now", f"{shown_w * 1e6:.0f}")
            self.write(self.battery / "energy_now", f"{self.charge_wh * 1e6:.0f}")

    def advance(self, until_s: float) -> None:
        """Lets time pass: the battery drains or charges, the gauge refreshes, samplers poll."""
        while self.time_s < until_s:
            polls = [sampler.due_s for sampler in self.samplers]
            to_s = max(min([until_s, self._next_refresh_s, *polls]), self.time_s + 1e-6)
            net_w = self.power_w - (self.charger_w if self.plugged else 0.0)
            self.charge_wh = min(FULL_WH, self.charge_wh - net_w * (to_s - self.time_s) / 3600)
            self._drawn_j += abs(net_w) * (to_s - self.time_s)
            self.used_j += self.power_w * (to_s - self.time_s)
            self.time_s = to_s
            if to_s >= self._next_refresh_s:
                self._next_refresh_s += self.gauge_s
                for fault in list(self.faults):
                    fault(self)
                self.refresh()
                self._drawn_j, self._since_s = 0.0, to_s
            for sampler in self.samplers:
                sampler.poll()

    def reboot(self) -> None:
        """The clock begins anew."""
        self.time_s = 50.0
        self._next_refresh_s, self._since_s = 50.0 + self.gauge_s, 50.0

    def stand_still(self, seconds: float) -> None:
        """Time passes and nobody notices: a virtual machine that was paused."""
        self.time_s += seconds
        self.used_j += self.power_w * seconds
        self._drawn_j += self.power_w * seconds
        self._next_refresh_s = self.time_s + self.gauge_s

    def suspend(self, seconds: float) -> None:
        """Sleep: the monotonic clock stands still, the boot clock goes on."""
        self.asleep_s += seconds


class SimulatedSampler(Sampler):
    """A sampler that the machine polls as its time passes."""

    def __init__(self, source: Any, machine: Machine, lost_after_s: float = 60.0, poll_s: float | None = None) -> None:
        super().__init__(source, machine, lost_after_s)
        self.machine, self.poll_s = machine, poll_s or source.poll_s
        self.due_s = machine.now_s()

    def start(self) -> None:
        self.machine.samplers.append(self)
        self.sample()

    def stop(self) -> None:
        if self in self.machine.samplers:
            self.machine.samplers.remove(self)

    def pause(self, seconds: float) -> None:
        self.machine.advance(self.machine.now_s() + seconds)

    def poll(self) -> None:
        if self.machine.now_s() >= self.due_s:
            self.due_s = self.machine.now_s() + self.poll_s
            self.sample()

    def cpu_share(self) -> float:
        return 0.0


class SimulatedLoop:
    """A renderer whose stages take the seconds that its arguments name (`--set direct=0.4`)."""

    def __init__(self, machine: Machine, arguments: Sequence[str]) -> None:
        self.machine = machine
        settings = dict(word.split("=", 1) for word in arguments if "=" in word)
        self.stages_s = {name: float(settings.get(name, 0.0)) for name in STAGES_W}
        self.seed = settings.get("seed", "0")
        self.output = Path(arguments[arguments.index("-o") + 1])
        self.most = int(arguments[arguments.index("--max-images") + 1]) if "--max-images" in arguments else None
        self.queue: list[Any] = []
        self.image = 0

    def __enter__(self) -> "SimulatedLoop":
        self.machine.advance(self.machine.now_s() + 2.0)
        self.queue.append(
            ReadyEvent(event="ready", protocol=1, scene="cornell", scene_sha256="ab" * 32, settings=self.stages_s,
                       build=Build(name="simulated", version="1", intersector="none", isa="none", threads=1))
        )  # fmt: skip
        return self

    def __exit__(self, *words: object) -> None:
        self.machine.power_w = IDLE_W

    def next_event(self, timeout_s: float) -> Any:
        if not self.queue:
            if self.image == self.most:
                self.output.write_bytes(b"picture")
                return DoneEvent(event="done", images=self.image)
            self.render()
        return self.queue.pop(0)

    def render(self) -> None:
        start_s = self.machine.now_s()
        for name, seconds in self.stages_s.items():
            if seconds:
                from_s = self.machine.now_s()
                self.machine.power_w = STAGES_W[name]
                self.machine.advance(from_s + seconds)
                self.queue.append(StageEvent(event="stage", image=self.image, name=name, start_s=from_s,
                                             end_s=self.machine.now_s(), cpu_s=seconds))  # fmt: skip
        end_s = self.machine.now_s()
        length_s = end_s - start_s
        self.queue.append(ImageEvent(event="image", image=self.image, start_s=start_s, end_s=end_s, time_s=length_s,
                                     cpu_s=length_s, pixel_sha256=self.seed * 64))  # fmt: skip
        self.image += 1

    def stop(self, within_s: float = 0.0) -> None:
        self.output.write_bytes(b"picture")
        self.machine.power_w = IDLE_W


def true_energy_j(stages_s: dict[str, float]) -> float:
    """What one image costs on this machine [J]."""
    return sum(STAGES_W[name] * seconds for name, seconds in stages_s.items())


def journal_lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]
