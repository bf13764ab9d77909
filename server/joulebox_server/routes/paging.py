"""Lists with a limit and a keyset cursor."""

from typing import Annotated, Any

from fastapi import Query

LARGEST_PAGE = 200

Limit = Annotated[int, Query(ge=1, le=LARGEST_PAGE)]
Cursor = Annotated[str | None, Query(max_length=200)]


def page(items: list[dict[str, Any]], limit: int, key: str = "id") -> dict[str, Any]:
    """Items (one more than `limit` was asked for) with the cursor of the next page, None at the end."""
    shown = items[:limit]
    return {"items": shown, "next": shown[-1][key] if len(items) > limit else None}
