"""Lists with a limit and a keyset cursor, and the header that guards a change."""

from typing import Annotated, Any

from fastapi import Header, Path, Query

LARGEST_PAGE = 200

Limit = Annotated[int, Query(ge=1, le=LARGEST_PAGE)]
NEXT = "The `next` of the page before."
Cursor = Annotated[
    str | None, Query(pattern=r"^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$", description=f"{NEXT} An id.")
]
NameCursor = Annotated[str | None, Query(max_length=200, description=f"{NEXT} A name.")]
IfMatch = Annotated[
    str | None,
    Header(max_length=200, description='The ETag that was read, such as "v3": the change is refused if it is no more.'),
]
Key = Annotated[str, Path(max_length=200, description="Id, or the name if only one has it.")]
Id = Annotated[str, Path(max_length=200)]
ETAG = {"headers": {"ETag": {"schema": {"type": "string"}, "description": "For If-Match: what an operator changed."}}}


def page(items: list[dict[str, Any]], limit: int, key: str = "id") -> dict[str, Any]:
    """Items (one more than `limit` was asked for) with the cursor of the next page, None at the end."""
    shown = items[:limit]
    return {"items": shown, "next": shown[-1][key] if len(items) > limit else None}
