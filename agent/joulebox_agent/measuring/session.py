"""Measuring one or several configurations: rounds of visits, idle times between them, Stein's rule, the control."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from joulebox_agent.errors import ChargingError, RendererError
from joulebox_agent.estimates.energies import window_energies
from joulebox_agent.estimates.estimate import two_stage_interval, windows_needed
from joulebox_agent.loop import RendererLoop
from joulebox_agent.measuring.blocks import Course, Drift, control_drift, mark_suspects, shuffled
from joulebox_agent.measuring.charging import Charging
from joulebox_agent.measuring.journal import Journal
from joulebox_agent.measuring.meter import Meter
from joulebox_agent.measuring.picture import keep_picture
from joulebox_agent.measuring.recording import Recording, VoidWindow
from joulebox_agent.measuring.rule import MeasureRule
from joulebox_agent.measuring.visit import Ending, Job, LoopFactory, Visit
from joulebox_agent.sampling.series import PowerSeries

LONGEST_TIMED_WINDOW_S = 5.0  # seconds are known sooner than joules
BLOCKS_BEYOND = 2  # times the most windows: void windows and configurations that need more take further blocks


@dataclass(frozen=True)
class Configuration:
    """One thing to measure; `timed_only`: its seconds are taken and its joules come from the stage powers."""

    job: Job
    label: str = ""
    timed_only: bool = False


class Session:
    """Measures the configurations under one rule. `run()` may be called once; `records` fill meanwhile."""

    def __init__(
        self,
        configurations: list[Configuration],
        rule: MeasureRule,
        meter: Meter,
        course: Course | None = None,
        charging: Charging | None = None,
        journal: Journal | None = None,
        make_loop: LoopFactory = RendererLoop,
    ) -> None:
        self._configurations, self._rule, self._meter = configurations, rule, meter
        self._course = course or Course()
        self._charging, self._journal, self._make_loop = charging, journal, make_loop
        self._listener = meter.listener
        choice = meter.choice
        self.records = [Recording(choice.source, choice.report, meter.start_s) for _ in configurations]
        self._wanted = [rule.min_windows if rule.meter else 1] * len(configurations)
        self._decided = [False] * len(configurations)
        self._given_up: set[int] = set()
        self._estimate = ""
        self._began_share: object = None
        self.drift: Drift | None = None

    def run(self) -> list[Recording]:
        """Measures. Raises RendererError, StoppedError; what is void is returned as such."""
        before = self._meter.conditions()
        self._began_share = before.get("battery_charge_share")
        if self._journal is not None:
            self._journal.resume(self.records, self._meter)
            for index in range(len(self.records)):
                self._decide(index)
        self._meter.start()
        try:
            self._measure()
            for configuration, record in zip(self._configurations, self.records, strict=True):
                keep_picture(record, configuration.job, self._meter, self._make_loop, self._rule.silence_s)
        finally:
            self._meter.stop()
            after = self._meter.conditions()
            for record in self.records:
                record.before, record.after = before, after
                record.samples, record.companion_samples = self._meter.samples(), self._meter.companion_samples()
                record.idle = list(self._meter.idle)
                record.sampler_cpu_share = self._meter.cpu_share()
        self._mark_drift()
        return self.records

    def _measure(self) -> None:
        self._meter.rest(self._rule.idle_s)
        for block, members in self._rounds():
            for index in members:
                if self._trouble_ends_it():
                    return
                self._visit(index, block)
            self._commit()
            self._meter.rest(self._rule.idle_s)
        for index, configuration in enumerate(self._configurations):
            if configuration.timed_only and not self._trouble_ends_it():
                self._visit(index, 0)
        self._commit()

    def _rounds(self) -> Iterator[tuple[int, list[int]]]:
        """Blocks (number, configurations in order) until every metered configuration has what it needs."""
        metered = [i for i, configuration in enumerate(self._configurations) if not configuration.timed_only]
        control = self._course.control
        if self._course.order == "sequence":
            for block, index in enumerate(metered):
                if self._needs(index):
                    yield block, [control, index] if len(metered) > 1 and index != control else [index]
            return
        first = max((block for record in self.records for block in record.blocks), default=-1)
        for block in range(max(first, 0), BLOCKS_BEYOND * self._rule.max_windows):
            members = {i for i in metered if self._needs(i) and block not in self.records[i].blocks}
            if not any(self._needs(i) for i in metered):
                return
            if control not in self._given_up and block not in self.records[control].blocks:
                members.add(control)
            self._listener.note(f"block {block + 1}: {len(members)} configurations")
            yield block, shuffled(members, self._course.seed, block)

    def _needs(self, index: int) -> bool:
        """Whether the configuration wants another window."""
        record = self.records[index]
        if index in self._given_up or record.void is not None:
            return False
        return len(record.windows) < min(self._wanted[index], self._rule.max_windows) or not self._rule.meter

    def _visit(self, index: int, block: int) -> None:
        """One configuration's windows of this block, through as many runs of the renderer as charges ask for."""
        configuration, record = self._configurations[index], self.records[index]
        enough = self._enough(index)
        while not record.void and not self._trouble_ends_it():
            if not self._charged(index):
                return
            note = self._meter.cool_down(self._course.cool_to_c)
            if note:
                record.note(note)
            if len(self._configurations) > 1:
                self._listener.note(f"configuration {index + 1}: {configuration.label}")
            ending = self._one_run(index, block, enough)
            if ending == "time":
                self._give_up_in_time(index)
            if ending in ("enough", "time", "void", "over"):
                return

    def _one_run(self, index: int, block: int, enough: Callable[[], bool]) -> Ending:
        """One run of the renderer; among several configurations its failure voids its own only."""
        configuration, record = self._configurations[index], self.records[index]
        try:
            return Visit(
                configuration.job,
                self._timing_rule() if configuration.timed_only else self._rule,
                self._meter,
                record,
                enough=enough,
                on_window=lambda: self._after_window(index),
                low=self._low,
                progress=lambda elapsed_s: self._show(index, elapsed_s),
                block=block,
                make_loop=self._make_loop,
            ).run()
        except RendererError as error:
            if len(self.records) == 1:
                raise
            record.make_void(str(error), environment=False)
            return "void"

    def _enough(self, index: int) -> Callable[[], bool]:
        """In a block one more window; in a sequence what Stein asks for, of the control one."""
        record = self.records[index]
        had = len(record.windows)
        if self._configurations[index].timed_only:
            return lambda: len(record.windows) >= self._rule.min_windows
        if self._course.order == "blocks" or (not self._needs(index) and self._rule.meter):
            return lambda: len(record.windows) > had
        return lambda: not self._needs(index) if self._rule.meter else False

    def _timing_rule(self) -> MeasureRule:
        window_s = min(self._rule.window_s, LONGEST_TIMED_WINDOW_S)
        return self._rule.model_copy(update={"window_s": window_s})

    def _after_window(self, index: int) -> bool:
        """Looks back, decides, keeps; True when that touched the disk."""
        self._look_back()
        self._decide(index)
        return self._commit()

    def _look_back(self) -> None:
        """Voids windows that a fault reaches that was noticed later (a gauge that froze shows it late)."""
        found = [(record, window) for record in self.records for window in record.windows]
        reasons = self._meter.void_reasons([(window.start_s, window.end_s) for _, window in found])
        for (record, window), reason in zip(found, reasons, strict=True):
            if reason is not None:
                record.voided.append(VoidWindow(window.start_s, window.end_s, window.images, reason))
                at = record.windows.index(window)
                del record.windows[at], record.blocks[at]

    def _decide(self, index: int) -> None:
        """The running estimate after every window, and when the pilot is complete, Stein's second stage."""
        values, unit, least_share = self._values(index)
        if len(values) < 2:
            return
        least_half = least_share * sum(values) / len(values)
        interval = two_stage_interval(values, self._rule.min_windows, least_half=least_half)
        self._estimate = f"{interval.value:.4g} {unit} an image ± {interval.half_width:.2g}"
        if not self._decided[index] and len(self.records[index].windows) >= self._wanted[index]:
            self._decided[index] = True
            pilot = values[: max(2, self._rule.min_windows)]
            needed = windows_needed(pilot, self._rule.half_width, least_share=least_share)
            self._wanted[index] = min(self._rule.max_windows, max(self._wanted[index], needed))

    def _values(self, index: int) -> tuple[list[float], str, float]:
        """What decides the number of windows: joules an image, seconds an image where no energy is known;
        their unit; their least half-width as a share."""
        record = self.records[index]
        series = PowerSeries(self._meter.samples())
        found = window_energies(series, record.source, record.windows, record.source_report.resolution_j)
        joules = [g / w.images for g, w in zip(found.gross_j, record.windows, strict=True) if g is not None]
        if joules:
            return joules, "J", found.least_share
        return [w.image_time_s / w.images for w in record.windows], "s", 0.0

    def _show(self, index: int, elapsed_s: float) -> None:
        self._listener.progress(elapsed_s, len(self.records[index].windows), self._wanted[index], self._estimate)

    def _give_up_in_time(self, index: int) -> None:
        self._given_up.add(index)
        record = self.records[index]
        if self._rule.meter:
            done, wanted = len(record.windows), self._wanted[index]
            why = "a stop of the agent" if self._meter.leaving() else f"the limit of {self._rule.max_seconds:g} s"
            record.note(f"{why} ended it after {done} of {wanted} windows")

    def _trouble_ends_it(self) -> bool:
        """Whether the source is gone for good: what is incomplete is void, what is complete stays.

        With charging planned a cable is no end: the session waits until it is out again.
        """
        trouble = self._meter.trouble()
        if trouble is None:
            return False
        self._look_back()
        if self._charging is not None and self._charging.waits and self._charging.plugged():
            self._pause_sampling(self._charging.wait_for_discharge)
            return False
        several = len(self.records) > 1
        for record in self.records:
            if several and len(record.windows) >= self._rule.min_windows:
                record.note(f"it ended early: {trouble}")
            else:
                record.make_void(trouble, environment=True)
        return True

    def _low(self) -> bool:
        return self._charging is not None and self._charging.must_charge()

    def _charged(self, index: int) -> bool:
        """Waits for a charge where one is due; False where nobody waits for it, or it fails, and the configuration ends
        with the windows that it has. Raises AgentError where charging fails before any window."""
        if self._charging is None or not self._charging.must_charge():
            return True
        self._look_back()
        self._commit()
        why, next_may_do = self._charging.used_up(), not self._charging.from_full(self._began_share)
        if self._charging.waits:
            try:
                self._pause_sampling(self._charging.charge)
                return True
            except ChargingError as error:
                if not any(record.windows for record in self.records):
                    raise
                self._meter.start()
                why, next_may_do = str(error).removesuffix("."), True
        record, done = self.records[index], len(self.records[index].windows)
        words = f"{why} after {done} of {self._wanted[index]} windows"
        self._given_up.add(index)
        if done >= self._rule.min_windows:
            record.note(words)
        else:
            record.make_void(words, environment=next_may_do)
        return False

    def _pause_sampling(self, wait: Callable[[Meter], None]) -> None:
        self._meter.stop()
        wait(self._meter)
        self._meter.start()

    def _commit(self) -> bool:
        if self._journal is None:
            return False
        self._journal.commit(self.records, self._meter)
        return True

    def _mark_drift(self) -> None:
        """Flags the control's drift and marks every result with windows after its last good window."""
        control = self._course.control
        if len(self.records) < 2 or self._configurations[control].timed_only:
            return
        values, unit, _ = self._values(control)
        if len(values) == len(self.records[control].windows):
            self.drift = control_drift(values, self._rule.min_windows, unit)
        if self.drift is not None:
            mark_suspects(self.records, control, self.drift, self._rule.min_windows)
