"""Documents about devices: enrolment, what they can do, leases."""

from typing import Any, Literal

from pydantic import Field, JsonValue

from joulebox_server.schemas.base import Document, Name, Sha256

Health = Literal["good", "suspect", "maintenance", "retired"]


class EnrollmentRequest(Document):
    name: Name | None = None


class EnrollmentDocument(Document):
    code: str
    expires_at: str
    join: str
    """One line for the device's shell: install, enrol, look at the energy sources."""


class DeviceRequest(Document):
    code: str = Field(min_length=1, max_length=500)
    name: Name
    boot_id: str = Field(min_length=1, max_length=200)


class DeviceToken(Document):
    device_id: str
    token: str


class HealthRequest(Document):
    health: Health


class EnergyMethod(Document):
    method: str = Field(min_length=1, max_length=50)
    available: bool
    scope: str | None = Field(default=None, max_length=2000)
    reason: str | None = Field(default=None, max_length=2000)


class RendererInfo(Document):
    name: str = Field(min_length=1, max_length=100)
    version: str = Field(min_length=1, max_length=100)
    settings_schema: dict[str, JsonValue] | None = None


class Capabilities(Document):
    """What a device is and can do, told by its agent at each start."""

    platform: str = Field(max_length=500)
    machine: str = Field(max_length=100)
    os: str = Field(max_length=100)
    cores: int = Field(ge=1)
    isa: str | None = Field(default=None, max_length=100)
    agent_version: str = Field(max_length=100)
    energy_methods: list[EnergyMethod] = Field(default_factory=list, max_length=100)
    renderer: RendererInfo | None = None


class LeaseRequest(Document):
    boot_id: str = Field(min_length=1, max_length=200)
    conditions: dict[str, JsonValue] = Field(default_factory=dict)
    max_jobs: int = Field(default=1, ge=1, le=20)
    wait_s: float = Field(default=0, ge=0, le=30)
    holding: list[str] | None = Field(default=None, max_length=100)
    """Attempts that the device works on; any other of its own is lost. None: it does not say."""


class ReleaseRequest(Document):
    reason: str = Field(min_length=1, max_length=2000)
    failed: bool = False


class LeasedScene(Document):
    name: str
    bundle_sha256: Sha256


class LeasedMeasure(Document):
    """How long to measure: windows of `window_s`, between `min_windows` and `max_windows` of them."""

    window_s: float
    min_windows: int
    max_windows: int
    half_width: float
    max_seconds: float
    meter: bool


class Lease(Document):
    """One job handed to a device until `expires_at`."""

    attempt_id: str
    job_id: str
    sweep_id: str
    purpose: Literal["measure", "reference", "noise_floor"]
    expires_at: str
    scene: LeasedScene
    defines: dict[str, str]
    settings: dict[str, Any]
    measure: LeasedMeasure


class Leases(Document):
    leases: list[Lease]
