"""One leased job: its scene fetched, measured, its result kept; whatever stands in the way gives it back."""

import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from joulebox_agent.errors import (
    BundleError,
    RendererError,
    ServerRefusedError,
    ServerUnreachableError,
    SourceUnavailableError,
    UsageError,
)
from joulebox_agent.fleet.attempts import Attempts
from joulebox_agent.fleet.bundle import SceneCache
from joulebox_agent.fleet.delivery import Delivery
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.options import RunOptions
from joulebox_agent.fleet.server import Lease
from joulebox_agent.fleet.spool import Entry
from joulebox_agent.fleet.state import StateDir
from joulebox_agent.fleet.stopping import Stop
from joulebox_agent.kept import KeptRenderer
from joulebox_agent.measuring.calibrating import calibration_for, companion_of
from joulebox_agent.measuring.charging import Charging
from joulebox_agent.measuring.ledger import StageLedger
from joulebox_agent.measuring.measure import Measurement
from joulebox_agent.measuring.meter import Listener, StoppedError
from joulebox_agent.measuring.result import Result, build_result
from joulebox_agent.measuring.rule import make_rule
from joulebox_agent.measuring.visit import Job
from joulebox_agent.sources.choose import choose


class ShownListener(Listener, AbstractContextManager["ShownListener"], Protocol):
    """A listener that is shown while a block runs."""


class Worker:
    """Does jobs with one renderer and one source; says nothing to the server inside a measurement."""

    def __init__(
        self,
        state: StateDir,
        renderer: Sequence[str],
        options: RunOptions,
        scenes: SceneCache,
        attempts: Attempts,
        delivery: Delivery,
        stop: Stop,
        journal: Journal,
        listener: Callable[[], ShownListener],
        charging: Charging | None = None,
    ) -> None:
        self._charging = charging
        self._state, self._renderer, self._options, self._scenes = state, renderer, options, scenes
        self._attempts, self._delivery, self._stop = attempts, delivery, stop
        self._journal, self._listener = journal, listener
        self._ledger = StageLedger()
        self._kept = KeptRenderer()

    def do(self, lease: Lease) -> bool:
        """Measures one job and keeps its result, or gives it back; False when a pause should follow.

        Raises ServerUnreachableError when the scene could not be fetched, TokenRejectedError.
        """
        if self._stop.asked.is_set():
            self._attempts.give_back(lease, "the agent was stopped", failed=False)
            return True
        words = f"Job {lease.job_id}: {lease.purpose} of {lease.scene.name} {_words(lease.settings)}"
        self._journal.lasts(
            "job", words, job_id=lease.job_id, attempt_id=lease.attempt_id, sweep_id=lease.sweep_id
        )  # fmt: skip
        try:
            return self._measure(lease)
        except StoppedError:
            self._attempts.give_back(lease, "the agent was stopped", failed=False)
        except SourceUnavailableError as error:
            self._attempts.give_back(lease, str(error), failed=False)
            return False
        except (RendererError, BundleError, ServerRefusedError, UsageError) as error:
            self._attempts.give_back(lease, str(error), failed=True)
        except ServerUnreachableError:
            self._attempts.give_back(lease, "the scene could not be fetched: the server did not answer", failed=False)
            raise
        except OSError as error:
            self._attempts.give_back(lease, f"{error.filename or self._state.root}: {error.strerror}", failed=False)
            return False
        return True

    def rest(self) -> None:
        """Ends the renderer that waits for a job, since none is in sight."""
        self._kept.close()

    def clean(self) -> None:
        """Removes what a killed agent left of its work."""
        shutil.rmtree(self._state.scratch, ignore_errors=True)

    def _measure(self, lease: Lease) -> bool:
        folder = self._scenes.fetch(lease.scene.name, lease.scene.bundle_sha256)
        rule = make_rule(**lease.measure.model_dump(), silence_s=self._options.silence_s)
        choice = choose(self._options.source, self._options.sysfs_root)
        self._state.scratch.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._state.scratch) as scratch, self._listener() as listener:
            job = self._job(lease, folder, Path(scratch))
            root = self._options.sysfs_root
            measurement = Measurement(
                job, rule, choice, listener, self._stop.at_once, root, charging=self._charging,
                make_loop=self._kept, leave=self._stop.asked, companion=companion_of(choice, root),
            )  # fmt: skip
            record = measurement.run()
            self._ledger.add(record)
            if record.void is not None:
                reason = f"the measurement is void: {record.void}"
                self._attempts.give_back(lease, reason, failed=not record.environment)
                return not record.environment
            calibration, said = calibration_for([record], self._state.root)
            result = build_result(record, rule, job.image_file, self._ledger.powers(record)[0], calibration)
        for words in said:
            self._journal.say("note", f"note: {words}", attempt_id=lease.attempt_id)
        self._keep(lease, result)
        return True

    def _job(self, lease: Lease, scene: Path, scratch: Path) -> Job:
        settings = scratch / "settings.json"
        settings.write_text(json.dumps(lease.settings), encoding="utf-8")
        defines = [word for name, value in lease.defines.items() for word in ("-D", f"{name}={value}")]
        return Job(self._renderer, [str(scene), "--settings", str(settings), *defines], scratch / "last.exr")

    def _keep(self, lease: Lease, result: Result) -> None:
        for note in result.notes:
            self._journal.say("note", f"note: {note}", attempt_id=lease.attempt_id)
        document = result.document
        named = [sha256 for sha256 in (document.power_samples, document.image_blob) if sha256]
        entry = Entry(attempt_id=lease.attempt_id, document=document.to_json(), blobs=tuple(named))
        self._delivery.keep(entry, {sha256: result.blobs[sha256] for sha256 in named})
        self._attempts.finish(lease)


def _words(settings: dict[str, object]) -> str:
    """Settings in one short line."""
    text = " ".join(f"{key}={value}" for key, value in settings.items())
    return text if len(text) <= 100 else text[:97] + "..."
