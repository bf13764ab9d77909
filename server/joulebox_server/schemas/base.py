"""What every document has in common."""

import re
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, WithJsonSchema

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
# Controls, invisible spaces and what turns the direction of writing; not the joiners that scripts and emoji need.
UNSEEN = r"\x00-\x1f\x7f-\x9f\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff"
NAME = rf"^(?!\.{{1,2}}$)[^{UNSEEN}/\\\s]([^{UNSEEN}/\\]*[^{UNSEEN}/\\\s])?$"


def _seen(name: str) -> str:
    found = re.search(f"[{UNSEEN}/\\\\]", name)
    if found is not None:
        what = repr(found[0]) if found[0] in "/\\" else f"U+{ord(found[0]):04X}, which cannot be seen"
        raise ValueError(f"a name may not hold {what}")
    if name in (".", ".."):
        raise ValueError(f"a name may not be {name!r}: in an address that is another place")
    if name.strip() != name or not name:
        raise ValueError("a name may not be empty, nor begin or end with a space")
    return name


Name = Annotated[
    str,
    Field(min_length=1, max_length=100),
    AfterValidator(_seen),
    WithJsonSchema({"type": "string", "minLength": 1, "maxLength": 100, "pattern": NAME}),
]
"""A name for people: what they see is what it is, and no slash in it."""
LARGEST_WHOLE = 2**63 - 1


def _bounded(value: JsonValue) -> JsonValue:
    if isinstance(value, int) and abs(value) > LARGEST_WHOLE:
        raise ValueError(f"a whole number must lie within {LARGEST_WHOLE} of 0")
    return value


Scalar = Annotated[bool | int | float | str | None, AfterValidator(_bounded)]
"""A value of a setting."""
ToldSetting = Annotated[JsonValue, AfterValidator(_bounded)]
"""A value of a setting as a renderer tells it."""


class Document(BaseModel):
    """Frozen; an unknown field or a NaN is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Interval(Document):
    """A value with the bounds of its confidence interval, in the unit of the field that holds it."""

    value: float
    low: float
    high: float
