"""The table of a job's life, and the store held to it: every event in every state, asked of a real store."""

from pathlib import Path
from typing import Any

import pytest
from fake_device import measure_document
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test
from joulebox_server.errors import ConflictError
from joulebox_server.schemas.device import ReleaseRequest
from joulebox_server.schemas.measure import MeasureDocument
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.store import Store, blobs, devices, jobs, leases, life, planning, results, scenes, sweeps
from joulebox_server.store.database import number, rows
from joulebox_server.store.jobs import LeaseRules
from joulebox_server.store.life import Event

MINUTE_US = 60 * 1_000_000
BEGIN_US = 1_700_000_000_000_000
RULES = LeaseRules(
    slack_s=60, release_pause_s=5, retry_pause_s=10, longest_retry_pause_s=30, max_attempts=3, suspect_after=100
)
LEASE_US = 72 * 1_000_000
"""Of the jobs below: 10 s at most, a window of 2 s, and the slack."""


def test_every_state_and_event_is_in_the_table() -> None:
    """Of the combinations that can be, none is forgotten; of those that cannot be, none is there."""
    about_an_attempt = set(Event) - {Event.LEASE, Event.CANCEL, Event.RETRY}
    possible = {(event, job, None) for event in (Event.LEASE, Event.CANCEL, Event.RETRY) for job in life.JOB_STATES}
    for event in about_an_attempt:
        possible |= {
            (event, job, attempt) for job in life.JOB_STATES for attempt in ("released", "expired", "finished")
        }
        possible.add((event, "leased", "leased"))
    assert life.LIFE.keys() == possible


def test_what_the_rows_must_keep() -> None:
    """What holds for every row, whatever it says."""
    for (event, job, attempt), step in life.LIFE.items():
        if step.refused:
            assert step == life.REFUSED
        if event in (Event.RESULT, Event.VOID) and attempt != "finished":
            assert step.attempt == "finished"  # measured energy is never thrown away
        if job in ("done", "cancelled"):
            assert step.job is None  # what has ended stays so
        if step.job == "leased":
            assert event is Event.LEASE
        if attempt == "leased":
            assert step.attempt != "leased" and step.job is not None  # whoever loses a lease moves its job
        if attempt in ("released", "expired", "finished"):
            assert not step.spends and not step.blames  # a lost attempt was counted when it was lost
        if event in (Event.RELEASE, Event.REVOCATION):
            assert not step.spends and not step.blames


def test_the_table_in_the_docs(root: Path) -> None:
    """docs/fleet.md shows the table as it is."""
    text = (root / "docs" / "fleet.md").read_text(encoding="utf-8")
    assert table() in text


def table() -> str:
    """The table in Markdown: a row for each event, states of job and attempt that share what follows together."""
    lines = ["| event | job | attempt | the attempt becomes | the job becomes |", "|---|---|---|---|---|"]
    by_attempt: dict[tuple[Event, life.Step, str], list[str]] = {}
    for (event, job, attempt), step in life.LIFE.items():
        by_attempt.setdefault((event, step, attempt or "none"), []).append(job)
    grouped: dict[tuple[Event, life.Step, str], list[str]] = {}
    for (event, step, attempt), in_jobs in by_attempt.items():
        grouped.setdefault((event, step, ", ".join(in_jobs)), []).append(attempt)
    for (event, step, job), attempts in sorted(grouped.items(), key=lambda entry: list(Event).index(entry[0][0])):
        attempt = ", ".join(attempts)
        if step.refused:
            becomes = ["refused (409)", "as it is"]
        else:
            back = "back" + (", an attempt spent" if step.spends else "")
            becomes = [step.attempt or "as it is", {"back": back, None: "as it is"}.get(step.job, str(step.job))]
        lines.append(f"| {event} | {job} | {attempt} | {' | '.join(becomes)} |")
    return "\n".join(lines)


class Lives(RuleBasedStateMachine):
    """Two devices, two jobs, any order of events; beside the store a model that knows only the table."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.store = Store(folder)
        self.now_us = BEGIN_US
        self.jobs: dict[str, dict[str, Any]] = {}
        self.attempts: dict[str, dict[str, Any]] = {}
        self.results: set[str] = set()
        self.cancelled = False
        with blobs.Incoming(self.store.incoming_dir, 1000) as incoming:
            incoming.write(b"bundle")
            self.store.write(blobs.adopt, self.store.blob_dir, incoming, incoming.finish())
            self.store.write(scenes.put, "box", incoming.finish())
        self.device, _ = self.store.write(devices.enroll, "device", "boot-0")
        self.boot = 0
        measure = {"window_s": 2, "min_windows": 1, "max_windows": 1, "max_seconds": 10}
        definition = SweepDefinition.model_validate({"name": "s", "scenes": ["box"], "repeats": 1, "measure": measure})
        self.sweep, _ = self.store.write(planning.create_once, definition, None)
        for job in self.store.read(rows, "SELECT id FROM job"):
            self.jobs[job["id"]] = {"state": "queued", "attempts": 0, "not_before": 0}

    def teardown(self) -> None:
        self.store.close()

    def held(self) -> list[str]:
        return [key for key, attempt in self.attempts.items() if attempt["state"] == "leased"]

    def model(self, event: Event, key: str) -> life.Step:
        """Carry a row of the table out on the model."""
        attempt = self.attempts[key]
        job = self.jobs[attempt["job"]]
        step = life.step(event, job["state"], attempt["state"])
        attempt["state"] = step.attempt or attempt["state"]
        if step.job == "back":
            job["attempts"] += step.spends
            answered = any(a["job"] == attempt["job"] and a.get("good") for a in self.attempts.values())
            spent = job["attempts"] >= RULES.max_attempts
            job["state"] = life.returned(cancelled=self.cancelled, answered=answered, spent=spent)
            pause_s = min(30, 10 * 2 ** (job["attempts"] - 1)) if step.spends else 5
            job["not_before"] = self.now_us + pause_s * 1_000_000
        elif step.job is not None:
            job["state"], job["not_before"] = step.job, 0
        if event is Event.RESULT and step.attempt == "finished":
            attempt["good"] = True
        return step

    @rule(count=st.integers(1, 3), reboot=st.integers(0, 9))
    def lease(self, count: int, reboot: int) -> None:
        self.boot += reboot == 9
        for key in self.held():
            if self.attempts[key]["expires"] <= self.now_us:
                self.model(Event.EXPIRY, key)
            elif self.attempts[key]["boot"] != self.boot:
                self.model(Event.RESTART, key)
        got = self.store.write(leases.lease, self.device, f"boot-{self.boot}", {}, count, RULES, self.now_us)
        running = self.store.read(number, "SELECT count(*) FROM sweep WHERE state = 'running'")
        ready = [k for k, j in self.jobs.items() if j["state"] == "queued" and j["not_before"] <= self.now_us]
        assert len(got) == (min(count, len(ready)) if running else 0)
        for granted in got:
            assert granted.job_id in ready
            step = life.step(Event.LEASE, self.jobs[granted.job_id]["state"], None)  # type: ignore[arg-type]
            self.jobs[granted.job_id]["state"] = step.job
            expires = self.now_us + LEASE_US
            self.attempts[granted.attempt_id] = {
                "job": granted.job_id, "state": step.attempt, "boot": self.boot, "expires": expires, "lease": granted,
            }  # fmt: skip

    @rule(seconds=st.sampled_from([1, 6, 31, 80]))
    def time_passes(self, seconds: int) -> None:
        self.now_us += seconds * 1_000_000

    @rule()
    def reap(self) -> None:
        for key in self.held():
            if self.attempts[key]["expires"] <= self.now_us:
                self.model(Event.EXPIRY, key)
        self.store.write(leases.reap, RULES, self.now_us)

    @precondition(lambda self: self.attempts)
    @rule(which=st.integers(0, 99), failed=st.booleans())
    def release(self, which: int, failed: bool) -> None:
        key = list(self.attempts)[which % len(self.attempts)]
        step = self.model(Event.FAILURE if failed else Event.RELEASE, key)
        request = ReleaseRequest(reason="warm", failed=failed)
        if step.refused:
            with pytest.raises(ConflictError):
                self.store.write(leases.release, key, self.device, request, RULES, self.now_us)
        else:
            self.store.write(leases.release, key, self.device, request, RULES, self.now_us)

    @precondition(lambda self: self.attempts)
    @rule(which=st.integers(0, 99), void=st.booleans(), twice=st.booleans())
    def result(self, which: int, void: bool, twice: bool) -> None:
        key = list(self.attempts)[which % len(self.attempts)]
        changes = {"void": "mains"} if void else {}
        body = measure_document(self.attempts[key]["lease"].model_dump(), b"", image_blob=None, **changes)
        document = MeasureDocument.model_validate(body)
        before = self.attempts[key]["state"]
        in_time = before == "leased" and self.attempts[key]["expires"] > self.now_us

        def send(changed: MeasureDocument = document) -> tuple[str, bool]:
            return self.store.write(results.accept, self.store.blob_dir, key, self.device, changed, RULES, self.now_us)

        if before == "finished":
            same = self.attempts[key]["body"] == document
            if same:
                assert send()[1] is False
            else:
                with pytest.raises(ConflictError):
                    send()
            return
        self.model(Event.VOID if void else Event.RESULT, key)
        self.attempts[key]["body"] = document
        assert send() == ("ok" if in_time else "late", True)
        self.results.add(key)
        if twice:
            assert send()[1] is False

    @rule(one=st.booleans())
    def retry(self, one: bool) -> None:
        failed = [key for key, job in self.jobs.items() if job["state"] == "failed"]
        if self.cancelled or not failed:
            return
        for key in failed[:1] if one else failed:
            self.jobs[key] = {"state": "queued", "attempts": 0, "not_before": 0}
        if one:
            self.store.write(jobs.retry, failed[0])
        else:
            assert self.store.write(sweeps.retry_failed, self.sweep)[1] == len(failed)

    @precondition(lambda self: len(self.attempts) > 2)
    @rule(action=st.sampled_from(["pause", "resume", "resume", "cancel"]))
    def act(self, action: str) -> None:
        state = self.store.read(rows, "SELECT state FROM sweep")[0]["state"]
        if state in sweeps.ENDED:
            with pytest.raises(ConflictError):
                self.store.write(sweeps.act, self.sweep, action)
            return
        self.store.write(sweeps.act, self.sweep, action)
        if action == "cancel":
            self.cancelled = True
            for job in self.jobs.values():
                job["state"] = life.step(Event.CANCEL, job["state"], None).job or job["state"]

    @invariant()
    def as_the_table_says(self) -> None:
        stored = {job["id"]: job for job in self.store.read(rows, "SELECT * FROM job")}
        assert {key: job["state"] for key, job in stored.items()} == {k: j["state"] for k, j in self.jobs.items()}
        assert {key: job["attempts"] for key, job in stored.items()} == {k: j["attempts"] for k, j in self.jobs.items()}
        waiting = {key: job["not_before_us"] for key, job in stored.items() if job["state"] == "queued"}
        assert waiting == {k: j["not_before"] for k, j in self.jobs.items() if j["state"] == "queued"}
        found = {attempt["id"]: attempt["state"] for attempt in self.store.read(rows, "SELECT * FROM attempt")}
        assert found == {key: attempt["state"] for key, attempt in self.attempts.items()}

    @invariant()
    def nothing_is_lost_or_doubled(self) -> None:
        kept = [result["attempt_id"] for result in self.store.read(rows, "SELECT attempt_id FROM result")]
        assert sorted(kept) == sorted(self.results)
        held = [self.attempts[key]["job"] for key in self.held()]
        assert len(held) == len(set(held))  # no job is leased twice
        assert set(held) == {key for key, job in self.jobs.items() if job["state"] == "leased"}


def lives(tmp_path: Path, examples: int, steps: int) -> None:
    """Run the machine `examples` times, each on a folder of its own."""
    made = iter(range(10**9))
    rules = settings(
        max_examples=examples, stateful_step_count=steps, deadline=None, suppress_health_check=list(HealthCheck)
    )
    run_state_machine_as_test(lambda: Lives(tmp_path / str(next(made))), settings=rules)


def test_the_store_lives_by_the_table(tmp_path: Path) -> None:
    lives(tmp_path, examples=20, steps=30)


@pytest.mark.long
def test_the_store_lives_by_the_table_for_long(tmp_path: Path) -> None:
    lives(tmp_path, examples=200, steps=60)
