"""One process of the renderer for one job after the other, and what ends it."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from agent_testing import FAKE_COMMAND
from joulebox_agent.clock import SystemClock
from joulebox_agent.errors import RendererError, RendererRefusedError
from joulebox_agent.kept import KeptRenderer
from joulebox_agent.loop import DoneEvent, ImageEvent

CLOCK = SystemClock()


@pytest.fixture
def kept() -> KeptRenderer:
    """Closed after the test."""
    keeper = KeptRenderer()
    yield keeper
    keeper.close()


def words(**settings: object) -> list[str]:
    return ["cornell", *(word for name, value in settings.items() for word in ("--set", f"{name}={value}"))]


def job(kept: KeptRenderer, *more: str, until: type = DoneEvent, command: list[str] = FAKE_COMMAND, **settings: object):
    """(process id, events) of one job, left when an event of that kind came."""
    events, deadline_s = [], time.monotonic() + 30
    with kept(command, [*words(**settings), *more], CLOCK, lambda line: None) as loop:
        while not (events and isinstance(events[-1], until)):
            assert time.monotonic() < deadline_s
            event = loop.next_event(1.0)
            events += [] if event is None else [event]
        pid = loop._process.pid
    return pid, events


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


ONCE = ("--max-images", "1")


def test_one_process_does_job_after_job(kept: KeptRenderer, tmp_path: Path) -> None:
    found = [job(kept, *ONCE, "-o", str(tmp_path / f"{seed}.exr"), seed=seed) for seed in (1, 2, 1)]
    assert len({pid for pid, _ in found}) == 1
    pixels = [event.pixel_sha256 for _, events in found for event in events if isinstance(event, ImageEvent)]
    assert len(pixels) == 3
    assert pixels[0] == pixels[2] != pixels[1]
    assert (tmp_path / "2.exr").read_bytes().endswith(b"seed 2")
    kept.close()
    assert gone(found[0][0])


def test_a_stopped_job_ends_the_process(kept: KeptRenderer) -> None:
    first, events = job(kept, until=ImageEvent)
    assert gone(first)
    assert not isinstance(events[-1], DoneEvent)
    assert job(kept, *ONCE)[0] != first


@pytest.mark.parametrize(
    ("settings", "kind", "sentence"),
    [
        ({"image_ss": 1}, RendererRefusedError, "There is no setting 'image_ss'"),
        ({"misbehave": "die", "misbehave_at": 0}, RendererError, "died with code 1: Segmentation fault"),
        ({"misbehave": "garbage", "misbehave_at": 0}, RendererError, "is not JSON"),
        ({"misbehave": "stop", "misbehave_at": 0}, RendererError, "ended by itself"),
    ],
)
def test_a_job_that_fails_is_told_and_the_next_has_a_new_process(
    kept: KeptRenderer, settings: dict[str, object], kind: type[RendererError], sentence: str
) -> None:
    first, _ = job(kept, *ONCE)
    with pytest.raises(kind, match=sentence):
        job(kept, *ONCE, **settings)
    assert gone(first)
    second, events = job(kept, *ONCE)
    assert second != first
    assert isinstance(events[-1], DoneEvent)


def test_a_process_that_was_killed_while_it_waited_is_replaced(kept: KeptRenderer) -> None:
    first, _ = job(kept, *ONCE)
    os.kill(first, signal.SIGKILL)
    kept.idle._process.wait(10)
    second, events = job(kept, *ONCE)
    assert second != first
    assert isinstance(events[-1], DoneEvent)


def test_a_hung_job_does_not_outlive_its_block(kept: KeptRenderer) -> None:
    with kept(FAKE_COMMAND, words(misbehave="hang_at_once"), CLOCK, lambda line: None) as loop:
        assert loop.next_event(10.0) is None
        assert loop.next_event(0.3) is None
        pid = loop._process.pid
    assert gone(pid)


def test_a_program_that_knows_no_jobs_is_started_for_each(kept: KeptRenderer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_ALONE", "1")
    command = [word for word in FAKE_COMMAND if word != "-E"]
    pids = [job(kept, *ONCE, command=command)[0] for _ in range(2)]
    assert len(set(pids)) == 2
    assert all(gone(pid) for pid in pids)


def test_another_first_line_than_waiting_is_a_sentence(kept: KeptRenderer, tmp_path: Path) -> None:
    script = tmp_path / "chatty.sh"
    script.write_text("#!/bin/sh\necho rendering is going well\nsleep 60\n")
    script.chmod(0o755)
    with pytest.raises(RendererError, match="first line is not that it waits for a job: 'rendering is going well'"):
        job(kept, command=[str(script)])


def test_words_of_one_job_are_not_said_of_another(kept: KeptRenderer) -> None:
    heard: dict[int, list[str]] = {1: [], 2: []}
    for number, said in heard.items():
        listen: Callable[[str], None] = said.append
        with kept(FAKE_COMMAND, [*words(seed=number), *ONCE], CLOCK, listen) as loop:
            while not isinstance(loop.next_event(5.0), DoneEvent):
                pass
            deadline_s = time.monotonic() + 10
            while not said and time.monotonic() < deadline_s:
                time.sleep(0.01)
    assert heard == {1: ["compiling kernels"], 2: ["compiling kernels"]}
