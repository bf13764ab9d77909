"""Result rows as a Parquet file."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from arro3.core import Array, DataType, Field, RecordBatch, Schema, Table
from arro3.io import write_parquet as write_table

from joulebox_server.schemas.answers import ResultRow

TYPES: Final = {str: DataType.utf8(), int: DataType.int64(), float: DataType.float64()}


def _column_type(annotation: Any) -> DataType:
    """The type of a column: that of the field's kind that is not None; texts where there is a choice of words."""
    kinds = [kind for kind in getattr(annotation, "__args__", (annotation,)) if kind in TYPES]
    return TYPES[kinds[0]] if kinds else TYPES[str]


COLUMNS: Final = {name: _column_type(field.annotation) for name, field in ResultRow.model_fields.items()}
SCHEMA: Final = Schema([Field(name, kind, nullable=True) for name, kind in COLUMNS.items()])


def write_parquet(batches: Iterable[list[dict[str, Any]]], target: Path) -> None:
    """Write rows in the columns of `ResultRow`; a file without rows has the columns all the same.

    Raises OSError when the file cannot be written.
    """
    found = [_batch(batch) for batch in batches]
    with target.open("wb") as file:
        write_table(Table.from_batches(found, schema=SCHEMA), file, compression="zstd(3)")


def _batch(rows: list[dict[str, Any]]) -> RecordBatch:
    columns = [Array([row[name] for row in rows], type=kind) for name, kind in COLUMNS.items()]
    return RecordBatch.from_arrays(columns, schema=SCHEMA)
