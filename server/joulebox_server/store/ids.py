"""Ids, times and canonical text, as they are at rest."""

import hashlib
import json
import time
from datetime import UTC, datetime
from typing import Any

from uuid6 import uuid7

from joulebox_server.errors import InvalidError

MICRO = 1_000_000


def new_id() -> str:
    """A UUIDv7: ids sort by the time they were made."""
    return str(uuid7())


def now_us() -> int:
    """Microseconds since 1970, UTC."""
    return time.time_ns() // 1000


def timestamp(at_us: int | None) -> str | None:
    """RFC 3339 text of a time at rest, UTC."""
    if at_us is None:
        return None
    return datetime.fromtimestamp(at_us / MICRO, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def canonical(value: Any) -> str:
    """JSON text that is the same for equal values: keys sorted, no spaces.

    Raises InvalidError for NaN, infinity and halves of a character (lone surrogates), which Python's JSON lets in.
    """
    try:
        text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
        text.encode()
    except ValueError as error:
        raise InvalidError(f"the document holds a value that JSON cannot: {error}") from None
    return text


def sha256_text(text: str) -> str:
    """SHA-256 of UTF-8 text, in hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def micro(value: float | None) -> int | None:
    """Joules or seconds as whole microjoules or microseconds."""
    return None if value is None else round(value * MICRO)


def unit(value: int | None) -> float | None:
    """Whole microjoules or microseconds as joules or seconds."""
    return None if value is None else value / MICRO
