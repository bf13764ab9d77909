"""What measuring one configuration left behind: windows, samples, and what was void and why."""

from dataclasses import dataclass, field

from joulebox_agent.conditions import Conditions
from joulebox_agent.estimates.windows import Window
from joulebox_agent.loop import ImageEvent, ReadyEvent, StageEvent
from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sources.reading import EnergySource, SourceReport


@dataclass(frozen=True)
class VoidWindow:
    """A stretch [s on the perf_counter axis] that was meant as a window and must not be used."""

    start_s: float
    end_s: float
    images: int
    reason: str


@dataclass
class Recording:
    """Filled while the renderer runs; `result` turns it into the document.

    start_s       moment that all times of the document count from
    warm_up       the first image after `ready`, outside every window
    windows       good ones; blocks[i] is the block that windows[i] belongs to
    voided        windows that a fault or a change of state made worthless
    rest          the images after the last closed window, None without any; without a meter, all there are
    spent_s       time the renderer ran since its `ready`, over all its runs
    environment   True when `void` is the machine's doing (mains, sleep, sensor), not the renderer's
    idle          stretches (start_s, end_s) in which nothing rendered
    suspect       why the result is to be doubted though nothing is void (the control drifted), or None
    """

    source: EnergySource
    source_report: SourceReport
    start_s: float
    ready: ReadyEvent | None = None
    warm_up: ImageEvent | None = None
    warm_up_stages: list[StageEvent] = field(default_factory=list)
    last_image: ImageEvent | None = None
    images: list[ImageEvent] = field(default_factory=list)
    windows: list[Window] = field(default_factory=list)
    blocks: list[int] = field(default_factory=list)
    voided: list[VoidWindow] = field(default_factory=list)
    rest: Window | None = None
    spent_s: float = 0.0
    samples: list[Sample] = field(default_factory=list)
    companion_samples: list[Sample] = field(default_factory=list)
    idle: list[tuple[float, float]] = field(default_factory=list)
    before: Conditions = field(default_factory=dict)
    after: Conditions = field(default_factory=dict)
    sampler_cpu_share: float = 0.0
    notes: list[str] = field(default_factory=list)
    void: str | None = None
    environment: bool = False
    suspect: str | None = None

    def make_void(self, reason: str, environment: bool) -> None:
        """Keeps the first reason."""
        if self.void is None:
            self.void, self.environment = reason, environment

    def note(self, text: str) -> None:
        """Keeps a note once."""
        if text not in self.notes:
            self.notes.append(text)
