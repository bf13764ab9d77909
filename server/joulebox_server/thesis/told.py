"""Words that report and documentation share: what a run rests on, and where its intervals come from."""

from collections.abc import Sequence

from joulebox_server.analysis.words import figure
from joulebox_server.thesis.batch import Batch, Plan
from joulebox_server.thesis.results import Results

BASES = {
    "measured": "joules measured on this device",
    "replayed": "joules of a replayed trace, which say nothing of this device",
    "time": "CPU seconds of all threads in place of joules: a busy machine stretches wall time, and CPU time hardly",
}


def how_told(results: Results, batches: Sequence[Batch]) -> list[str]:
    """How the run was made, in sentences."""
    told = [f"Costs are {BASES[results.basis]}."]
    if results.quick:
        told.append(
            "It was a quick run: smaller pictures where a batch is dear, and one render a configuration, but for those "
            "that a claim compares, which have further seeds."
        )
    present = {row.sweep for row in results.rows}
    planned = [sweep["name"] for batch in batches for sweep in batch.sweeps(Plan(results.quick))]
    absent = [name for name in planned if name not in present]
    if absent:
        told.append(f"The run is not whole: {', '.join(absent)} not rendered, so what needs them is not judged.")
    spreads = results.scatters
    parts = [
        f"{name} by {figure(100 * (spread.bounds(1) - 1))} % ({spread.freedom} degrees of freedom)"
        for name, spread in (
            ("an image's cost", spreads.cost),
            ("a stage's cost", spreads.stage),
            ("a difference, over seeds,", spreads.difference),
        )
        if spread is not None
    ]
    if parts:
        told.append(
            "A 99 % interval is learnt from what the same sweep rendered more than once: each configuration's own "
            "scatter is drawn towards what all of them have in common. Comparisons of a setting with doing without it, "
            "beyond the thesis, are made seed by seed. Over the whole run, one render may be off with that "
            f"confidence: {', '.join(parts)}."
        )
    else:
        told.append("Nothing was rendered twice, so intervals have no width and say nothing.")
    told.append(
        "Differences are to the batch's reference with the same seed, as in the thesis; the floor is what another seed "
        "of the reference itself gives. Beyond the thesis and where methods fail, the reference has a seed of its own."
    )
    return told
