"""Metered windows of one process, job after job, so that a sweep that comes as single jobs still tells stage powers."""

from collections import deque
from collections.abc import Hashable

from joulebox_agent.conditions import Conditions
from joulebox_agent.estimates.stage_power import FitError, StagePowerFit, WindowTotals, fit_stage_powers
from joulebox_agent.measuring.meter import SETTLED
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.measuring.several import window_totals

MOST_WINDOWS = 60  # the latest; a machine that wandered over hours is not one machine any more


class StageLedger:
    """Windows of the same scene, renderer and source, under the same settled state of the machine.

    Their times are on one clock's axis, as drift from window to window asks, so nothing is kept beyond this process.
    """

    def __init__(self) -> None:
        self._windows: dict[Hashable, deque[WindowTotals]] = {}

    def add(self, record: Recording) -> None:
        """Takes the metered windows of a recording that is not void."""
        if record.void is None and record.ready is not None and record.source.quality != "none":
            self._windows.setdefault(_kind(record), deque(maxlen=MOST_WINDOWS)).extend(window_totals(record))

    def powers(self, record: Recording) -> tuple[StagePowerFit | None, str | None]:
        """(stage powers of this recording's kind, None) or (None, why there are none yet)."""
        if record.ready is None:
            return None, "nothing was rendered"
        try:
            return fit_stage_powers(list(self._windows.get(_kind(record), ()))), None
        except FitError as error:
            return None, str(error)


def _kind(record: Recording) -> Hashable:
    """What two windows must share for a stage to draw the same power in both."""
    assert record.ready is not None
    build, state = record.ready.build, {**record.before, **record.after}
    settled = tuple(_settled(state, name) for name in SETTLED)
    return record.ready.scene_sha256, build.name, build.version, record.source.method, settled


def _settled(state: Conditions, name: str) -> Hashable:
    value = state.get(name)
    return tuple(value) if isinstance(value, list) else value
