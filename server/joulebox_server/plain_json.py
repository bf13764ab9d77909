"""JSON that people and devices send, read so that nothing it says is passed over."""

import json
from collections import Counter
from typing import Any

from joulebox_server.errors import InvalidError


def read_json(text: str | bytes) -> Any:
    """What the text says. Raises ValueError for no JSON, InvalidError when an object has a key twice."""
    return json.loads(text, object_pairs_hook=_object)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose keys stand in it once: of two values one would be passed over."""
    found = dict(pairs)
    if len(found) != len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise InvalidError(f"{twice[:60]!r} stands twice in one object")
    return found
