"""What every document has in common."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f/\\]+$")]
"""A name for people: no control characters, no slashes."""
Scalar = bool | int | float | str | None
"""A value of a setting."""


class Document(BaseModel):
    """Frozen; an unknown field or a NaN is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Interval(Document):
    """A value with the bounds of its confidence interval, in the unit of the field that holds it."""

    value: float
    low: float
    high: float
