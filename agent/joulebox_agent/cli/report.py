"""What `measure` leaves behind: files, a document on standard output, a few lines for a person."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from joulebox_agent.errors import AgentError
from joulebox_agent.estimates.estimate import Interval
from joulebox_agent.measuring.document import MeasureDocument
from joulebox_agent.measuring.result import Result


class VoidMeasurementError(AgentError):
    """The measurement ended, but what it saw must not be used."""


def deliver(
    results: list[Result], document: dict[str, Any], summary: str, as_json: bool, output: Path | None, keep: Path | None
) -> None:
    """Prints the document or the summary and writes the files; a full disk costs its file only.

    Raises AgentError for the first file that could not be written, after everything else was done.
    """
    text = json.dumps(document, indent=1)
    failures: list[str] = []

    def attempt(path: Path, write: Callable[[], object]) -> None:
        try:
            write()
        except OSError as error:
            failures.append(f"{path} cannot be written: {error.strerror}.")

    for result in results:
        for digest, content in result.blobs.items():
            kind = "exr" if digest == result.document.image_blob else "ndjson"
            if keep is not None:
                path = keep / f"{digest}.{kind}"
                attempt(path, lambda path=path, content=content: path.write_bytes(content))  # type: ignore[misc]
    if output is not None:
        attempt(output, lambda: output.write_text(text + "\n", encoding="utf-8"))
    print(text if as_json else summary)
    if failures:
        raise AgentError(failures[0])


def summary(document: MeasureDocument) -> str:
    """A few lines for a person."""
    lines = [
        f"{document.scene}: {document.images} images in {document.windows} windows"
        + (f", {len(document.void_windows)} more void" if document.void_windows else ""),
        f"  picture {document.pixel_sha256}",
        f"  time    {_words(document.time_s_per_image, 's')} an image",
        f"  CPU     {_words(document.cpu_s_per_image, 's')} an image",
    ]
    energy = document.energy_j_per_image
    if energy.gross is None:
        lines.append("  energy  unknown (null): no joules are made up")
    else:
        label = f"{document.quality.upper()}, {document.method}, {document.scope}"
        lines.append(f"  energy  {_words(energy.gross, 'J')} an image ({label})")
    if energy.net is not None:
        lines.append(f"  net     {_words(energy.net, 'J')} an image above idle")
    for name, stage in document.stages.items():
        lines.append(f"    {name}: {stage.time_s:.4g} s{_stage_words(stage.energy_j.model_dump())}")
    if document.suspect is not None:
        lines.append(f"  SUSPECT {document.suspect}")
    return "\n".join(lines)


def _stage_words(energies: dict[str, float | None]) -> str:
    known = [f"{joules:.4g} J {name}" for name, joules in energies.items() if joules is not None]
    return "".join(f", {words}" for words in known)


def _words(interval: Interval | None, unit: str) -> str:
    if interval is None:
        return "unknown"
    if interval.low == interval.high:
        return f"{interval.value:.4g} {unit}"
    return f"{interval.value:.4g} {unit} [{interval.low:.4g}, {interval.high:.4g}]"
