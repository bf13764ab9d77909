"""What every energy source looks like to the rest of the agent."""

from dataclasses import dataclass
from typing import Literal, Protocol

from pydantic import BaseModel, ConfigDict

Quality = Literal["measured", "estimated", "replayed", "none"]
Primary = Literal["power", "counter"]


@dataclass(frozen=True)
class Reading:
    """One look at a source.

    power_w    drawn now [W], a magnitude; None when the gauge did not say
    counter_j  energy used since the source was opened [J], never decreasing within one epoch; None if unknown
    epoch      grows when the counter lost its thread (a possible second wrap, a pack pulled out): a
               difference across two epochs means nothing
    raw        the numbers as the kernel gave them; a changed `raw` is one *update* of the gauge
    problem    why this one sample is void (it does not end the measurement), or None
    refusal    why no measurement is possible any more (mains appeared, not discharging), or None
    """

    power_w: float | None = None
    counter_j: float | None = None
    epoch: int = 0
    raw: tuple[int | float, ...] = ()
    problem: str | None = None
    refusal: str | None = None


class SourceReport(BaseModel):
    """One line of `doctor`: can this source be read here, from which files, and if not, what helps.

    resolution_j        the step that its energy moves in [J], None where it has no noticeable one
    refresh_s           time between updates as measured, None unless it was watched
    window_s_for_5_percent  length of window [s] that a half-width of 5 % needs at the power seen; see `doctor`
    cpu_share           share of one core that reading it at its own pace takes
    scale_range         (low, high) factors by which all it says may be off; None for measurements
    this_platform       False for the sources of other platforms
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: str
    scope: str
    available: bool
    power_w: float | None = None
    refresh_s: float | None = None
    resolution_j: float | None = None
    window_s_for_5_percent: float | None = None
    cpu_share: float | None = None
    scale_range: tuple[float, float] | None = None
    this_platform: bool = True
    files: tuple[str, ...] = ()
    reason: str = ""
    remedy: str = ""


class EnergySource(Protocol):
    """A place joules or watts can be read from.

    method        name in every record: battery_gauge, battery_counter, rapl, hwmon, exec, battery_percent,
                  estimate_cpu_time, replay, none
    scope         what the energy covers: whole machine, CPU package, whole platform, replayed, none, or as stated
    quality       what a record made with it may be called
    primary       which of `power_w` and `counter_j` gives the gross energy
    poll_s        a modest polling interval [s], well under the gauge's refresh
    """

    @property
    def method(self) -> str: ...
    @property
    def scope(self) -> str: ...
    @property
    def quality(self) -> Quality: ...
    @property
    def primary(self) -> Primary: ...
    @property
    def poll_s(self) -> float: ...

    def report(self) -> SourceReport:
        """Whether and how this source can be read at this moment."""

    def read(self) -> Reading:
        """One look; never raises for what a sensor does (that is `problem` or `refusal`)."""
