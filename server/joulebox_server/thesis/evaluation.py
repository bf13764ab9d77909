"""From a study's rows to its report: findings, figures, the table of claims as JSON and Markdown."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joulebox_server.cli.connection import CommandError
from joulebox_server.reports import page
from joulebox_server.thesis.batch import Batch
from joulebox_server.thesis.markdown import claims_page
from joulebox_server.thesis.pages import report_of
from joulebox_server.thesis.study import Study
from joulebox_server.thesis.verdicts import Judged, judge

CLAIMS_FILE = "claims.json"


@dataclass(frozen=True)
class Written:
    """What a report wrote."""

    folder: Path
    files: Sequence[Path]
    judged: Sequence[Judged]
    basis: str

    def counts(self) -> dict[str, int]:
        """Claims by verdict."""
        found = Counter(one.finding.verdict for one in self.judged)
        return {verdict: found[verdict] for verdict in ("holds", "fails", "unclear")}

    def document(self) -> dict[str, Any]:
        """For --json."""
        files = [str(path) for path in self.files]
        return {"folder": str(self.folder), "basis": self.basis, "verdicts": self.counts(), "files": files}

    def summary(self) -> str:
        """For people."""
        told = ", ".join(f"{count} {verdict}" for verdict, count in self.counts().items())
        return f"{len(self.judged)} claims: {told}\n{self.folder / page.PAGE}"


def write(study: Study, batches: Sequence[Batch], markdown: Path | None) -> Written:
    """Write the report, its figures and claims.json of what the folder holds. Raises CommandError where it cannot."""
    results = study.results()
    present = {row.sweep for row in results.rows}
    shown = [batch for batch in batches if any(sweep["name"] in present for sweep in batch.sweeps(study.plan))]
    if not shown:
        raise CommandError(f"{study.folder} holds no result of {', '.join(batch.name for batch in batches)} yet")
    judged = {batch.name: [judge(claim, results) for claim in batch.claims] for batch in shown}
    everything = [one for found in judged.values() for one in found]
    report = report_of(study.pictures, results, shown, judged)
    files = page.write(report, study.folder)
    contents = {study.folder / CLAIMS_FILE: json.dumps([one.document() for one in everything], indent=1) + "\n"}
    if markdown is not None:
        contents[markdown] = claims_page(results, shown, judged)
    for path, text in contents.items():
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise CommandError(f"{path} cannot be written: {error.strerror}") from None
        files.append(path)
    return Written(study.folder, files, everything, results.basis)
