"""The loop of `run`: deliver what is finished, lease a job, have it measured; no contact while measuring."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from joulebox_agent.conditions import read_conditions
from joulebox_agent.errors import AgentError, ServerUnreachableError, TokenRejectedError
from joulebox_agent.fleet.attempts import Attempts
from joulebox_agent.fleet.bundle import SceneCache
from joulebox_agent.fleet.capabilities import describe_device
from joulebox_agent.fleet.delivery import Delivery
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.options import RunOptions
from joulebox_agent.fleet.pauses import Pauses
from joulebox_agent.fleet.readiness import Readiness
from joulebox_agent.fleet.server import Server
from joulebox_agent.fleet.spool import Spool
from joulebox_agent.fleet.state import StateDir, boot_id
from joulebox_agent.fleet.stopping import Stop
from joulebox_agent.fleet.work import ShownListener, Worker


class Daemon:
    """One agent on one state folder. `run()` returns when it is told to stop or its limits are reached."""

    def __init__(
        self,
        state: StateDir,
        device_id: str,
        server: Server,
        renderer: Sequence[str],
        options: RunOptions,
        stop: Stop,
        journal: Journal,
        listener: Callable[[], ShownListener],
    ) -> None:
        self._state, self._device_id, self._server = state, device_id, server
        self._renderer, self._options, self._stop, self._journal = renderer, options, stop, journal
        self._boot_id = boot_id()
        self.delivery = Delivery(Spool(state.spool), server, journal)
        self._attempts = Attempts(state, server, journal, [path.stem for path in self.delivery.spool.waiting()])
        self._readiness = Readiness(options, self.delivery, journal)
        self._pauses = Pauses(options.pause_s, options.longest_pause_s)
        scenes = SceneCache(state.scenes, server)
        self.worker = Worker(
            state, renderer, options, scenes, self._attempts, self.delivery, stop, journal, listener,
            self._readiness.charging,
        )  # fmt: skip
        self._jobs = 0
        self._last_job_s = time.monotonic()

    def run(self) -> None:
        """Works until stopped. Raises TokenRejectedError, a RendererError at the start, with `once` any failure."""
        self.delivery.spool.sweep()
        self.worker.clean()
        capabilities = describe_device(self._renderer, self._options.source, self._options.sysfs_root)
        self._last_job_s = time.monotonic()  # asking the renderer about itself was not idleness
        try:
            self._work(capabilities)
        finally:
            self.worker.rest()
            self._readiness.close()
        self._end()

    def _work(self, capabilities: dict[str, Any]) -> None:
        announced = False
        while not self._stop.asked.is_set() and not self._over():
            try:
                if not announced:
                    self._server.put_capabilities(self._device_id, capabilities)
                    announced = True
                    self._journal.lasts("ready", f"Ready for jobs of {self._server.url}.")
                self._round()
            except ServerUnreachableError as error:
                if self._options.once:
                    self._end()
                    raise ServerUnreachableError(f"{error} {self._kept()}") from error
                words = f"{error} {self._kept()} Trying again until it answers."
                self._journal.lasts("unreachable", words, "warning")
                self._pause()
            if self._options.once:
                break

    def _over(self) -> bool:
        options = self._options
        idle_s = time.monotonic() - self._last_job_s
        if options.idle_exit_s is not None and idle_s > options.idle_exit_s:
            return True
        return options.max_jobs is not None and self._jobs >= options.max_jobs and self._waiting() == 0

    def _round(self) -> None:
        """Deliver, see whether measuring is possible, lease, work, deliver."""
        self._settle()
        if self._options.max_jobs is not None and self._jobs >= self._options.max_jobs:
            return
        reason = self._readiness.why_not()
        if reason:
            self._journal.lasts("unfit", f"Not fit to measure now: {reason}.")
            self._pause()
            return
        conditions = read_conditions(self._options.sysfs_root)
        leases, wait_s = self._server.lease(self._boot_id, conditions, self._longest_wait_s())
        self._pauses.over()
        if not leases:
            self._idle(wait_s)
            return
        self._attempts.take(leases)
        for lease in leases:
            before = self._readiness.share()
            if not self.worker.do(lease):
                self._pause()
            self._readiness.took(before)
            self._jobs += 1
            self._last_job_s = time.monotonic()
        self._settle()

    def _idle(self, wait_s: float) -> None:
        self.worker.rest()
        self._journal.lasts("idle", "The server has no job for this device.", quiet=not self._options.once)
        if not self._options.once:
            self._stop.asked.wait(min(wait_s, self._longest_wait_s()))

    def _settle(self) -> None:
        """Gives back what cannot be done and sends what is finished."""
        self._attempts.settle()
        self.delivery.send_all()

    def _end(self) -> None:
        """A last try for what is still ours; the spool keeps the rest for the next run."""
        try:
            self._settle()
        except ServerUnreachableError:
            pass
        except TokenRejectedError as error:
            self._journal.say("rejected", str(error), "warning")
        if self._waiting():
            self._journal.say("kept", self._kept())
        if self.delivery.in_memory:
            raise AgentError(
                f"The disk of {self._state.spool} is full and the server does not answer: "
                f"{len(self.delivery.in_memory)} results in memory are lost with this process."
            )

    def _waiting(self) -> int:
        return len(self.delivery.spool.waiting()) + len(self.delivery.in_memory)

    def _kept(self) -> str:
        waiting = self._waiting()
        return f"{waiting} finished {'result is' if waiting == 1 else 'results are'} kept in the spool."

    def _longest_wait_s(self) -> float:
        """No wait outlives the idle limit."""
        if self._options.idle_exit_s is None:
            return self._options.wait_s
        left_s = self._options.idle_exit_s - (time.monotonic() - self._last_job_s)
        return max(0.0, min(self._options.wait_s, left_s))

    def _pause(self) -> None:
        self.worker.rest()
        self._stop.asked.wait(self._pauses.next_s())
