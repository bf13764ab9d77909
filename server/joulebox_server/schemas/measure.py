"""The measure document: what `joulebox-agent measure --json` prints and a result's body is."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, JsonValue, model_validator

from joulebox_server.schemas.base import Document, Interval, Sha256, ToldSetting

LARGEST = 1e12
"""Joules or seconds; beyond it the microunits at rest would overflow."""


def _ordered(interval: Interval) -> Interval:
    if not -LARGEST <= interval.low <= interval.value <= interval.high <= LARGEST:
        raise ValueError(f"{interval.low} to {interval.high} is not an interval around {interval.value}")
    return interval


def _sensible(interval: Interval) -> Interval:
    if interval.value < 0:
        raise ValueError(f"value {interval.value} is below 0")
    return _ordered(interval)


Quantity = Annotated[Interval, AfterValidator(_sensible)]
Count = Annotated[int, Field(ge=0, le=10**12)]
Amount = Annotated[float, Field(ge=0, le=LARGEST)]
Energy = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NetQuantity = Annotated[Interval, AfterValidator(_ordered)]
"""An energy above idle: noise can take it below zero."""


class EnergyPerImage(Document):
    gross: Quantity | None = None
    net: NetQuantity | None = None
    counter: Quantity | None = None


class StageEnergy(Document):
    equation_2: Energy | None = None
    integrated: Energy | None = None
    regressed: Energy | None = None


class StageIntervals(Document):
    equation_2: NetQuantity | None = None
    integrated: NetQuantity | None = None
    regressed: NetQuantity | None = None


class Stage(Document):
    time_s: Amount
    cpu_s: Amount | None = None
    rays: float | None = Field(default=None, ge=0, le=1e18)
    energy_j: StageEnergy = StageEnergy()
    energy_intervals_j: StageIntervals | None = None
    specular_time_s: Amount = 0.0
    """Of `time_s`, on what is seen through mirrors and glass; the thesis books it under direct lighting."""
    specular_cpu_s: Amount = 0.0


class Window(Document):
    start_s: float
    time_s: Amount
    images: Count
    energy_j: Energy | None = None
    cpu_s: Amount | None = None
    stages_s: dict[str, Amount] = Field(default_factory=dict)
    block: Count | None = None


class VoidWindow(Document):
    """A stretch that was meant as a window and is in no number of the document."""

    start_s: float
    time_s: Amount
    images: Count
    reason: str


class MeasuredRenderer(Document):
    name: str
    version: str
    intersector: str | None = None
    isa: str | None = None
    threads: int | None = None


class MeasureDocument(Document):
    """One finished measurement of one configuration on one device."""

    schema_version: Literal[1] = Field(default=1, alias="schema")
    scene: str
    scene_sha256: str
    settings: dict[str, ToldSetting]
    renderer: MeasuredRenderer
    method: str = Field(min_length=1, max_length=50)
    quality: Literal["measured", "estimated", "replayed", "none"]
    scope: str | None = None
    refresh_s: float | None = None
    images: Count
    windows: Count
    window_s: Amount
    time_s_per_image: Quantity | None = None
    cpu_s_per_image: Quantity | None = None
    energy_j_per_image: EnergyPerImage = EnergyPerImage()
    confidence: float = Field(default=0.95, gt=0, lt=1)
    stages: dict[str, Stage] = Field(default_factory=dict)
    power_samples: Sha256 | None = None
    conditions: dict[str, JsonValue] = Field(default_factory=dict)
    void: str | None = Field(default=None, min_length=1)
    pixel_sha256: Sha256 | None = None
    image_blob: Sha256 | None = None
    plan: dict[str, JsonValue] | None = None
    photons: dict[str, JsonValue] | None = None
    window_data: list[Window] = Field(default_factory=list)
    void_windows: list[VoidWindow] = Field(default_factory=list)
    sampler_cpu_share: float | None = Field(default=None, ge=0)
    suspect: str | None = None
    noise: JsonValue = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        """Only what was voided may lack its costs."""
        if self.void is None:
            for field in ("time_s_per_image", "cpu_s_per_image", "pixel_sha256"):
                if getattr(self, field) is None:
                    raise ValueError(f"{field} is missing; only a document with void may leave it out")
            if not self.images:
                raise ValueError("images is 0; only a document with void may measure nothing")
        return self
