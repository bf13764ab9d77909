"""The process that reads the energy source: low priority, no network, no disk, samples down a pipe.

    python -m joulebox_agent.sampling.sampler_child SOURCE SYSFS_ROOT [COMPANION]

It writes one line of JSON when it is ready (or why it is not), then one array a sample, as `encode` makes
it. A line on its standard input asks for a sample now; the end of that input ends it, so that it never
outlives whoever started it.
"""

import contextlib
import json
import sys
import threading
import time
from pathlib import Path
from typing import TextIO

import psutil

from joulebox_agent.clock import SystemClock
from joulebox_agent.errors import AgentError
from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sources.choose import choose
from joulebox_agent.sources.reading import Reading

NICENESS = 10  # below whoever started it: low, yet woken in time on a machine whose every core renders


def encode(index: int, sample: Sample, cpu_s: float) -> str:
    """One sample of source `index` as a line: 0 the source itself, 1 its companion; cpu_s of this process."""
    reading = sample.reading
    return json.dumps(
        [index, sample.time_s, sample.slept_s, cpu_s, reading.power_w, reading.counter_j, reading.epoch, reading.raw,
         reading.problem, reading.refusal],
        separators=(",", ":"),
    )  # fmt: skip


def decode(line: str) -> tuple[int, Sample, float]:
    """What `encode` wrote. Raises ValueError."""
    index, time_s, slept_s, cpu_s, power_w, counter_j, epoch, raw, problem, refusal = json.loads(line)
    return index, Sample(time_s, Reading(power_w, counter_j, epoch, tuple(raw), problem, refusal), slept_s), cpu_s


def lower_priority() -> None:
    """Steps behind whatever is measured; a system that forbids it changes nothing else."""
    with contextlib.suppress(psutil.Error, OSError):
        own = psutil.Process()
        own.nice(psutil.BELOW_NORMAL_PRIORITY_CLASS if sys.platform == "win32" else min(19, own.nice() + NICENESS))


class _Asked:
    """What the parent wants, heard by a thread: a sample now, or the end."""

    def __init__(self, stream: TextIO) -> None:
        self._wake = threading.Event()
        self.ended = False
        threading.Thread(target=self._listen, args=(stream,), daemon=True).start()

    def _listen(self, stream: TextIO) -> None:
        for _ in stream:
            self._wake.set()
        self.ended = True
        self._wake.set()

    def wait(self, seconds: float) -> None:
        self._wake.wait(seconds)
        self._wake.clear()


def main(name: str, sysfs_root: str, *companion: str) -> int:
    """Reads until the parent ends it; the exit code: 0 asked to end, 1 the source cannot be read."""
    try:
        sources = [choose(each, Path(sysfs_root)).source for each in (name, *companion)]
    except AgentError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 1
    print(json.dumps({"method": sources[0].method, "poll_s": sources[0].poll_s}), flush=True)
    lower_priority()
    clock, asked = SystemClock(), _Asked(sys.stdin)
    poll_s = min(source.poll_s for source in sources)  # a counter of a small range must not wrap twice
    began_s = time.process_time()
    due_s = clock.now_s()
    while not asked.ended:
        lines = []
        for index, source in enumerate(sources):
            reading = source.read()
            sample = Sample(clock.now_s(), reading, clock.slept_s())
            lines.append(encode(index, sample, time.process_time() - began_s))
        try:
            print("\n".join(reversed(lines)), flush=True)  # the companion first: who waits waits for the source
        except OSError:
            return 0  # nobody listens any more
        due_s = max(due_s + poll_s, clock.now_s())
        asked.wait(due_s - clock.now_s())
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
