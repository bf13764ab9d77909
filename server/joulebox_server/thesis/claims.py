"""Claims by batch: their words and rules from claims.toml, each with the function that judges it."""

import tomllib
from collections.abc import Callable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from joulebox_server.thesis.batch import Claim, Finding
from joulebox_server.thesis.results import Results

Judge = Callable[[Results], Finding]


def claims_of(batch: str, judges: Mapping[str, Judge]) -> tuple[Claim, ...]:
    """The claims of a batch in the order of the file. Raises ValueError unless each has one judge."""
    told = _file()[batch]
    names = [claim["id"] for claim in told]
    if sorted(names) != sorted(judges):
        raise ValueError(f"claims.toml has {names} for {batch}, judged are {list(judges)}")
    words = [{name: _unwrapped(value) for name, value in claim.items()} for claim in told]
    return tuple(Claim(**claim, judge=judges[claim["id"]]) for claim in words)


@cache
def _file() -> dict[str, list[dict[str, Any]]]:
    return tomllib.loads((files("joulebox_server.thesis") / "claims.toml").read_text(encoding="utf-8"))


def _unwrapped(value: Any) -> Any:
    return " ".join(value.split()) if isinstance(value, str) else value
