"""The documents that the analysis hands out: trade-off points and recommendations.

Frozen, and nothing but what is listed here gets in or out. Costs and stages are per image.
"""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from joulebox_server.analysis.difference import METRIC, VERSION
from joulebox_server.analysis.intervals import Interval

Axis = Literal["energy_j", "time_s"]
Quality = Literal["measured", "estimated", "replayed", "none"]
EnergyQuality = Literal["measured", "estimated", "replayed", "time_only"]
SeedPolicy = Literal["same", "other"]
Basis = Literal["measured", "predicted"]

UNITS: Mapping[Axis, str] = {"energy_j": "J", "time_s": "s"}


class Document(BaseModel):
    """Base of every document."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class StageCost(Document):
    """Cost of one stage per image: wall time [s], and energy [J] where it is known."""

    time_s: float
    energy_j: float | None = None


class Step(Document):
    """One setting changed to its next value, everything else the same.

    cost_ratio      cost after over cost before; null where either is not known
    slope           d ln difference / d ln cost: -2 halves the difference for 41 % more cost; null without both
    cliff           the difference grows threefold or more, to beyond the limit
    same_picture    not a pixel changed: the scene has no use for the setting
    """

    setting: str
    start: Any
    end: Any
    cost_ratio: float | None
    difference_start: float | None
    difference_end: float | None
    slope: float | None
    cliff: bool
    same_picture: bool


class Rating(Document):
    """What a setting costs and what it does to the picture, by the rules of `ratings`; steps in rising order."""

    setting: str
    energy_impact: Literal["low", "medium", "high"]
    elasticity: float
    image_sensitivity: Literal["low", "medium", "high"]
    steps: list[Step]
    cliffs: list[Step]


class OpinionMeans(Document):
    """Second opinions, means over the repeats; see `opinions.Opinions`."""

    flip_mean: float
    ssim: float
    rmse_srgb: float
    relmse: float


class OnFront(Document):
    """Whether a point is Pareto-optimal by its values, for each cost against the difference."""

    energy_j: bool
    time_s: bool


class Point(Document):
    """One configuration: what it costs and what it does to the picture.

    changed     settings that differ from the reference's, the seed aside
    repeats     behind the difference; behind the costs where there is no difference
    difference  to the reference, mean over repeats; null where there is no picture to compare. One repeat has
                the scatter that the other points show; where they show none its interval has no width
    acceptable  difference (its value) <= limit
    fragile     the cliff that is one step of a setting away, in words; null where there is none
    confirmed   whether being on or off the front of the main cost (energy, or time where there is none)
                would hold wherever in their intervals the values are; never with one repeat
    left_out    stages and maps that did not run, and the renderer's reason for each
    quality     what the energy rests on
    """

    configuration_id: str
    label: str
    settings: dict[str, Any]
    changed: dict[str, Any]
    energy_j: Interval | None
    time_s: Interval
    cpu_s: Interval
    difference: Interval | None
    difference_per_pixel: Interval | None
    repeats: int
    acceptable: bool | None
    on_front: OnFront
    confirmed: bool
    image_sha256: str | None
    reference_image_sha256: str | None
    pixel_sha256: str | None
    stages: dict[str, StageCost]
    left_out: dict[str, str] = {}
    opinions: OpinionMeans | None
    quality: Quality
    fragile: str | None = None

    def cost(self, axis: Axis) -> Interval | None:
        """Energy [J] or time [s] of an image."""
        return self.energy_j if axis == "energy_j" else self.time_s


class Shared(Document):
    """What the intervals of all points have in common: by what share of their values they may be off together.

    A session's drift, a seed's luck. It matters to a budget and a limit, which are absolute, and not to which of
    two points is better.
    """

    energy_share: float = 0.0
    time_share: float = 0.0
    difference_share: float = 0.0

    def of(self, axis: Axis) -> float:
        """Of a cost."""
        return self.energy_share if axis == "energy_j" else self.time_share


class NoiseFloor(Document):
    """The reference against itself at another seed; too noisy to judge by above 10 % of the limit."""

    value: float
    share_of_limit: float
    too_noisy: bool


class Tradeoff(Document):
    """Cost against difference, for one scene on one device of a sweep."""

    sweep_id: str
    scene: str
    device: str
    scenes: list[str]
    devices: list[str]
    energy_quality: EnergyQuality
    limit: float
    limit_per_pixel: float
    width: int
    height: int
    exposure: float
    seed_policy: SeedPolicy
    metric: str = METRIC
    metric_version: int = VERSION
    confidence: float
    noise_floor: NoiseFloor | None
    reference: Point | None
    points: list[Point]
    axes: list[str]
    shared: Shared = Shared()
    ratings: list[Rating] = []

    @property
    def main_axis(self) -> Axis:
        """Energy where any is known, else time."""
        return "time_s" if self.energy_quality == "time_only" else "energy_j"


class Choice(Document):
    """A configuration that a recommendation names.

    configuration_id    null for one that was never measured
    basis               whether it was measured, or predicted from others that were
    difference          with `energy_j` and `time_s` as they bound the choice
    stages_left_out     stages and maps that do not run with these settings on this scene, and why
    saves_*             of the reference's cost per image; null without a reference
    fragile             why its difference may not stay within the limit, null where nothing speaks for that
    misses              why it does not fit, only on the nearest of a recommendation without an answer
    """

    configuration_id: str | None
    label: str
    basis: Basis = "measured"
    settings: dict[str, Any]
    changed: dict[str, Any]
    energy_j: Interval | None
    time_s: Interval | None
    difference: Interval
    stages_left_out: dict[str, str] = {}
    saves_j: float | None
    saves_s: float | None
    saves_share: float | None
    fragile: str | None
    misses: str | None = None


class Recommendation(Document):
    """Settings for a budget and a limit, or that there are none.

    answer          "settings", or "none" when no configuration fits; then see `nearest`
    basis           "predicted" where these settings were never measured
    saves_share     of the reference's energy, or of its time where the budget is in seconds
    steps           what changing one setting would do, as measured: the slopes at this budget
    proposals       settings worth measuring, by the improvement to be expected: never measured, or too loosely to know
    """

    answer: Literal["settings", "none"]
    basis: Basis = "measured"
    energy_quality: EnergyQuality
    scene: str
    device: str
    confidence: float
    configuration_id: str | None = None
    label: str | None = None
    settings: dict[str, Any] | None = None
    changed: dict[str, Any] | None = None
    energy_j: Interval | None = None
    time_s: Interval | None = None
    difference: Interval | None = None
    stages_left_out: dict[str, str] = {}
    limit: float
    budget_j: float | None
    budget_s: float | None
    saves_j: float | None = None
    saves_s: float | None = None
    saves_share: float | None = None
    fragile: str | None = None
    why: list[str]
    steps: list[Step] = []
    runner_up: Choice | None = None
    nearest: list[Choice] = []
    proposals: list[Choice] = []
