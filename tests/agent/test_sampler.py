"""Sampling in a process of its own: what passes the pipes, what survives a death, what it costs."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from joulebox_agent.errors import SourceUnavailableError
from joulebox_agent.sampling.sampler import Sample, Sampler
from joulebox_agent.sampling.sampler_child import decode, encode
from joulebox_agent.sampling.sampler_process import SamplerProcess, sampler_cost
from joulebox_agent.sampling.watch import FaultWatch, Patience
from joulebox_agent.sources.choose import Choice, choose
from joulebox_agent.sources.reading import Reading

Tree = Callable[[str], Path]


@pytest.fixture
def sampler(tree: Tree) -> Iterator[SamplerProcess]:
    root = tree("thinkpad_power_now")
    sampler = SamplerProcess(choose("auto", root), root, companion="replay@0.5")
    sampler.start()
    yield sampler
    sampler.stop()
    assert sampler.pid is not None
    assert not psutil.pid_exists(sampler.pid)


def until(true: Callable[[], object], seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_samples_come_from_another_process_of_low_priority(sampler: SamplerProcess) -> None:
    before_s = time.perf_counter_ns() / 1e9
    sampler.sample()
    last = sampler.samples()[-1]
    assert before_s <= last.time_s <= time.perf_counter_ns() / 1e9  # one axis of time on both sides
    assert last.reading.power_w == pytest.approx(5.064)
    assert last.reading.raw
    assert sampler.pid not in (None, os.getpid())
    assert psutil.Process(sampler.pid).nice() > psutil.Process().nice()
    assert sampler.companion_samples()[-1].reading.power_w is not None
    assert 0 < sampler.cpu_share() < 0.05


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has classes of priority, not degrees")
def test_a_low_priority_is_not_raised() -> None:
    """Whoever runs the agent at a low priority of its own: the sampler stays below it."""
    program = (
        "import os; from joulebox_agent.sampling.sampler_child import lower_priority; "
        "os.nice(15); lower_priority(); print(os.nice(0))"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, check=True).stdout.strip() == b"19"


def test_a_sampler_that_dies_is_started_again_once(sampler: SamplerProcess) -> None:
    first, alive_s = sampler.pid, sampler.samples()[-1].time_s
    assert first is not None
    os.kill(first, signal.SIGKILL)
    until(lambda: sampler.pid != first and sampler.samples()[-1].time_s > alive_s + 0.01)
    until(lambda: sampler.void_reason(alive_s, alive_s + 60))
    assert "the sampler died" in str(sampler.void_reason(alive_s, alive_s + 60))
    assert sampler.trouble() is None
    epochs = [sample.reading.epoch for sample in sampler.samples()]
    assert epochs == sorted(epochs)
    assert epochs[-1] > epochs[0]  # its counter began anew: no difference across the death
    assert sampler.pid is not None
    os.kill(sampler.pid, signal.SIGKILL)
    until(lambda: sampler.trouble())
    assert "the sampler died again" in str(sampler.trouble())
    sampler.sample()  # asks nobody and hangs nowhere


def test_the_sampler_never_outlives_whoever_started_it(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    program = (
        "import sys, time; from pathlib import Path\n"
        "from joulebox_agent.sampling.sampler_process import SamplerProcess\n"
        "from joulebox_agent.sources.choose import choose\n"
        "root = Path(sys.argv[1]); s = SamplerProcess(choose('auto', root), root); s.start()\n"
        "print(s.pid, flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", program, str(root)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert psutil.pid_exists(child)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    until(lambda: not psutil.pid_exists(child) or psutil.Process(child).status() == psutil.STATUS_ZOMBIE, 10.0)


def test_a_source_that_the_child_cannot_read_is_one_sentence(tree: Tree, tmp_path: Path) -> None:
    choice = choose("auto", tree("thinkpad_power_now"))
    with pytest.raises(SourceUnavailableError, match=r"The sampler cannot read battery_gauge: .*no system battery"):
        SamplerProcess(choice, tmp_path).start()
    other = Choice(choice.source, choice.report, name="replay")
    with pytest.raises(SourceUnavailableError, match="it found replay where battery_gauge was"):
        SamplerProcess(other, tmp_path).start()


def test_sampling_costs_little(tree: Tree) -> None:
    """CPU time, not wall time: it does not depend on who else runs. The bound is ten times the goal of 0.5 %, which
    a run that exceeds it notes in its document."""
    assert 0 < sampler_cost("auto", tree("thinkpad_power_now"), 1.5) < 0.05


def test_a_sample_passes_the_pipe_unchanged() -> None:
    sample = Sample(12.345678901234, Reading(5.064, 0.1 + 0.2, 3, (5064000, 1.5), None, "mains (AC)"), 0.25)
    assert decode(encode(1, sample, 0.125)) == (1, sample, 0.125)
    with pytest.raises(ValueError, match="Expecting"):
        decode("[0, 1.2, ")


GOOD = Reading(power_w=5.0, counter_j=0.0, raw=(1, 2, 3))


def watched(*samples: tuple[float, float, Reading]) -> FaultWatch:
    watch = FaultWatch(0.0, 0.5, "power", Patience(lost_s=20.0, refused_s=3.0))
    for sample in samples:
        watch.add(*sample)
    return watch


def test_what_voids_a_stretch_and_what_ends_it_all() -> None:
    def steady(*times_s: float) -> list[tuple[float, float, Reading]]:
        return [(time_s, 0.0, GOOD) for time_s in times_s]

    slept = watched((0.0, 0.0, GOOD), (1.0, 30.0, GOOD), (2.0, 30.0, GOOD))
    assert slept.over(0.5, 3.0) == "the machine slept for 30.0 s, noticed at 1.0 s"
    assert slept.over(1.0, 3.0) is None
    still = watched(*steady(0.0, 0.5, 20.0, 20.5))
    assert "stood still" in str(still.over(10.0, 11.0))
    assert still.over(20.0, 30.0) is None
    back = watched(*steady(0.0, 5.0, 4.0, 4.5))
    assert "the clock went back by 1.0 s" in str(back.over(0.0, 10.0))
    flap = watched(*steady(0.0, 1.0), (1.5, 0.0, Reading(refusal="mains")), *steady(2.0, 3.0))
    assert flap.over(0.0, 9.0) == "mains at 1.5 s"
    assert flap.over(2.0, 9.0) is None
    assert flap.end() is None
    mains = watched(*steady(0.0, 1.0), *[(1.5 + i, 0.0, Reading(refusal="mains")) for i in range(5)])
    assert mains.end() == "mains at 4.5 s"
    assert mains.over(50.0, 60.0) is not None  # it lasts still
    once = watched(*steady(0.0, 1.0), (1.5, 0.0, Reading(problem="EIO")), *steady(2.0, 3.0))
    assert once.over(0.0, 9.0) is None
    bad = [(1.5 + i, 0.0, Reading(problem="EIO")) for i in range(25)]
    long = watched(*steady(0.0, 1.0), *bad[:14], *steady(17.0))
    assert "EIO" in str(long.over(5.0, 6.0))
    assert long.end() is None
    assert "the sensor was lost" in str(watched(*steady(0.0, 1.0), *bad).end())
    pulled = watched(*steady(0.0, 1.0), (1.5, 0.0, Reading(power_w=3.0, epoch=1, raw=(1,))))
    assert "the set of batteries changed" in str(pulled.over(0.0, 9.0))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no timer that interrupts")
def test_an_interrupt_while_the_sampler_starts_leaves_nothing_to_wait_for(tree: Tree) -> None:
    """The limit of its start is a timer of its own, and no program ends before its timers."""
    root = tree("thinkpad_power_now")
    sampler = SamplerProcess(choose("auto", root), root)
    sampler._command = [sys.executable, "-S", "-E", "-c", "import sys; sys.stdin.read()"]

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    try:
        with pytest.raises(KeyboardInterrupt):
            sampler.start()
    finally:
        signal.signal(signal.SIGALRM, before)
        sampler.stop()
    until(lambda: not any(isinstance(thread, threading.Timer) for thread in threading.enumerate()), 5.0)


def test_a_pause_is_one_while_nothing_is_sampled(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    """A charge is waited for with the sampler stopped; a pause that returned at once would keep a core busy."""
    root, waited_s = tree("thinkpad_power_now"), list[float]()
    choice = choose("auto", root)
    for sampler in (Sampler(choice.source), SamplerProcess(choice, root)):
        sampler.start()
        sampler.stop()
        with monkeypatch.context() as patched:
            patched.setattr(time, "sleep", waited_s.append)
            sampler.pause(7200.0)
    assert waited_s == [7200.0, 7200.0]
