"""The machine while it is measured: its source under watch, its state, its idle times, its stop."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from joulebox_agent.clock import Clock
from joulebox_agent.conditions import Conditions, read_conditions, throttled
from joulebox_agent.errors import AgentError
from joulebox_agent.sampling.faults import stretch_fault
from joulebox_agent.sampling.sampler import Sample, Sampling
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.choose import Choice

LOOK_EVERY_S = 0.25  # how soon a plugged cable or a request to stop is noticed
IDLE_TRIES = 3
COOL_WITHIN_S = 900.0
SETTLED = ("brightness_share", "power_profile", "governor", "energy_preference")
"""Conditions that a window is compared under: when one changes, the power does."""


class StoppedError(AgentError):
    """The measurement was asked to stop before it had an answer."""


class Listener(Protocol):
    """Who wants to know how a measurement goes."""

    def note(self, text: str) -> None:
        """A line of news."""

    def words(self, text: str) -> None:
        """What the renderer writes to stderr while it prepares."""

    def progress(self, elapsed_s: float, windows: int, wanted: int, estimate: str) -> None:
        """After every image: windows so far, windows wanted, the running estimate in words."""


class Silent:
    """A listener that wants to know nothing."""

    def note(self, text: str) -> None: ...
    def words(self, text: str) -> None: ...
    def progress(self, elapsed_s: float, windows: int, wanted: int, estimate: str) -> None: ...


class Meter:
    """Reads one source from `start` to `stop`, perhaps in several stretches, and tells what it was worth.

    make_sampler  called for every stretch: a sampler is used once
    earlier       samples of an earlier process, already on this one's axis of time
    """

    def __init__(
        self,
        choice: Choice,
        make_sampler: Callable[[], Sampling],
        clock: Clock,
        sysfs_root: Path,
        stop: threading.Event,
        listener: Listener,
        leave: threading.Event | None = None,
    ) -> None:
        self.choice, self.clock, self.sysfs_root, self.listener = choice, clock, sysfs_root, listener
        self._make_sampler, self._stop, self._leave = make_sampler, stop, leave
        self._sampler = make_sampler()
        self._running = False
        self._cpu_shares: list[float] = []
        self.start_s = self._sampler.start_s
        self.earlier: list[Sample] = []
        self.earlier_companions: list[Sample] = []
        self.idle: list[tuple[float, float]] = []
        self._load_changes_s: list[float] = []
        self._reference: Conditions | None = None

    def start(self) -> None:
        """Begins to sample, after a `stop` with a new sampler and the old one's samples kept."""
        if self._cpu_shares:
            self.earlier, self.earlier_companions = self.samples(), self.companion_samples()
            self._sampler = self._make_sampler()
        self._sampler.start()
        self._running = True

    def stop(self) -> None:
        """Ends sampling. Safe to call again."""
        self._sampler.stop()
        if self._running:
            self._cpu_shares.append(self._sampler.cpu_share())
        self._running = False

    def samples(self) -> list[Sample]:
        """All samples, oldest first; the counters of different stretches share no epoch."""
        return joined(self.earlier, self._sampler.samples())

    def companion_samples(self) -> list[Sample]:
        """The same for the source that is read along."""
        return joined(self.earlier_companions, self._sampler.companion_samples())

    def cpu_share(self) -> float:
        """CPU time of the sampling as a share of one core; the dearest stretch."""
        return max([*self._cpu_shares, self._sampler.cpu_share()] if self._running else self._cpu_shares, default=0.0)

    def sample(self) -> None:
        self._sampler.sample()

    def pause(self, seconds: float) -> None:
        self._sampler.pause(seconds)

    def refresh_s(self) -> float | None:
        """The gauge's refresh interval as seen so far."""
        return PowerSeries(self.samples()).refresh_s()

    def load_changed(self) -> None:
        """Notes that rendering begins or ends now: a gauge that does not follow is frozen."""
        self._load_changes_s.append(self.clock.now_s())

    def passing_fault(self, start_s: float, end_s: float) -> str | None:
        """What the samples showed at once (sleep, mains, a lost sensor) that voids a stretch, or None."""
        return self._sampler.void_reason(start_s, end_s)

    def void_reasons(self, stretches: Sequence[tuple[float, float]]) -> list[str | None]:
        """Why each stretch (start_s, end_s) must not be used, or None, after looking at its samples again.

        Stretches of before the last `start` were judged then: the pause between is no fault of theirs.
        """
        source, since_s = self.choice.source, self._sampler.start_s
        if source.quality == "none" or not stretches:
            return [self.passing_fault(start_s, end_s) for start_s, end_s in stretches]
        series = PowerSeries(self._sampler.samples())
        return [
            self.passing_fault(start_s, end_s)
            or stretch_fault(series, start_s, end_s, source.primary, self._load_changes_s)
            if start_s >= since_s
            else None
            for start_s, end_s in stretches
        ]

    def trouble(self) -> str | None:
        """Why nothing more can be measured, or None. Raises StoppedError when that was asked for."""
        self.check_stop()
        return self._sampler.trouble()

    def check_stop(self) -> None:
        """Raises StoppedError when the measurement was asked to stop."""
        if self._stop.is_set():
            raise StoppedError("The measurement was stopped before it had an answer.")

    def leaving(self) -> bool:
        """Whether the measurement was asked to end with the windows that it has, if they are enough for an answer."""
        return self._leave is not None and self._leave.is_set()

    def conditions(self) -> Conditions:
        return read_conditions(self.sysfs_root)

    def state_change(self, before: Conditions, now: Conditions) -> str | None:
        """Why a window between the two is void: throttling, or a state that is not the measurement's first."""
        self._reference = self._reference or before
        for name in SETTLED:
            first, last = self._reference.get(name), now.get(name)
            if first is not None and last is not None and first != last:
                return f"{name} was {first} and became {last}"
        return throttled(before, now)

    def rest(self, idle_s: float) -> None:
        """Lets the machine idle for the asked time and marks the stretch; again when a fault spoils it."""
        if not idle_s or self.choice.source.quality == "none":
            return
        self.listener.note(f"measuring idle power for {idle_s:g} s")
        for _ in range(IDLE_TRIES):
            self.sample()
            start_s = self.clock.now_s()
            while (left_s := start_s + idle_s - self.clock.now_s()) > 0:
                if self.trouble():
                    return
                self.pause(min(LOOK_EVERY_S, left_s))
            self.sample()
            end_s = self.clock.now_s()
            (reason,) = self.void_reasons([(start_s, end_s)])
            if reason is None:
                self.idle.append((start_s, end_s))
                return
            self.listener.note(f"idle time is void: {reason}")

    def cool_down(self, target_c: float | None) -> str | None:
        """Waits until the hottest sensor is at most `target_c`; a note when it does not get there."""
        if target_c is None:
            return None
        start_s, said = self.clock.now_s(), False
        while True:
            now_c = self.conditions().get("temperature_c")
            if not isinstance(now_c, int | float):
                return "no temperature can be read here: nothing waited for it"
            if now_c <= target_c:
                return None
            if self.clock.now_s() - start_s > COOL_WITHIN_S:
                return f"still {now_c:g} C after {COOL_WITHIN_S / 60:.0f} minutes of cooling down to {target_c:g} C"
            if self.trouble():
                return None
            if not said:
                self.listener.note(f"cooling down from {now_c:g} C to {target_c:g} C")
                said = True
            self.pause(2.0)


def joined(earlier: list[Sample], samples: list[Sample]) -> list[Sample]:
    if not earlier or not samples:
        return earlier or samples
    epoch = max(sample.reading.epoch for sample in earlier) + 1
    return earlier + [replace(s, reading=replace(s.reading, epoch=epoch + s.reading.epoch)) for s in samples]
