"""How a measurement shows itself: a live bar on a terminal, plain lines elsewhere; always on stderr."""

import sys
import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from joulebox_agent.measuring.meter import Listener

REDRAW_S = 0.5  # drawing costs energy too


class Bar:
    """Windows done of windows wanted, with the running interval."""

    def __init__(self) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:.0f}/{task.total:.0f} windows"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[estimate]}"),
            console=Console(stderr=True),
            auto_refresh=False,
            transient=True,
        )
        self._task: TaskID = self._progress.add_task("measuring", total=1, estimate="")
        self._drawn_s = 0.0

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        self._progress.stop()

    def note(self, text: str) -> None:
        self._progress.console.print(text, style="dim", markup=False, highlight=False)

    def words(self, text: str) -> None:
        self.note(text)

    def progress(self, elapsed_s: float, windows: int, wanted: int, estimate: str) -> None:
        now_s = time.perf_counter()
        if now_s - self._drawn_s < REDRAW_S:
            return
        self._drawn_s = now_s
        self._progress.update(self._task, completed=windows, total=wanted, estimate=estimate, refresh=True)


class Lines:
    """One line of news at a time, one a window."""

    def __init__(self) -> None:
        self._windows = 0

    def __enter__(self) -> "Lines":
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        pass

    def note(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    def words(self, text: str) -> None:
        """Left out: what matters of it comes back in the sentence of an error."""

    def progress(self, elapsed_s: float, windows: int, wanted: int, estimate: str) -> None:
        if windows > self._windows:
            self._windows = windows
            self.note(f"window {windows} of {wanted} after {elapsed_s:.1f} s{': ' if estimate else ''}{estimate}")


def shown_progress() -> Bar | Lines:
    """A Bar when stderr is a terminal, else Lines."""
    return Bar() if sys.stderr.isatty() else Lines()


_BAR_IS_LISTENER: type[Listener] = Bar
_LINES_IS_LISTENER: type[Listener] = Lines
