"""How commands print: one JSON document, or lines and tables for people."""

import json
from collections.abc import Iterable, Sequence
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table


def print_json(document: Any) -> None:
    """The document, indented, on standard output."""
    typer.echo(json.dumps(document, indent=1, ensure_ascii=False))


def print_table(columns: Sequence[str], rows: Iterable[Sequence[object]], empty: str) -> None:
    """A table, or the sentence `empty` when there are no rows."""
    found = [[escape("" if cell is None else str(cell)) for cell in row] for row in rows]
    if not found:
        typer.echo(empty)
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in found:
        table.add_row(*row)
    Console().print(table)


def quantity(interval: dict[str, float] | None, unit: str) -> str:
    """`1.23 s (1.20 to 1.26)`, or `unknown`."""
    if interval is None:
        return "unknown"
    space = f" {unit}" if unit else ""
    return f"{interval['value']:.4g}{space} ({interval['low']:.4g} to {interval['high']:.4g})"
