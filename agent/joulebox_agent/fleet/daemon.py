"""The loop of `run`: lease a job, measure it, keep the result, deliver it; no contact while measuring."""

import json
import random
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from joulebox_agent.conditions import read_conditions
from joulebox_agent.errors import (
    AgentError,
    BundleError,
    RendererError,
    ServerRefusedError,
    ServerUnreachableError,
    SourceUnavailableError,
    TokenRejectedError,
    UsageError,
)
from joulebox_agent.files import write_whole
from joulebox_agent.fleet.bundle import SceneCache
from joulebox_agent.fleet.capabilities import describe_device
from joulebox_agent.fleet.delivery import Delivery
from joulebox_agent.fleet.server import Lease, Server
from joulebox_agent.fleet.spool import Entry, Spool
from joulebox_agent.fleet.state import StateDir, boot_id
from joulebox_agent.measuring.charging import MEASURING_BAND, Band, Charging
from joulebox_agent.measuring.measure import Measurement
from joulebox_agent.measuring.meter import Listener, StoppedError
from joulebox_agent.measuring.result import Result, build_result
from joulebox_agent.measuring.rule import MeasureRule, make_rule
from joulebox_agent.measuring.visit import Job
from joulebox_agent.sources.choose import choose, unfit_reason


class ShownListener(Listener, AbstractContextManager["ShownListener"], Protocol):
    """A listener that is shown while a block runs."""


@dataclass(frozen=True)
class RunOptions:
    """What `run` was asked for.

    once         one lease at most, and an unreachable server is an error
    max_jobs     end after this many jobs; None: never
    idle_exit_s  end after this long without a job; None: never
    wait_s       how long the server may hold a lease request [s]
    charge_band  measure within it; below it the device is not fit until it was charged
    charge_hook  command that switches a charger on and off
    pause_s      first pause after trouble; doubles up to `longest_pause_s`, jittered
    """

    source: str = "auto"
    sysfs_root: Path = Path("/sys")
    once: bool = False
    max_jobs: int | None = None
    idle_exit_s: float | None = None
    wait_s: float = 5.0
    pause_s: float = 1.0
    longest_pause_s: float = 60.0
    silence_s: float = 600.0
    charge_band: Band = MEASURING_BAND
    charge_hook: str | None = None


class Daemon:
    """One agent on one state folder. `run()` returns when it is told to stop or its limits are reached."""

    def __init__(
        self,
        state: StateDir,
        device_id: str,
        server: Server,
        renderer: Sequence[str],
        options: RunOptions,
        stop: threading.Event,
        log: Callable[[str], None],
        listener: Callable[[], ShownListener],
    ) -> None:
        self._state, self._device_id, self._server = state, device_id, server
        self._renderer, self._options, self._stop = renderer, options, stop
        self._log, self._listener = log, listener
        self._boot_id = boot_id()
        self.delivery = Delivery(Spool(state.spool), server, log)
        self._scenes = SceneCache(state.scenes, server)
        self._releases: list[tuple[str, str, bool]] = [
            (attempt_id, "the agent was killed while it had this job", False) for attempt_id in state.leased()
        ]
        self._leased = {attempt_id for attempt_id, _, _ in self._releases}
        self._charging = self._make_charging()
        self._job_share = 0.0  # of the battery, what the dearest job so far took
        self._jobs = 0
        self._last_job_s = time.monotonic()
        self._said = ""
        self._troubles = 0

    def run(self) -> None:
        """Works until stopped. Raises TokenRejectedError, a RendererError at the start, with `once` any failure."""
        self.delivery.spool.sweep()
        shutil.rmtree(self._state.scratch, ignore_errors=True)
        capabilities = describe_device(self._renderer, self._options.source, self._options.sysfs_root)
        announced = False
        self._last_job_s = time.monotonic()  # asking the renderer about itself was not idleness
        while not self._stop.is_set() and not self._over():
            try:
                if not announced:
                    self._server.put_capabilities(self._device_id, capabilities)
                    announced = True
                    self._log(f"Ready for jobs of {self._server.url}.")
                self._step()
            except ServerUnreachableError as error:
                if self._options.once:
                    self._end()
                    raise ServerUnreachableError(f"{error} {self._kept()}") from error
                self._say(f"{error} {self._kept()} Trying again until it answers.")
                self._pause()
            if self._options.once:
                break
        self._end()

    def _over(self) -> bool:
        options = self._options
        idle_s = time.monotonic() - self._last_job_s
        if options.idle_exit_s is not None and idle_s > options.idle_exit_s:
            return True
        return options.max_jobs is not None and self._jobs >= options.max_jobs and self._waiting() == 0

    def _step(self) -> None:
        """One round: deliver, see whether measuring is possible, lease, work."""
        self._settle()
        if self._options.max_jobs is not None and self._jobs >= self._options.max_jobs:
            return
        reason = self._why_not_now()
        if reason:
            self._say(f"Not fit to measure now: {reason}.")
            self._pause()
            return
        conditions = read_conditions(self._options.sysfs_root)
        leases, wait_s = self._server.lease(self._boot_id, conditions, self._longest_wait_s())
        self._said, self._troubles = "", 0
        if not leases:
            if self._options.once:
                self._log("The server has no job for this device.")
            else:
                self._stop.wait(min(wait_s, self._longest_wait_s()))
        self._remember({*self._leased, *(lease.attempt_id for lease in leases)})
        for lease in leases:
            self._work(lease)
            self._jobs += 1
            self._last_job_s = time.monotonic()
        if leases:
            self._settle()

    def _settle(self) -> None:
        """Gives back what cannot be done and sends what is finished."""
        for release in list(self._releases):
            try:
                self._server.release(*release)
            except ServerRefusedError as error:
                self._log(f"Attempt {release[0]} cannot be given back: {error}")
            self._releases.remove(release)
            self._remember(self._leased - {release[0]})
        self.delivery.send_all()

    def _why_not_now(self) -> str | None:
        if self.delivery.in_memory:
            return "a result waits in memory because the spool's disk is full"
        if not self.delivery.spool.room():
            return f"less than 64 MiB are free on the disk of {self._state.spool}"
        if self._charging is not None:
            try:
                reason = self._charging.step(time.monotonic(), self._log, self._job_share)
            except AgentError as error:  # the hook: a person may have to help
                reason = str(error).rstrip(".")
            if reason:
                return reason
        return unfit_reason(self._options.source, self._options.sysfs_root)

    def _make_charging(self) -> Charging | None:
        """Keeps a battery in its band where a battery is the source; None elsewhere."""
        options = self._options
        if options.source != "auto" and not options.source.startswith("battery"):
            return None
        charging = Charging(options.charge_band, options.sysfs_root, options.source, options.charge_hook)
        return charging if charging.share() is not None else None

    def _remember(self, attempts: set[str]) -> None:
        """Writes down which attempts are ours, for the agent that starts after a kill."""
        self._leased = attempts
        try:
            write_whole(self._state.leases, json.dumps(sorted(attempts)).encode())
        except OSError as error:
            self._say(f"{self._state.leases} cannot be written: {error.strerror}.")

    def _work(self, lease: Lease) -> None:
        """Measures one job and keeps its result; whatever stands in the way becomes a release."""
        if self._stop.is_set():
            self._releases.append((lease.attempt_id, "the agent was stopped", False))
            return
        before = self._charging.share() if self._charging else None
        self._log(f"Job {lease.job_id}: {lease.purpose} of {lease.scene.name} {_words(lease.settings)}")
        try:
            result = self._measure(lease)
        except StoppedError:
            self._give_back(lease, "the agent was stopped", failed=False)
        except SourceUnavailableError as error:
            self._give_back(lease, str(error), failed=False)
            self._pause()
        except (RendererError, BundleError, ServerRefusedError, UsageError) as error:
            self._give_back(lease, str(error), failed=True)
        except ServerUnreachableError:
            self._give_back(lease, "the scene could not be fetched: the server did not answer", failed=False)
            raise
        except OSError as error:
            self._give_back(lease, f"{error.filename or self._state.root}: {error.strerror}", failed=False)
            self._pause()
        else:
            if result is not None:
                document = result.document
                named = [sha for sha in (document.power_samples, document.image_blob) if sha]
                entry = Entry(attempt_id=lease.attempt_id, document=document.to_json(), blobs=tuple(named))
                self.delivery.keep(entry, {sha: result.blobs[sha] for sha in named})
                self._remember(self._leased - {lease.attempt_id})
        after = self._charging.share() if self._charging else None
        if before is not None and after is not None:
            self._job_share = max(self._job_share, before - after)

    def _measure(self, lease: Lease) -> Result | None:
        """The result, None when it is void (then the lease is given back)."""
        folder = self._scenes.fetch(lease.scene.name, lease.scene.bundle_sha256)
        rule = self._rule(lease)
        choice = choose(self._options.source, self._options.sysfs_root)
        self._state.scratch.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._state.scratch) as scratch, self._listener() as listener:
            settings = Path(scratch) / "settings.json"
            settings.write_text(json.dumps(lease.settings), encoding="utf-8")
            defines = [word for name, value in lease.defines.items() for word in ("-D", f"{name}={value}")]
            job = Job(
                self._renderer,
                [str(folder), "--settings", str(settings), *defines],
                Path(scratch) / "last.exr",
            )
            measurement = Measurement(job, rule, choice, listener, self._stop, self._options.sysfs_root)
            record = measurement.run()
            if record.void is not None:
                self._give_back(lease, f"the measurement is void: {record.void}", failed=not record.environment)
                if record.environment:
                    self._pause()
                return None
            result = build_result(record, rule, job.image_file)
        for note in result.notes:
            self._log(f"note: {note}")
        return result

    def _rule(self, lease: Lease) -> MeasureRule:
        return make_rule(**lease.measure.model_dump(), silence_s=self._options.silence_s)

    def _give_back(self, lease: Lease, reason: str, failed: bool) -> None:
        self._log(f"Job {lease.job_id} given back: {reason}")
        self._releases.append((lease.attempt_id, reason, failed))

    def _end(self) -> None:
        """A last try for what is still ours; the spool keeps the rest for the next run."""
        try:
            self._settle()
        except ServerUnreachableError:
            pass
        except TokenRejectedError as error:
            self._log(str(error))
        if self._waiting():
            self._log(self._kept())
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

    def _say(self, text: str) -> None:
        """Logs a state once, not on every round it lasts."""
        if text != self._said:
            self._said = text
            self._log(text)

    def _pause(self) -> None:
        """Waits after trouble: longer each time, jittered so that a fleet does not come back as one."""
        longest_s = min(self._options.longest_pause_s, self._options.pause_s * 2**self._troubles)
        self._troubles = min(self._troubles + 1, 16)
        self._stop.wait(longest_s * random.uniform(0.5, 1.0))


def _words(settings: dict[str, object]) -> str:
    """Settings in one short line."""
    text = " ".join(f"{key}={value}" for key, value in settings.items())
    return text if len(text) <= 100 else text[:97] + "..."
