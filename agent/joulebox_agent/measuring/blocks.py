"""In which order configurations are measured, and whether the device stayed the same meanwhile.

Randomised blocks hold one window of every configuration, so that a drift of the device falls on all alike; the
control configuration is in every block and tells whether there was one.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from random import Random
from typing import Literal

import numpy as np

from joulebox_agent.estimates.estimate import Interval, t_quantile
from joulebox_agent.measuring.recording import Recording

Order = Literal["blocks", "sequence"]
FALSE_ALARM = 0.05  # chance that a device that does not drift is flagged in one run


@dataclass(frozen=True)
class Course:
    """How a session goes about its configurations.

    order      blocks: randomised, one window of each a block; sequence: one configuration after the other
    control    index of the configuration that is in every block
    cool_to_c  wait for this temperature before every visit
    """

    order: Order = "sequence"
    seed: int = 0
    control: int = 0
    cool_to_c: float | None = None


def shuffled(members: Iterable[int], seed: int, block: int) -> list[int]:
    """The members in the order of this block; the same for the same seed."""
    order = sorted(members)
    Random(f"{seed} {block}").shuffle(order)
    return order


@dataclass(frozen=True)
class Drift:
    """The control's first window beyond what its first ones let expect; `last_good` is the one before it.

    seen, expected  in `unit` an image: "J", or "s" where no energy is known
    """

    index: int
    seen: float
    expected: Interval
    unit: str

    @property
    def last_good(self) -> int:
        return self.index - 1


def control_drift(values: Sequence[float], pilot_count: int, unit: str = "J") -> Drift | None:
    """The first control value outside the prediction interval of the pilot's values, or None.

    The interval of a single further value, mean +- t s sqrt(1 + 1/n), at a level divided by the number of
    values tested (Bonferroni), so that all of them together alarm falsely with probability `FALSE_ALARM` at
    most. None for fewer than three pilot values, which tell no spread.
    """
    pilot, later = values[:pilot_count], values[pilot_count:]
    if len(pilot) < 3 or not later:
        return None
    mean, spread = float(np.mean(pilot)), float(np.std(pilot, ddof=1))
    t = t_quantile(len(pilot) - 1, 1 - FALSE_ALARM / len(later))
    half_width = t * spread * math.sqrt(1 + 1 / len(pilot))
    for offset, value in enumerate(later):
        if abs(value - mean) > half_width:
            expected = Interval(value=mean, low=mean - half_width, high=mean + half_width)
            return Drift(len(pilot) + offset, value, expected, unit)
    return None


def mark_suspects(records: Sequence[Recording], control: int, drift: Drift, pilot_count: int) -> None:
    """Marks every recording that has windows after the control's last good one."""
    good_until_s = records[control].windows[drift.last_good].end_s
    for record in records:
        later = sum(window.end_s > good_until_s for window in record.windows)
        if later:
            record.suspect = (
                f"the control configuration drifted: {drift.seen:.4g} {drift.unit} an image where its first "
                f"{pilot_count} windows let expect {drift.expected.value:.4g} ± {drift.expected.half_width:.2g}; "
                f"{later} of {len(record.windows)} windows are later than its last good one"
            )
