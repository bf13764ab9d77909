"""The study's report: what to set, the table of claims, and each batch with its figures and rules."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from joulebox_server.analysis.words import figure, setting
from joulebox_server.reports.document import (
    Block,
    Chart,
    Fold,
    Picture,
    Pictures,
    Points,
    Report,
    Section,
    Table,
    Words,
)
from joulebox_server.thesis.batch import Batch, Figure, Plan, Tile
from joulebox_server.thesis.judging import told
from joulebox_server.thesis.ratings import limit_of, ratings
from joulebox_server.thesis.results import MissingError, Results
from joulebox_server.thesis.told import BASES, how_told
from joulebox_server.thesis.verdicts import Judged

MOST_FLOORS = 6
"""So many references a batch are told of at once; more are folded away."""
MISSING = "Not drawn: the results of this run do not hold what it shows."
FIRST = "beyond"
"""The batch whose advice comes first: settings that go together, to begin with."""
SAID = {"holds": "holds", "fails": "fails", "unclear": "stays unclear"}


def report_of(
    pictures: Path, results: Results, batches: Sequence[Batch], judged: Mapping[str, Sequence[Judged]]
) -> Report:
    """The whole report of a run; `pictures` is the folder of PNGs by hash."""
    everything = [one for batch in batches for one in judged[batch.name]]
    rated = ratings_table(results, batches)
    sections = [
        Section("What to set", "advice", [Words(how_to_read(results)), Points(advised(results, batches))]),
        Section("Claims", "claims", [Words(_count(everything), "lede"), claims_table(everything)]),
        *([Section("Ratings of the settings", "ratings", [Words(RATED), rated])] if rated else []),
        *(_batch_section(pictures, results, batch, judged[batch.name]) for batch in batches),
        Section("How this was made", "how", [Points(how_told(results, batches))]),
    ]
    subtitle = "The study that joulebox grew from, done again on this device"
    return Report("Energy-efficient photon mapping", subtitle, [section for section in sections if section.blocks])


RATED = (
    "Energy impact is the steepest step's elasticity, |d ln cost / d ln setting|: low below 0.15, high above 0.6. "
    "Image sensitivity is low when every value stays within the acceptable difference, high when the first step away "
    "from the reference exceeds three times that. These are the thesis' tables 3 and 4, by rule."
)


def claims_table(judged: Sequence[Judged]) -> Table:
    """Every claim on a line, those of figures by their numbers and first."""
    rows = [
        (one.claim.id, one.claim.claim, one.claim.thesis, one.finding.words, one.basis, one.finding.verdict)
        for one in sorted(judged, key=by_figure)
    ]
    return Table(("id", "claim", "thesis", "ours", "basis", "verdict"), rows, "Claims of the thesis, and what we found")


def by_figure(judged: Judged) -> tuple[bool, int]:
    """To sort claims by: the figure's number; the others come after, and stay as they are."""
    number = judged.claim.id.removeprefix("fig")
    return (not number.isdigit(), int(number) if number.isdigit() else 0)


def ratings_table(results: Results, batches: Sequence[Batch]) -> Table | None:
    """The ratings of every setting that the batches ask to be rated; None where there is nothing to rate."""
    rows = [
        (
            rated.table, rated.scene, name, found.energy_impact, figure(found.elasticity), found.image_sensitivity,
            "; ".join(f"{setting(cliff.start)} to {setting(cliff.end)}" for cliff in found.cliffs) or "none",
        )
        for batch in batches
        for rated in batch.rated
        for name, found in ratings(results, rated.sweep, rated.scene, rated.settings).items()
    ]  # fmt: skip
    columns = ("table", "scene", "setting", "energy impact", "elasticity", "image sensitivity", "cliffs")
    return Table(columns, rows, numeric=frozenset({4})) if rows else None


def _batch_section(pictures: Path, results: Results, batch: Batch, judged: Sequence[Judged]) -> Section:
    blocks: list[Block] = [Words(batch.summary)]
    floors = floors_told(results, batch)
    if len(floors) > MOST_FLOORS:
        blocks.append(Fold(f"The {len(floors)} references, and what another seed of each differs by", [Points(floors)]))
    elif floors:
        blocks.append(Points(floors))
    for one in batch.figures:
        blocks += _figure_blocks(pictures, results, one, " ".join([one.caption, *_said(one, judged)]).strip())
    rules = [(one.claim.id, one.claim.rule, one.finding.verdict, one.why) for one in judged]
    if rules:
        table = Table(("id", "rule, written before the batch was run", "verdict", "why, where it does not hold"), rules)
        blocks.append(Fold("The rules of this batch's claims", [table]))
    return Section(batch.title, f"batch-{batch.name}", blocks, label=batch.name)


def _said(one: Figure, judged: Sequence[Judged]) -> list[str]:
    """The claim that a figure is about, and what was found: who reads the figure alone knows what to see in it."""
    return [
        f"The thesis: {_lower(found.claim.claim)} ({found.claim.thesis}). Here it {SAID[found.finding.verdict]}: "
        f"{found.finding.words}."
        for found in judged
        if found.claim.id == f"fig{one.number}"
    ]


def _lower(sentence: str) -> str:
    """To go on after a colon; a word that is a number or a name in capitals stays."""
    return sentence[0].lower() + sentence[1:] if sentence[1:2].islower() or sentence[1:2] == " " else sentence


def _figure_blocks(pictures: Path, results: Results, one: Figure, caption: str) -> list[Block]:
    heading = f"Figure {one.number}. {one.title}."
    try:
        drawn = one.draw(results)
    except MissingError:
        drawn = None
    name = f"figure-{one.number}"
    if drawn is None:
        return [Words(f"{heading} {MISSING}", "notice")]
    if isinstance(drawn, dict):
        return [Chart(name, drawn, f"{heading} {caption}".strip(), one.title)]
    if isinstance(drawn, Table):
        return [Words(f"{heading} {caption}"), drawn]
    shown = [
        Picture(f"{name}-{number}", (pictures / f"{tile.image_sha256}.png").read_bytes(), tile.caption, tile.caption)
        for number, tile in enumerate(drawn, 1)
        if (pictures / f"{tile.image_sha256}.png").is_file()
    ]
    return [Words(f"{heading} {caption}"), Pictures(shown)] if shown else [Words(f"{heading} {MISSING}", "notice")]


def tiles_of(results: Results, batches: Sequence[Batch]) -> list[Tile]:
    """Every picture that the figures show."""
    found: list[Tile] = []
    for batch in batches:
        for one in batch.figures:
            try:
                drawn = one.draw(results)
            except MissingError:
                continue
            if drawn is not None and not isinstance(drawn, dict | Table):
                found += drawn
    return found


def floors_told(results: Results, batch: Batch) -> list[str]:
    """The noise floors of a batch's references beside the limit, a sentence a scene."""
    sentences = []
    for sweep in batch.sweeps(Plan(results.quick)):
        for reference in results.points(sweep["name"], purpose="reference"):
            floor = results.floor(sweep["name"], reference.scene)
            if floor is not None:
                size = f"{reference.settings['width']}x{reference.settings['height']}"
                sentences.append(
                    f"{sweep['name']}, {reference.scene} at {size}: another seed of the reference differs by "
                    f"{figure(floor)}; {figure(limit_of(reference))} is acceptable. The reference costs "
                    f"{told(reference.cost, results.unit)}."
                )
    return sentences


def how_to_read(results: Results) -> str:
    """What costs and differences are, for who reads the report alone."""
    return (
        f"Costs are {BASES[results.basis]}. A difference says how far a picture is from a dear one of the same scene, "
        "its reference: 0 is the same picture, and up to 100 at 256x256 pixels (in proportion to the pixels at other "
        "sizes) it counts as acceptable, which is not to say that it cannot be seen. In brackets: where the true value "
        "lies with 99 % confidence. A setting that a sentence leaves out stays as the reference has it."
    )


def advised(results: Results, batches: Sequence[Batch]) -> list[str]:
    """What the batches advise to set; one whose points are not all there advises nothing."""
    sentences: list[str] = []
    for batch in sorted(batches, key=lambda batch: batch.name != FIRST):
        with contextlib.suppress(MissingError):
            sentences += batch.advice(results)
    return sentences or ["The results of this run do not tell yet."]


def _count(judged: Sequence[Judged]) -> str:
    counts = {v: sum(one.finding.verdict == v for one in judged) for v in ("holds", "fails", "unclear")}
    return f"Of {len(judged)} claims {counts['holds']} hold, {counts['fails']} fail, {counts['unclear']} are unclear."
