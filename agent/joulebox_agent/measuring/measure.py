"""One measurement: a renderer looping in a subprocess, a sampler beside it, windows as Stein's rule asks."""

import threading
from collections.abc import Callable
from pathlib import Path

from joulebox_agent.clock import Clock, SystemClock
from joulebox_agent.loop import RendererLoop
from joulebox_agent.measuring.charging import Charging
from joulebox_agent.measuring.meter import Listener, Meter, Silent
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.measuring.rule import MeasureRule
from joulebox_agent.measuring.session import Configuration, Session
from joulebox_agent.measuring.visit import Job, LoopFactory
from joulebox_agent.sampling.sampler import SENSOR_LOST_AFTER_S, Sampler, Sampling
from joulebox_agent.sampling.sampler_process import SamplerProcess
from joulebox_agent.sources.choose import Choice, choose


def make_meter(
    choice: Choice,
    sysfs_root: Path = Path("/sys"),
    listener: Listener | None = None,
    stop: threading.Event | None = None,
    clock: Clock | None = None,
    lost_after_s: float = SENSOR_LOST_AFTER_S,
    companion: str | None = None,
    leave: threading.Event | None = None,
) -> Meter:
    """A meter for the chosen source, sampled in a process of its own.

    A source that was made in this process only (its choice has no name), or a clock that is not the machine's,
    is sampled by a thread instead. companion: the name of a second source that is read along for calibration.
    """
    own_clock: Clock = clock or SystemClock()
    make: Callable[[], Sampling]
    if not choice.name or clock is not None or choice.source.quality == "none":

        def make() -> Sampling:
            return Sampler(choice.source, own_clock, lost_after_s)
    else:

        def make() -> Sampling:
            return SamplerProcess(choice, sysfs_root, companion, lost_after_s)

    return Meter(choice, make, own_clock, sysfs_root, stop or threading.Event(), listener or Silent(), leave)


class Measurement:
    """Runs one job under one rule. `run()` may be called once.

    stop   ends it at once, with StoppedError
    leave  ends it as the time limit does with the windows that it has, or with the one under way if that is all that
           is missing for an answer; else as `stop`
    companion  the name of a second source that is read along for calibration
    """

    def __init__(
        self,
        job: Job,
        rule: MeasureRule,
        choice: Choice,
        listener: Listener | None = None,
        stop: threading.Event | None = None,
        sysfs_root: Path = Path("/sys"),
        clock: Clock | None = None,
        lost_after_s: float = SENSOR_LOST_AFTER_S,
        charging: Charging | None = None,
        make_loop: LoopFactory = RendererLoop,
        leave: threading.Event | None = None,
        companion: str | None = None,
    ) -> None:
        if not rule.meter:
            choice, companion = choose("none"), None
        meter = make_meter(choice, sysfs_root, listener, stop, clock, lost_after_s, companion, leave)
        self._session = Session([Configuration(job)], rule, meter, charging=charging, make_loop=make_loop)

    @property
    def recording(self) -> Recording:
        """What there is so far."""
        return self._session.records[0]

    def run(self) -> Recording:
        """Measures. Raises RendererError, StoppedError; a void measurement is returned as such."""
        return self._session.run()[0]
