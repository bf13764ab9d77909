"""What the server answers with, beyond what devices send: sweeps, jobs, devices, scenes, results, problems."""

from typing import Any, Literal

from pydantic import ConfigDict, Field

from joulebox_server.schemas.base import Document
from joulebox_server.schemas.device import EnergyMethod, Health
from joulebox_server.schemas.sweep import SweepDefinition

Purpose = Literal["measure", "reference", "noise_floor", "control"]
JobState = Literal["queued", "leased", "done", "failed", "cancelled"]
SweepState = Literal["running", "paused", "cancelled", "done", "failed"]
Next = str | None
"""The cursor of the next page, null at the end."""


class FieldProblem(Document):
    field: str
    message: str


class Problem(Document):
    """An error, as RFC 9457 has it."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    request_id: str
    errors: list[FieldProblem]


class JobCounts(Document):
    total: int
    queued: int
    leased: int
    done: int
    failed: int
    cancelled: int


class SweepSummary(Document):
    id: str
    name: str
    state: SweepState
    created_at: str
    jobs: JobCounts
    differences_pending: int
    scenes: list[str]
    devices: list[str]


class ControlSeries(Document):
    """The control runs of one scene on one device: each beside the first, 1.02 being 2 % more."""

    scene: str
    device: str
    time_ratios: list[float]
    energy_ratios: list[float | None]


class Sweep(SweepSummary):
    definition: SweepDefinition
    controls: list[ControlSeries]


class RetriedSweep(Sweep):
    retried: int


class SweepPage(Document):
    items: list[SweepSummary]
    next: Next


class PreviewJobs(Document):
    total: int
    measure: int
    reference: int
    noise_floor: int
    control: int
    metered: int


class LowHigh(Document):
    low: float
    high: float


class Preview(Document):
    """What a sweep would take: `time_s` of one device, `energy_j` and `battery_charges` of all together."""

    configurations: int
    jobs: PreviewJobs
    devices: int
    time_s: LowHigh
    power_w: float | None
    energy_j: float | None
    battery_charges: float | None
    battery_full_j: float | None


class Job(Document):
    id: str
    scene: str
    device: str | None
    purpose: Purpose
    configuration_id: str
    settings: dict[str, Any]
    repeat: int
    metered: bool
    state: JobState
    attempts: int
    reason: str | None


class JobPage(Document):
    items: list[Job]
    next: Next


class KnownRenderer(Document):
    name: str
    version: str


class KnownCapabilities(Document):
    platform: str
    machine: str
    os: str
    cores: int
    isa: str | None
    agent_version: str
    energy_methods: list[EnergyMethod]
    renderer: KnownRenderer | None


class Flag(Document):
    """Something about a device that an operator should look at."""

    code: Literal["other_build", "suspect", "pictures_disagree"]
    message: str


class Device(Document):
    id: str
    name: str
    health: Health
    health_reason: str | None
    failures_in_row: int
    created_at: str
    last_seen_at: str
    last_seen_age_s: float
    leased_jobs: int
    capabilities: KnownCapabilities | None
    disagreements: int
    flags: list[Flag]


class DevicePage(Document):
    items: list[Device]
    next: Next


class Disagreement(Document):
    """Two pictures that should be alike: to the bit inside a class, p99_jnd below 1 across classes."""

    id: str
    device: str
    other_device: str
    scene: str
    settings: dict[str, Any]
    same_class: bool
    render_class: str
    other_render_class: str
    p99_jnd: float | None
    pixel_sha256: str
    other_pixel_sha256: str
    image_sha256: str | None
    other_image_sha256: str | None
    result_id: str
    other_result_id: str


class DisagreementPage(Document):
    items: list[Disagreement]
    next: Next


class DeviceId(Document):
    device_id: str


class Scene(Document):
    name: str
    bundle_sha256: str
    created_at: str


class ScenePage(Document):
    items: list[Scene]
    next: Next


class SceneBundle(Document):
    name: str
    bundle_sha256: str


class StoredBlob(Document):
    sha256: str


class Accepted(Document):
    accepted: Literal["ok", "late"]


class ResultRow(Document):
    """A result with one unit a column; `settings` is JSON text, as in the other formats."""

    id: str
    sweep_id: str
    job_id: str
    scene: str
    device: str
    purpose: Purpose
    configuration_id: str
    repeat: int
    seed: int
    method: str
    quality: str
    accepted: Literal["ok", "late"]
    void: str | None
    images: int
    windows: int
    time_s: float | None
    time_low_s: float | None
    time_high_s: float | None
    cpu_s: float | None
    energy_j: float | None
    energy_low_j: float | None
    energy_high_j: float | None
    difference: float | None
    pixel_sha256: str | None
    image_sha256: str | None
    received_at: str
    settings: str


class ResultPage(Document):
    items: list[ResultRow]
    next: Next


class DifferenceDocument(Document):
    """What `joulebox diff --json` prints, of two stored pictures."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    metric: str
    version: int
    value: float
    reference_sha256: str
    test_sha256: str
    delta_sha256: str


class DifferenceVersions(Document):
    items: list[DifferenceDocument]


class Recomputed(Document):
    metric: str
    version: int
    asked: int
    kept: int


class Confirmed(Document):
    """What was queued to confirm a recommendation; `proposals` as the recommendation itself states them."""

    queued_jobs: int
    proposals: list[dict[str, Any]]


class Alive(Document):
    status: Literal["ok"]
    version: str


class Ready(Document):
    status: Literal["ok"]
    free_bytes: int = Field(ge=0)
