"""Progress of a long measurement on disk, so that a flat battery or a kill costs one window at most.

A file of JSON lines: a `begin` for every process that worked on it, a `commit` after every window. A line is
appended and synced as a whole; the last one may be torn, and is then as if it had never been written.
"""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from joulebox_agent.errors import AgentError, UsageError
from joulebox_agent.estimates.windows import Window
from joulebox_agent.loop import ImageEvent, ReadyEvent
from joulebox_agent.measuring.meter import Meter, joined
from joulebox_agent.measuring.recording import Recording, VoidWindow
from joulebox_agent.sampling.sampler import Sample

BETWEEN_PROCESSES_S = 1000.0  # on our axis of time: far more than any gap that samples may be bridged over
BEGINNING = b'{"begin": '
_SAMPLES = TypeAdapter(list[Sample])
_WINDOWS = TypeAdapter(list[Window])
_VOIDED = TypeAdapter(list[VoidWindow])


class Journal:
    """One file for one plan.

    plan  what is measured and how, as JSON: a file of another plan is refused, not continued
    """

    def __init__(self, path: Path, plan: Mapping[str, Any]) -> None:
        self.path = path
        self._plan = json.loads(json.dumps(plan))
        self._samples = self._companions = self._idle = 0
        self._windows: list[set[float]] = []
        self._voided: list[int] = []

    def resume(self, records: list[Recording], meter: Meter) -> None:
        """Puts what earlier processes measured into records and meter, on this process's axis of time.

        Raises UsageError when the file is of another plan or damaged, AgentError when it cannot be written.
        """
        lives = self._read()
        until_s = meter.start_s - BETWEEN_PROCESSES_S
        try:
            for life in reversed(lives):
                until_s = _shift(life, until_s) - BETWEEN_PROCESSES_S
            for life in lives:
                for commit in life[1:]:
                    _restore(commit, records, meter)
        except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
            first = str(error).splitlines()[0]
            raise UsageError(f"{self.path} is damaged: {first}; remove it to begin anew.") from error
        for record in records:
            record.start_s = min([record.start_s, *(life[0]["start_s"] for life in lives)])
        if any(record.windows for record in records):
            done = sum(len(record.windows) for record in records)
            meter.listener.note(f"{self.path}: {done} windows of earlier are kept")
        self._samples, self._companions = len(meter.earlier), len(meter.earlier_companions)
        self._idle = len(meter.idle)
        self._windows = [{window.start_s for window in record.windows} for record in records]
        self._voided = [len(record.voided) for record in records]
        self._append({"begin": self._plan, "start_s": meter.start_s})

    def commit(self, records: list[Recording], meter: Meter) -> None:
        """Keeps what is new since the last commit. Raises AgentError when the disk does not take it."""
        samples, companions = meter.samples(), meter.companion_samples()
        news: dict[str, Any] = {
            "samples": _SAMPLES.dump_python(samples[self._samples :], mode="json"),
            "companions": _SAMPLES.dump_python(companions[self._companions :], mode="json"),
            "idle": meter.idle[self._idle :],
            "records": [self._news(index, record) for index, record in enumerate(records)],
        }
        self._append({"commit": news})
        self._samples, self._companions, self._idle = len(samples), len(companions), len(meter.idle)

    def finish(self) -> None:
        """Forgets the file: the result is where it belongs."""
        self.path.unlink(missing_ok=True)

    def _news(self, index: int, record: Recording) -> dict[str, Any]:
        known = self._windows[index]
        new = [(w, b) for w, b in zip(record.windows, record.blocks, strict=True) if w.start_s not in known]
        voided = record.voided[self._voided[index] :]
        known.update(window.start_s for window, _ in new)
        self._voided[index] = len(record.voided)
        if not new and not voided:
            return {}
        return {
            "windows": _WINDOWS.dump_python([window for window, _ in new], mode="json"),
            "blocks": [block for _, block in new],
            "voided": _VOIDED.dump_python(voided, mode="json"),
            "ready": record.ready.model_dump(mode="json") if record.ready else None,
            "last_image": record.last_image.model_dump(mode="json") if record.last_image else None,
            "spent_s": record.spent_s,
        }

    def _append(self, line: dict[str, Any]) -> None:
        try:
            with self.path.open("ab") as file:
                file.write(json.dumps(line).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise AgentError(f"Progress cannot be kept in {self.path}: {error.strerror}.") from error

    def _read(self) -> list[list[dict[str, Any]]]:
        """The lives of earlier processes: each a `begin` and its commits. A torn last line is cut off."""
        if self.path.exists() and not self.path.is_file():
            raise UsageError(f"{self.path} is no file; progress is kept in one.")
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return []
        except OSError as error:
            raise UsageError(f"{self.path} cannot be read: {error.strerror}.") from error
        whole = content[: content.rfind(b"\n") + 1]
        lives: list[list[dict[str, Any]]] = []
        for number, text in enumerate(whole.splitlines(), start=1):
            try:
                line = json.loads(text)
                if "begin" in line:
                    if not math.isfinite(line["start_s"]):
                        raise ValueError("no moment")
                    lives.append([{"plan": line["begin"], "start_s": float(line["start_s"])}])
                else:
                    lives[-1].append(line["commit"])
            except (ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
                raise UsageError(f"Line {number} of {self.path} is no progress of ours; use another file.") from error
        if any(life[0]["plan"] != self._plan for life in lives):
            raise UsageError(f"{self.path} is the progress of another measurement; give each a file of its own.")
        if not lives and not (content.startswith(BEGINNING) or BEGINNING.startswith(content)):
            raise UsageError(f"{self.path} is no progress of ours; use another file.")
        if len(whole) < len(content):
            os.truncate(self.path, len(whole))
        return lives


def _shift(life: list[dict[str, Any]], until_s: float) -> float:
    """Moves all times of a life so that its last sample lies at `until_s`; returns where it then starts."""
    begin, commits = life[0], life[1:]
    latest_s = max((sample["time_s"] for c in commits for sample in c["samples"]), default=begin["start_s"])
    by_s = until_s - latest_s
    begin["start_s"] += by_s
    for commit in commits:
        for sample in [*commit["samples"], *commit["companions"]]:
            sample["time_s"] += by_s
        commit["idle"] = [[start_s + by_s, end_s + by_s] for start_s, end_s in commit["idle"]]
        _shift_stretches(commit["records"], by_s)
    return float(begin["start_s"])


def _shift_stretches(value: Any, by_s: float) -> None:
    """Adds to every moment at any depth: what has start_s and end_s, stages' intervals, the ends of images."""
    if isinstance(value, dict):
        if "start_s" in value and "end_s" in value:
            value["start_s"] += by_s
            value["end_s"] += by_s
        for key, inner in value.items():
            if key == "intervals":
                value[key] = [[start_s + by_s, end_s + by_s] for start_s, end_s in inner]
            elif key == "image_ends_s":
                value[key] = [end_s + by_s for end_s in inner]
            else:
                _shift_stretches(inner, by_s)
    elif isinstance(value, list):
        for inner in value:
            _shift_stretches(inner, by_s)


def _restore(commit: dict[str, Any], records: list[Recording], meter: Meter) -> None:
    meter.earlier = joined(meter.earlier, _SAMPLES.validate_python(commit["samples"]))
    meter.earlier_companions = joined(meter.earlier_companions, _SAMPLES.validate_python(commit["companions"]))
    meter.idle += [(start_s, end_s) for start_s, end_s in commit["idle"]]
    for record, news in zip(records, commit["records"], strict=True):
        if not news:
            continue
        record.windows += _WINDOWS.validate_python(news["windows"])
        record.blocks += news["blocks"]
        for voided in _VOIDED.validate_python(news["voided"]):
            record.voided.append(voided)
            for at in reversed(range(len(record.windows))):  # found void after it was kept as good
                if record.windows[at].start_s == voided.start_s:
                    del record.windows[at], record.blocks[at]
        record.ready = ReadyEvent.model_validate(news["ready"]) if news["ready"] else record.ready
        last = news["last_image"]
        record.last_image = ImageEvent.model_validate(last) if last else record.last_image
        record.spent_s = news["spent_s"]
