"""The life of a job and of the attempts at it: every state, every event, and what the one makes of the other.

A job waits (`queued`), is handed to a device (`leased`), and ends `done`, `failed` or `cancelled`. An attempt is
one lease of it: it is `leased` until it is `released` by its device, `expired` by the clock, or `finished` by
its result. Only the newest attempt of a job can be `leased`, and then the job is `leased` too.

This table is all the store knows about it (`jobs.happen` carries a step out); the fault tests and the table in
docs/fleet.md are made from it as well.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from typing import Final, Literal

JobState = Literal["queued", "leased", "done", "failed", "cancelled"]
AttemptState = Literal["leased", "released", "expired", "finished"]

JOB_STATES: Final[tuple[JobState, ...]] = ("queued", "leased", "done", "failed", "cancelled")
OPEN: Final[tuple[JobState, ...]] = ("queued", "leased")
"""States of a job that its sweep waits for."""


class Event(StrEnum):
    """What can happen to a job."""

    LEASE = "lease"
    """A device asked for work and gets this job."""
    RELEASE = "release"
    """The device gives it back unmeasured: warm, on mains power, stopped."""
    FAILURE = "failure"
    """The device gives it back because it cannot be measured: the renderer refused."""
    EXPIRY = "expiry"
    """The lease ended without a word."""
    RESTART = "restart"
    """The device asks for work under another boot id, or does not know of this attempt: it is lost."""
    REVOCATION = "revocation"
    """An operator shut the device out."""
    RESULT = "result"
    """A measurement arrived."""
    VOID = "void"
    """A measurement arrived that says itself that it is worthless."""
    CANCEL = "cancel"
    """An operator cancelled the sweep."""
    RETRY = "retry"
    """An operator wants a failed job tried again."""


@dataclass(frozen=True)
class Step:
    """What an event changes.

    attempt  the attempt's next state; None: as it is
    job      the job's next state; None: as it is; "back": whatever `returned` says
    spends   whether it takes one of the job's attempts
    blames   whether it counts against the device's health
    refused  the event contradicts the state: nothing changes and whoever sent it is told (409)
    """

    attempt: AttemptState | None = None
    job: JobState | Literal["back"] | None = None
    spends: bool = False
    blames: bool = False
    refused: bool = False


NOTHING: Final = Step()
REFUSED: Final = Step(refused=True)

_EARLIER: Final[tuple[AttemptState, ...]] = ("released", "expired")
"""States of an attempt that lost its job; its result may still come."""


def step(event: Event, job: JobState, attempt: AttemptState | None) -> Step:
    """The row of the table for an event; `attempt` is the state of the attempt it is about, None for none.

    Raises KeyError for a combination that cannot be (an attempt is leased while its job is not).
    """
    return LIFE[event, job, attempt]


def returned(*, cancelled: bool, answered: bool, spent: bool) -> JobState:
    """Where a job goes that comes back without the result of this attempt.

    cancelled  its sweep was cancelled meanwhile
    answered   an earlier attempt brought a result, late
    spent      no attempt is left
    """
    if answered:
        return "done"
    if cancelled:
        return "cancelled"
    return "failed" if spent else "queued"


def _rows() -> Iterator[tuple[tuple[Event, JobState, AttemptState | None], Step]]:
    for job in JOB_STATES:
        yield (Event.LEASE, job, None), Step("leased", "leased") if job == "queued" else REFUSED
        yield (Event.CANCEL, job, None), Step(job="cancelled") if job == "queued" else NOTHING
        yield (Event.RETRY, job, None), Step(job="queued") if job == "failed" else REFUSED
    ends: dict[Event, Step] = {
        Event.RELEASE: Step("released", "back"),
        Event.FAILURE: Step("released", "back", spends=True, blames=True),
        Event.EXPIRY: Step("expired", "back", spends=True, blames=True),
        Event.RESTART: Step("expired", "back", spends=True, blames=True),
        Event.REVOCATION: Step("expired", "back"),
        Event.RESULT: Step("finished", "done"),
        Event.VOID: Step("finished", "back", spends=True, blames=True),
    }
    for event, ended in ends.items():
        yield (event, "leased", "leased"), ended
    for event, job in product(ends, JOB_STATES):
        brings = event in (Event.RESULT, Event.VOID)
        for attempt in _EARLIER:  # its job went its own way; only a result still means something
            answers = event is Event.RESULT and job in ("queued", "failed")
            late = Step("finished", "done" if answers else None)
            yield (event, job, attempt), late if brings else NOTHING
        yield (event, job, "finished"), REFUSED if brings or event in (Event.RELEASE, Event.FAILURE) else NOTHING


LIFE: Final[dict[tuple[Event, JobState, AttemptState | None], Step]] = dict(_rows())
"""(event, state of the job, state of the attempt) -> what changes. Every combination that can be is in it."""
