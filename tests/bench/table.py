"""The table of goals: its rows, and how they are written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Row(NamedTuple):
    """A goal and what was measured; met is None where nothing was."""

    what: str
    goal: str
    measured: str
    met: bool | None

    @classmethod
    def not_run(cls, what: str, goal: str, why: str) -> Row:
        """A row whose measurement did not take place."""
        return cls(what, goal, why, None)

    @property
    def verdict(self) -> str:
        """The last cell."""
        return {True: "met", False: "**missed**", None: "not run"}[self.met]


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table, a line each."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


def goals(rows: Sequence[Row]) -> list[str]:
    """The table of goals."""
    cells = [(row.what, row.goal, row.measured, row.verdict) for row in rows]
    return markdown_table(("what", "goal", "measured", ""), cells)
