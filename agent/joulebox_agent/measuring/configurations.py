"""The file of `--configurations`: what is measured in one session."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joulebox_agent.errors import UsageError

EXAMPLE = '[[configurations]] tables of settings (TOML), or a list of objects as in [{"gather_count": 50}] (JSON)'
Scalar = str | int | float | bool


@dataclass(frozen=True)
class Entry:
    """One configuration of the file: settings over those that all share; timed_only: no energy is metered."""

    settings: Mapping[str, Scalar]
    label: str
    timed_only: bool = False

    def arguments(self) -> list[str]:
        """The settings as words of the loop command."""
        return [word for key, value in self.settings.items() for word in ("--set", f"{key}={_text(value)}")]


def read_configurations(path: Path) -> list[Entry]:
    """Reads TOML or JSON. Raises UsageError naming the entry and what is wrong with it.

    An entry is a table of settings, or {"settings": {...}, "name": "...", "timed_only": true}.
    """
    if path.exists() and not path.is_file():
        raise UsageError(f"{path} is no file of configurations.")
    try:
        text = path.read_text(encoding="utf-8")
        document = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read: {getattr(error, 'strerror', None) or 'not text'}.") from error
    except (ValueError, RecursionError) as error:
        kind = "TOML" if path.suffix == ".toml" else "JSON"
        raise UsageError(f"{path} is not {kind}: {error}.") from error
    rows = document.get("configurations") if isinstance(document, dict) else document
    if not isinstance(rows, list) or not rows:
        raise UsageError(f"{path} holds no configurations; write {EXAMPLE}.")
    return [_entry(row, f"Configuration {number} of {path}") for number, row in enumerate(rows, start=1)]


def _entry(row: Any, where: str) -> Entry:
    if not isinstance(row, dict):
        raise UsageError(f"{where} is {row!r:.40}; write {EXAMPLE}.")
    settings, label, timed_only = row, None, False
    if isinstance(row.get("settings"), dict):
        unknown = sorted(row.keys() - {"settings", "name", "timed_only"})
        if unknown:
            raise UsageError(f"{where} has {unknown[0]!r} beside its settings; known are settings, name, timed_only.")
        settings, label, timed_only = row["settings"], row.get("name"), row.get("timed_only", False)
    for key, value in settings.items():
        if not isinstance(value, str | int | float):
            raise UsageError(f"{where}: {key} must be a number, a word or true or false, not {value!r:.40}.")
    if not isinstance(timed_only, bool) or not isinstance(label, str | None):
        raise UsageError(f"{where}: name must be a text and timed_only true or false.")
    words = " ".join(f"{key}={_text(value)}" for key, value in settings.items())
    return Entry(settings, label or words or "as given", timed_only)


def _text(value: Scalar) -> str:
    """A value as `--set` takes it."""
    return value if isinstance(value, str) else json.dumps(value)
