"""What RAPL says turned into what the battery gives: P_battery = a + b P_rapl, with its errors and its limits."""

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any, Self

import numpy as np
from pydantic import AwareDatetime, BaseModel, ConfigDict, ValidationError

from joulebox_agent.estimates.estimate import Interval, t_quantile
from joulebox_agent.estimates.stage_power import FitError

FEWEST_PAIRS = 5
LONGEST_AGE = timedelta(days=30)
TEMPERATURE_TOLERANCE_C = 10.0
BRIGHTNESS_TOLERANCE = 0.02  # of full brightness
OUTSIDE = 0.1  # of the calibrated span of RAPL power, beyond which the line is not trusted


class Calibration(BaseModel):
    """A line through pairs of mean powers, each pair over one and the same stretch of time.

    a_w, b         P_battery = a_w + b P_rapl [W, 1]
    covariance     of (a_w, b)
    residual_w     standard deviation of a stretch's mean about the line
    mean_rapl_w, lowest_rapl_w, highest_rapl_w    where the pairs lay
    made_at        wall time, ISO 8601 with its zone
    temperature_c, brightness    the machine's state then (share of full brightness); None where unknown
    device         whose it is
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    a_w: float
    b: float
    covariance: tuple[tuple[float, float], tuple[float, float]]
    residual_w: float
    pair_count: int
    lowest_rapl_w: float
    highest_rapl_w: float
    made_at: AwareDatetime
    temperature_c: float | None
    brightness: float | None
    device: str

    @classmethod
    def fit(
        cls,
        battery_w: Sequence[float],
        rapl_w: Sequence[float],
        made_at: datetime,
        conditions: Mapping[str, object],
        device: str,
    ) -> Self:
        """Least squares over pairs of windows (idle among them, so that the span is wide).

        conditions  as read_conditions gives them; temperature_c and brightness_share are kept
        Raises FitError for fewer than 5 pairs, powers that are not finite and above 0, RAPL powers that hardly
        differ, or a slope that is not above 0.
        """
        y, x = np.array(battery_w, dtype=float), np.array(rapl_w, dtype=float)
        if y.size != x.size or x.size < FEWEST_PAIRS:
            raise FitError(f"A calibration needs {FEWEST_PAIRS} pairs of battery and RAPL power; there are {x.size}.")
        if not (np.isfinite(x).all() and np.isfinite(y).all() and x.min() > 0 and y.min() > 0):
            raise FitError("A calibration needs powers that are finite and above 0 W.")
        if np.ptp(x) < 0.1 * x.mean():
            raise FitError(
                f"RAPL lay between {x.min():.3g} and {x.max():.3g} W: a calibration needs idle and busy stretches."
            )
        design = np.column_stack([np.ones_like(x), x])
        inverse = np.linalg.inv(design.T @ design)
        a_w, b = inverse @ design.T @ y
        variance = float(((y - a_w - b * x) ** 2).sum()) / (x.size - 2)
        if b <= 0:
            raise FitError(f"The battery's power falls when RAPL's rises ({b:.2g} W per W): one of them is wrong.")
        (aa, ab), (_, bb) = (inverse * variance).tolist()
        return cls(
            a_w=float(a_w), b=float(b), covariance=((aa, ab), (ab, bb)), residual_w=variance**0.5,
            pair_count=int(x.size), lowest_rapl_w=float(x.min()), highest_rapl_w=float(x.max()), made_at=made_at,
            temperature_c=_number(conditions.get("temperature_c")),
            brightness=_number(conditions.get("brightness_share")), device=device,
        )  # fmt: skip

    def battery_w(self, rapl_w: float) -> Interval:
        """Battery power [W] of a stretch with this mean RAPL power; the interval is that of one metered stretch.

        Raises FitError beyond the calibrated span.
        """
        slack_w = OUTSIDE * (self.highest_rapl_w - self.lowest_rapl_w)
        if not self.lowest_rapl_w - slack_w <= rapl_w <= self.highest_rapl_w + slack_w:
            raise FitError(
                f"RAPL's {rapl_w:.3g} W lie outside what was calibrated, "
                f"{self.lowest_rapl_w:.3g} to {self.highest_rapl_w:.3g} W; calibrate again."
            )
        row = np.array([1.0, rapl_w])
        variance = float(row @ np.array(self.covariance) @ row) + self.residual_w**2
        value = self.a_w + self.b * rapl_w
        half = t_quantile(self.pair_count - 2) * variance**0.5
        return Interval(value=value, low=max(0.0, value - half), high=value + half)

    def valid_reason(self, now: datetime, conditions: Mapping[str, object], device: str | None = None) -> str | None:
        """Why it may not be used now, or None. What is unknown on one side only counts as changed."""
        if device is not None and device != self.device:
            return f"the calibration is {self.device}'s, not {device}'s"
        age = now - self.made_at
        if age > LONGEST_AGE:
            return f"the calibration is {age.days} days old, {LONGEST_AGE.days} are allowed"
        if age < timedelta(0):
            return f"the calibration was made in the future ({self.made_at.isoformat()}); check the clock"
        temperature_c = _number(conditions.get("temperature_c"))
        if _moved(self.temperature_c, temperature_c, TEMPERATURE_TOLERANCE_C):
            return f"the temperature was {_told(self.temperature_c, ' °C')} and is {_told(temperature_c, ' °C')}"
        brightness = _number(conditions.get("brightness_share"))
        if _moved(self.brightness, brightness, BRIGHTNESS_TOLERANCE):
            return f"the brightness was {_told(self.brightness, ' of full')} and is {_told(brightness, ' of full')}"
        return None

    def words(self) -> str:
        """The line with its standard errors, in one phrase."""
        a_w, b = (self.covariance[i][i] ** 0.5 for i in (0, 1))
        return (
            f"P_battery = {self.a_w:.3g} ± {a_w:.1g} W + {self.b:.3g} ± {b:.1g} P_rapl, "
            f"from {self.pair_count} stretches of {self.lowest_rapl_w:.3g} to {self.highest_rapl_w:.3g} W"
        )

    def to_json(self) -> dict[str, Any]:
        return self.model_dump(mode="json")

    @classmethod
    def from_json(cls, document: object) -> Self:
        """Raises FitError naming the first field that is wrong."""
        try:
            return cls.model_validate(document)
        except ValidationError as error:
            first = error.errors()[0]
            raise FitError(f"Stored calibration: {'.'.join(map(str, first['loc']))}: {first['msg']}.") from None


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _moved(then: float | None, now: float | None, tolerance: float) -> bool:
    if then is None or now is None:
        return then is not now
    return abs(now - then) > tolerance


def _told(value: float | None, unit: str) -> str:
    return "unknown" if value is None else f"{value:.3g}{unit}"
