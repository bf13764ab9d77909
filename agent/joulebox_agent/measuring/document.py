"""The measure document: what `measure --json` prints and what a device sends to the server."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from joulebox_agent.conditions import Conditions
from joulebox_agent.estimates.estimate import CONFIDENCE, Interval
from joulebox_agent.sources.reading import Quality


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RendererBuild(_Part):
    name: str
    version: str
    intersector: str
    isa: str
    threads: int


class EnergyPerImage(_Part):
    """gross: the source's own reading; net: above idle, only when idle was measured; counter: the battery's
    energy counter over the same windows, as a cross-check. None is unknown, never zero."""

    gross: Interval | None
    net: Interval | None
    counter: Interval | None

    def within(self, scale_range: tuple[float, float] | None) -> "EnergyPerImage":
        """The same with every bound as far out as the source may be off (an estimate's stated range), by factors."""
        if scale_range is None:
            return self

        def widened(interval: Interval | None) -> Interval | None:
            if interval is None:
                return None
            ends = [bound * factor for bound in (interval.low, interval.high) for factor in scale_range]
            return Interval(value=interval.value, low=min(ends), high=max(ends))

        return EnergyPerImage(gross=widened(self.gross), net=widened(self.net), counter=widened(self.counter))


class StageEnergy(_Part):
    """Three estimates by name. `integrated` needs a source faster than a stage, `regressed` a whole sweep."""

    equation_2: float | None
    integrated: float | None = None
    regressed: float | None = None


class StageIntervals(_Part):
    """The 95 % intervals of a stage's estimates, where they have one."""

    equation_2: Interval | None = None
    integrated: Interval | None = None
    regressed: Interval | None = None


class StageRecord(_Part):
    """Per image: wall and CPU seconds, rays, joules; `specular_*`: for what is seen through mirrors and glass."""

    time_s: float
    cpu_s: float
    rays: int
    energy_j: StageEnergy
    energy_intervals_j: StageIntervals | None = None
    specular_time_s: float = 0.0
    specular_cpu_s: float = 0.0


class WindowRecord(_Part):
    """One window: start_s since sampling began, time_s of wall clock, sums over its images; its block from 1 on."""

    start_s: float
    time_s: float
    images: int
    energy_j: float | None
    cpu_s: float
    stages_s: dict[str, float]
    block: int | None = None


class VoidWindowRecord(_Part):
    """A stretch that was meant as a window and is in no number of the document."""

    start_s: float
    time_s: float
    images: int
    reason: str


class StateAround(_Part):
    before: Conditions
    after: Conditions


class MeasureDocument(_Part):
    """Everything known about one configuration on one machine. Intervals are over windows."""

    schema_version: int = Field(default=1, serialization_alias="schema", validation_alias="schema")
    scene: str
    scene_sha256: str
    settings: dict[str, Any]
    renderer: RendererBuild
    plan: dict[str, Any]
    photons: dict[str, Any]
    method: str
    quality: Quality
    scope: str
    refresh_s: float | None
    images: int
    windows: int
    window_s: float
    time_s_per_image: Interval | None
    cpu_s_per_image: Interval | None
    energy_j_per_image: EnergyPerImage
    confidence: float = CONFIDENCE
    stages: dict[str, StageRecord]
    window_data: tuple[WindowRecord, ...]
    void_windows: tuple[VoidWindowRecord, ...] = ()
    sampler_cpu_share: float | None = None
    power_samples: str | None
    conditions: StateAround
    void: str | None
    suspect: str | None = None
    noise: None = None
    pixel_sha256: str | None
    image_blob: str | None

    def to_json(self) -> dict[str, Any]:
        """The document as plain JSON values."""
        return self.model_dump(mode="json", by_alias=True)
