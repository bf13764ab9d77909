"""What one run of the loop left behind: images, windows, samples, and why it is void if it is."""

from dataclasses import dataclass, field

from joulebox_agent.conditions import Conditions
from joulebox_agent.loop import ImageEvent, ReadyEvent, StageEvent
from joulebox_agent.sampler import Sample
from joulebox_agent.sources.reading import EnergySource, SourceReport
from joulebox_agent.windows import Window, WindowSplitter


@dataclass
class Recording:
    """Filled while the renderer runs; `result` turns it into the document.

    start_s      moment that all times of the document count from
    warm_up      the first image after `ready`, outside every window
    environment  True when `void` is the machine's doing (mains, sleep, sensor), not the renderer's
    idle         stretches (start_s, end_s) in which nothing rendered
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
    splitter: WindowSplitter | None = None
    samples: list[Sample] = field(default_factory=list)
    idle: list[tuple[float, float]] = field(default_factory=list)
    before: Conditions = field(default_factory=dict)
    after: Conditions = field(default_factory=dict)
    sampler_cpu_share: float = 0.0
    notes: list[str] = field(default_factory=list)
    void: str | None = None
    environment: bool = False

    def make_void(self, reason: str, environment: bool) -> None:
        """Keeps the first reason."""
        if self.void is None:
            self.void, self.environment = reason, environment
