"""What a batch of the study is: sweeps to run, figures to draw, claims to judge.

A batch module holds one `BATCH`. Everything in it is a pure function: sweeps from a `Plan`, figures and findings from
`Results`. A claim's rule is written in words beside its function, and before the batch is run: a verdict is never
fitted to a result.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from joulebox_server.analysis.intervals import Interval
from joulebox_server.reports.document import Table
from joulebox_server.thesis.results import Results
from joulebox_server.thesis.rows import AGAIN

Verdict = Literal["holds", "fails", "unclear"]
Basis = Literal["measured", "replayed", "time"]
Sweep = dict[str, Any]
"""A sweep as a file states it (`schemas.sweep.SweepDefinition`), scenes by their names. Names are unique over all
batches; `thesis.study` adds how to measure."""

THESIS: Mapping[str, Any] = {
    "preset": "reference",
    "samples_per_pixel": 1,
    "jitter": False,
    "use_shadow_photons": True,
    "photon_spacing": 0,
}
"""Settings of the thesis: the preset `reference`, one eye ray through the middle of each pixel, since it names no more,
and shadow rays saved by direct photons, as its chapter 4 has it. A batch adds what it varies; `preset` among the
settings becomes the sweep's."""


@dataclass(frozen=True)
class Plan:
    """How thorough a run is.

    quick    CPU seconds as the proxy of joules, smaller pictures where a batch is dear, and one render a
             configuration but for those that a claim compares
    """

    quick: bool

    def pick(self, quick: Any, full: Any) -> Any:
        """The first in a quick run, the second in a full one."""
        return quick if self.quick else full


def again(sweep: Sweep, repeats: int, changes: Sequence[Mapping[str, Any]] | None = None) -> Sweep:
    """A sweep's configurations, or some of them, with so many further seeds: a rule is not decided by one render."""
    chosen = sweep["configurations"] if changes is None else [dict(changed) for changed in changes]
    further = {"settings": sweep["settings"] | {"seed": 1}, "repeats": repeats, "configurations": chosen}
    return sweep | further | {"name": sweep["name"] + AGAIN}


@dataclass(frozen=True)
class Finding:
    """What we found on a claim.

    value, unit   the number that the rule looks at, with its interval; None where nothing could be said
    verdict       of the rule
    words         ours, in a sentence
    why           of an `unclear` one: what keeps it from being judged, where that is not its interval
    """

    value: Interval | None
    unit: str
    verdict: Verdict
    words: str
    why: str = ""


@dataclass(frozen=True)
class Claim:
    """A statement of the thesis (or of ours, in batches beyond it) and the rule that decides it.

    id             `fig49`, or a word for one without a figure
    claim          the statement
    thesis         its figure or number as the thesis gives it, in words
    rule           when it holds, when it fails; all else is unclear. Written before the batch was run
    judge          the rule as a pure function
    about_energy   the statement says something that a time basis would make true by construction: `unclear` there
    replayed       rests on a replayed discharge, whatever the rest of the run rests on
    explanation    why it does not hold, once examined: the method, the hardware, or a fault of ours
    """

    id: str
    claim: str
    thesis: str
    rule: str
    judge: Callable[[Results], Finding]
    about_energy: bool = False
    replayed: bool = False
    explanation: str = ""


@dataclass(frozen=True)
class Tile:
    """A picture among others: a stored one by its hash (EXR or delta PNG), with a caption."""

    image_sha256: str
    caption: str


Spec = dict[str, Any]


@dataclass(frozen=True)
class Figure:
    """A figure by the thesis' number (`29`), or a name of ours (`stability-photons`).

    draw      a Vega-Lite specification, a table, or pictures side by side; None where the results lack what it shows
    """

    number: str
    title: str
    caption: str
    draw: Callable[[Results], Spec | Table | Sequence[Tile] | None]


@dataclass(frozen=True)
class Rated:
    """Settings that a sweep rates: of the thesis' table, by the points that differ from the reference in one alone."""

    table: str
    sweep: str
    scene: str
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Batch:
    """A part of the study.

    summary    what it varies and what was learnt to look at, in two sentences for a newcomer
    sweeps     ordinary sweeps, the order in which they are run
    advice     what to set, from the results, in sentences; shown at the top of the report
    """

    name: str
    title: str
    summary: str
    sweeps: Callable[[Plan], list[Sweep]]
    figures: tuple[Figure, ...]
    claims: tuple[Claim, ...]
    advice: Callable[[Results], list[str]] = field(default=lambda results: [])
    rated: tuple[Rated, ...] = ()
