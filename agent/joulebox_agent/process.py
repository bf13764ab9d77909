"""A renderer's process: its lines as they come, what it said on stderr, and its end, whatever it does."""

import contextlib
import queue
import shlex
import shutil
import subprocess
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import IO

from joulebox_agent.clock import Clock
from joulebox_agent.errors import RendererError, RendererRefusedError, UsageError

STOP_WITHIN_S = 10.0


def program_words(command: str, what: str, option: str) -> list[str]:
    """The words of a command line that the user gave, whose first is a program here; no shell runs it.

    what, option  what it is, and where it was given, for the sentence of the UsageError
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise UsageError(f"The {what} {command!r} is no command: {error}.") from error
    if not words or shutil.which(words[0]) is None:
        raise UsageError(f"The {what} {command!r} is not a program on this machine; check {option}.")
    return words


class RendererProcess:
    """One process, started at once. Whoever made it stops it.

    clock     tells when a line arrived
    on_words  called with each line the renderer writes to stderr (progress of its set-up)
    listens   whether it is told things on its standard input
    """

    def __init__(
        self, command: Sequence[str], clock: Clock, on_words: Callable[[str], None], listens: bool = False
    ) -> None:
        self._clock, self._on_words = clock, on_words
        self._lines: queue.Queue[tuple[float, str] | None] = queue.Queue()
        self._words: deque[str] = deque(maxlen=20)
        try:
            # a session of its own: Ctrl-C reaches the agent alone, which then stops the renderer in order
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE if listens else subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                start_new_session=True,
            )
        except OSError as error:
            raise RendererError(f"{command[0]} cannot be started: {error.strerror}.") from error
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._threads = [
            threading.Thread(target=self._read_lines, args=(self._process.stdout,), daemon=True),
            threading.Thread(target=self._read_words, args=(self._process.stderr,), daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def _read_lines(self, stream: IO[str]) -> None:
        with stream:  # closed here, since a child of the renderer may hold it open longer than `stop` waits
            for line in stream:
                self._lines.put((self._clock.now_s(), line))
        self._lines.put(None)

    def _read_words(self, stream: IO[str]) -> None:
        with stream:
            for line in stream:
                if line.strip():
                    self._words.append(line.strip())
                    self._on_words(line.strip())

    def hear(self, clock: Clock, on_words: Callable[[str], None]) -> None:
        """Says by whose clock and to whom the lines of the next job go; what was said before is forgotten."""
        self._clock, self._on_words = clock, on_words
        self._words.clear()

    def tell(self, line: str) -> bool:
        """Writes a line to its standard input; False when it no longer listens."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except OSError:
            return False
        return True

    def next_line(self, timeout_s: float) -> tuple[float, str] | None:
        """The next line and when it arrived [s], None when none came within `timeout_s`.

        Raises RendererError when the process ended, RendererRefusedError for code 2.
        """
        try:
            item = self._lines.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if item is None:
            self._lines.put(None)  # every later call meets the end again
            raise self._end()
        return item

    def _end(self) -> RendererError:
        """What to say about a process whose output ended."""
        try:
            code = self._process.wait(STOP_WITHIN_S)
        except subprocess.TimeoutExpired:
            return RendererError("The renderer closed its output and did not end.")
        self._threads[1].join(STOP_WITHIN_S)
        said = self._words[-1] if self._words else "it wrote nothing to stderr"
        if code == 2:
            return RendererRefusedError(f"The renderer refused: {said}")
        if code == 0:
            return RendererError("The renderer ended by itself (code 0) before the measurement was complete.")
        return RendererError(f"The renderer died with code {code}: {said}")

    def stop(self, within_s: float = STOP_WITHIN_S) -> None:
        """Asks the renderer to end, and makes it after `within_s`. Safe to call again."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(within_s)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        for thread in self._threads:
            thread.join(STOP_WITHIN_S)
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):  # what was still to be told reaches nobody
                self._process.stdin.close()
