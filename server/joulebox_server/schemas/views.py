"""What the dashboard's own questions are answered with."""

from typing import Any

from joulebox_server.schemas.answers import Next, SweepState
from joulebox_server.schemas.base import Document, Interval


class Battery(Document):
    """As told with the last result; None where the system does not say."""

    charge_share: float | None
    full_j: float | None
    on_mains: bool | None


class Meter(Document):
    """How the energy of the last result was known.

    refresh_s           how often the source gives a new reading
    half_width_share    half of the energy's 95 % interval over its value: what the meter resolved
    """

    method: str
    scope: str | None
    quality: str
    refresh_s: float | None
    half_width_share: float | None


class ControlRun(Document):
    """The last run of a sweep's first configuration beside its first one: 1.02 is 2 % more."""

    sweep_id: str
    scene: str
    time_ratio: float
    energy_ratio: float | None
    at: str


class DeviceState(Document):
    device: str
    result_at: str | None
    battery: Battery | None
    meter: Meter | None
    control: ControlRun | None


class FleetPage(Document):
    items: list[DeviceState]
    next: Next


class Progress(Document):
    """`remaining_s` with a 95 % range; null where it cannot be told, and `reason` says why."""

    sweep_id: str
    state: SweepState
    started_at: str | None
    last_result_at: str | None
    remaining_s: Interval | None
    reason: str | None


class ReadSweep(Document):
    """A pasted file as a definition, not yet checked; `notes` say what was understood otherwise than written."""

    definition: dict[str, Any]
    notes: list[str]
