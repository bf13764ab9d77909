"""A renderer that stays between jobs: a start costs more than a short picture does.

`RENDERER jobs` writes `waiting`, takes the arguments of a loop as a JSON array on a line of its standard input, speaks
the loop protocol for it and waits again. A program that does not know this is started for every job.
"""

import json
from collections.abc import Callable, Sequence

from joulebox_agent.clock import Clock
from joulebox_agent.errors import RendererError, RendererRefusedError
from joulebox_agent.loop import DoneEvent, ImageEvent, ReadyEvent, RendererLoop, StageEvent
from joulebox_agent.process import STOP_WITHIN_S, RendererProcess


class KeptRenderer:
    """Makes loops that share one process as long as each comes to its own end. `close` when no job is in sight.

    A job that was stopped, failed or refused ends the process with it, and the next one starts another: whatever went
    wrong in one job is gone with its memory.
    """

    def __init__(self) -> None:
        self.command: Sequence[str] = ()
        self.does_jobs = True
        self.idle: RendererProcess | None = None

    def __call__(
        self, command: Sequence[str], arguments: Sequence[str], clock: Clock, on_words: Callable[[str], None]
    ) -> "KeptLoop":
        """A loop for one job, to be used as a context manager; one at a time."""
        if list(command) != list(self.command):
            self.close()
            self.command, self.does_jobs = list(command), True
        return KeptLoop(self, command, arguments, clock, on_words)

    def close(self) -> None:
        """Ends the process that waits, if one does; the next job starts another."""
        process, self.idle = self.idle, None
        if process is not None:
            process.stop()


class KeptLoop(RendererLoop):
    """One job told to the process that waits, or to a new one."""

    def __init__(
        self,
        keeper: KeptRenderer,
        command: Sequence[str],
        arguments: Sequence[str],
        clock: Clock,
        on_words: Callable[[str], None],
    ) -> None:
        super().__init__(command, arguments, clock, on_words)
        self._keeper = keeper
        self._job = json.dumps(list(arguments))
        self._told = self._done = False

    def __enter__(self) -> RendererLoop:
        process, self._keeper.idle = self._keeper.idle, None
        if process is not None:
            process.hear(self._clock, self._on_words)
            self._told = process.tell(self._job)
            if self._told:
                self._process = process
                return self
            process.stop()
        if not self._keeper.does_jobs:
            self._told = True
            return super().__enter__()
        self._process = RendererProcess([*self._keeper.command, "jobs"], self._clock, self._on_words, listens=True)
        return self

    def next_event(self, timeout_s: float) -> ReadyEvent | StageEvent | ImageEvent | DoneEvent | None:
        """As the loop's own. The job is told here, since a start takes seconds in which a stop may be asked for."""
        if not self._told:
            self._begin(timeout_s)
            return None
        event = super().next_event(timeout_s)
        self._done = isinstance(event, DoneEvent)
        return event

    def _begin(self, timeout_s: float) -> None:
        try:
            item = self._process.next_line(timeout_s)
        except RendererRefusedError:
            # no such command: one process a job, from now on
            self._keeper.does_jobs = False
            self._process.stop()
            self._told = True
            super().__enter__()
            return
        if item is None:
            return
        if not _waits(item[1]):
            raise RendererError(f"The renderer's first line is not that it waits for a job: {item[1].strip()[:80]!r}.")
        self._told = self._process.tell(self._job)

    def stop(self, within_s: float = STOP_WITHIN_S) -> None:
        """Keeps a process that has done its job and waits for another; ends any other. Safe to call again."""
        if self._keeper.idle is self._process:
            return
        if self._done and self._keeper.does_jobs and self._waits_again(within_s):
            self._keeper.idle = self._process
        else:
            self._process.stop(within_s)

    def _waits_again(self, within_s: float) -> bool:
        try:
            item = self._process.next_line(within_s)
        except RendererError:  # it ended of its own will, its job done
            return False
        return item is not None and _waits(item[1])


def _waits(line: str) -> bool:
    try:
        told = json.loads(line)
    except (ValueError, RecursionError):
        return False
    return isinstance(told, dict) and told.get("event") == "waiting" and told.get("protocol") == 1
