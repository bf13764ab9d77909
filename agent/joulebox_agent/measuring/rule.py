"""How long to measure: what the user or a lease asks for, validated once."""

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from joulebox_agent.errors import UsageError
from joulebox_agent.estimates.energies import ADVISED_REFRESHES

LONG_WINDOW_S = 60.0  # whoever asks for less wants short windows, and is told what they are worth
LONGEST_TIMED_S = 1.0  # a picture that takes as long is timed well by one
SLOWEST_REFRESH_S = 30.0  # of a gauge that has not been seen to refresh yet


class MeasureRule(BaseModel):
    """Windows of repeated images.

    window_s       shortest window [s]; it ends at the first image that ends later. From a minute on a window
                   also holds 15 refreshes of the gauge, as measured
    min_windows    the pilot
    max_windows    never more than this, whatever the half-width asks for
    half_width     wanted half-width of the 95 % interval as a share of the mean
    max_seconds    time limit from the renderer's `ready` [s]
    meter          False: time and CPU seconds alone, of one image, and of as many more as begin within a second,
                   or within `window_s` where that is shorter
    idle_s         idle power is measured this long before and after [s]; 0: net energy stays unknown
    silence_s      longest silence of the renderer before it counts as hung [s]
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    window_s: Annotated[float, Field(gt=0, le=3600)] = 60.0
    min_windows: Annotated[int, Field(ge=1, le=1000)] = 5
    max_windows: Annotated[int, Field(ge=1, le=1000)] = 20
    half_width: Annotated[float, Field(gt=0, lt=1)] = 0.05
    max_seconds: Annotated[float, Field(gt=0, le=86_400)] = 900.0
    meter: bool = True
    idle_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    silence_s: Annotated[float, Field(gt=0, le=86_400)] = 600.0

    @property
    def refreshes_a_window(self) -> int:
        """Refreshes of the gauge that a window must hold; 0 where short windows were asked for."""
        return ADVISED_REFRESHES if self.window_s >= LONG_WINDOW_S else 0

    @property
    def timed_s(self) -> float:
        """Without a meter no image begins later than this after the first [s]."""
        return min(self.window_s, LONGEST_TIMED_S)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_windows > self.max_windows:
            raise ValueError(f"min_windows {self.min_windows} is more than max_windows {self.max_windows}")
        return self


def make_rule(**values: object) -> MeasureRule:
    """A MeasureRule, or UsageError that names the field and what would be right."""
    try:
        return MeasureRule.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = "--" + str(first["loc"][0]).replace("_", "-") if first["loc"] else "The windows"
        raise UsageError(f"{name}: {first['msg']}.") from None
