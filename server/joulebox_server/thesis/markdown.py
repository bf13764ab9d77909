"""docs/thesis.md: the table of claims with what explains every claim that does not hold."""

from collections.abc import Mapping, Sequence

from joulebox_server.reports.document import Table
from joulebox_server.thesis.batch import Batch
from joulebox_server.thesis.pages import (
    RATED,
    advised,
    by_figure,
    claims_table,
    floors_told,
    how_to_read,
    ratings_table,
)
from joulebox_server.thesis.results import Results
from joulebox_server.thesis.told import how_told
from joulebox_server.thesis.verdicts import Judged

HEAD = """# The study, done again

`joulebox thesis -o DIR` repeats "Energy-Efficient Photon Mapping" (Light, WPI 2007) on the device at hand, through an
ordinary server and agent: its sweeps, its figures, and a table of its claims with what this device says to each.
`--quick` takes CPU seconds in place of joules, and most configurations once; `--batch NAME` runs a part; `--device
NAME` has a device of a running server render, and `--source exec:COMMAND` meters with an instrument of one's own. The
same command goes on after an interruption.
The report with every figure is `DIR/report.html`.

This page is written by `joulebox thesis --report-only -o DIR --markdown docs/thesis.md`, and not by hand.
"""


def claims_page(results: Results, batches: Sequence[Batch], judged: Mapping[str, Sequence[Judged]]) -> str:
    """The page of a run, as Markdown."""
    everything = [one for batch in batches for one in judged[batch.name]]
    parts = [HEAD, "## How this run was made\n", _points(how_told(results, batches))]
    parts += ["## What to set\n", how_to_read(results) + "\n", _points(advised(results, batches))]
    parts += ["## Claims\n", _table(claims_table(everything))]
    unmet = [one for one in sorted(everything, key=by_figure) if one.finding.verdict != "holds"]
    if unmet:
        parts += ["## Why claims fail or stay unclear\n"]
        parts += [
            _points([f"**{one.claim.id}** ({one.finding.verdict}): {one.why or one.finding.words}" for one in unmet])
        ]
    rated = ratings_table(results, batches)
    if rated:
        parts += ["## Ratings of the settings\n", RATED + "\n", _table(rated)]
    parts += ["## Batches\n"]
    for batch in batches:
        parts += [f"### {batch.title} (`{batch.name}`)\n", batch.summary.strip() + "\n"]
        parts += [_points(floors_told(results, batch))]
        parts += ["Rules, written before the batch was run:\n"]
        parts += [_points([f"**{one.claim.id}**: {one.claim.rule}" for one in judged[batch.name]])]
    return "\n".join(part for part in parts if part.strip())


def _table(table: Table) -> str:
    lines = [table.columns, ["---"] * len(table.columns), *table.rows]
    return "".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def _points(sentences: Sequence[str]) -> str:
    return "".join(f"- {sentence}\n" for sentence in sentences)
