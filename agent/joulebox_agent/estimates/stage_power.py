"""The power of every stage from metered windows of different mixtures, and what it makes a timed image cost.

    E_window = sum_s P_s T_s        (`regressed`)

This is what a gauge slower than a stage can still tell, and with the powers known a configuration needs to
be timed only. Source: energy.md's third estimate; Lawson and Hanson 1974 for the non-negative solution.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from joulebox_agent.errors import AgentError
from joulebox_agent.estimates import drift
from joulebox_agent.estimates.estimate import Interval, t_quantile

FEWEST_WINDOWS = 12
METHOD = "stage_power_model"
BETWEEN = "between_stages"  # time of a window outside every stage
OWN_COLUMN_SHARE = 0.02  # of the windows' time, from which on the time between stages has a power of its own
WITHOUT_DRIFT = 0.5  # a sweep takes most of an hour: drift is as likely as not
DEPENDENT = 1e-6
SPARE_WINDOWS = 3  # degrees of freedom that errors need at the least


class FitError(AgentError):
    """Stage powers or a calibration cannot be had from these data; the text says what is missing."""


@dataclass(frozen=True)
class WindowTotals:
    """One metered window: its length, the time in every stage, its energy, and when it began.

    start_s  [s] on any axis common to the windows; None: they followed each other without a pause
    """

    time_s: float
    stages_s: Mapping[str, float]
    energy_j: float
    start_s: float | None = None


class StagePowerFit(BaseModel):
    """Powers [W] by stage with 95 % intervals, and what is needed to price with them.

    stages                the order of `covariance` [W^2]; a stage held at 0 W by non-negativity has its row of zeros
    residual_w            standard deviation of a window's mean power about the fit
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    stages: tuple[str, ...]
    powers_w: dict[str, Interval]
    covariance: tuple[tuple[float, ...], ...]
    residual_w: float
    window_count: int
    degrees_of_freedom: int

    def price(self, stages_s: Mapping[str, float], time_s: float) -> Interval:
        """Energy [J] of a configuration that spends stages_s [s] in its stages during time_s [s].

        The interval is that of a metered window of this configuration, so its residual is in it; bounds are
        never below 0. Raises FitError for a stage whose power was not fitted.
        """
        unknown = sorted(name for name, spent_s in stages_s.items() if spent_s > 0 and name not in self.powers_w)
        if unknown:
            raise FitError(
                f"The stage powers know {', '.join(self.powers_w)} and not {', '.join(unknown)}; "
                "meter windows that run it."
            )
        if not time_s > 0:
            raise FitError(f"A configuration to price needs a time above 0 s, not {time_s:g} s.")
        row = np.array(_row(stages_s, time_s, self.stages))
        value = float(row @ [self.powers_w[name].value for name in self.stages])
        variance = float(row @ np.array(self.covariance) @ row) + (self.residual_w * time_s) ** 2
        half = t_quantile(self.degrees_of_freedom) * variance**0.5
        return Interval(value=value, low=max(0.0, value - half), high=value + half)

    def to_json(self) -> dict[str, Any]:
        return self.model_dump(mode="json")

    @classmethod
    def from_json(cls, document: object) -> "StagePowerFit":
        """Raises FitError naming the first field that is wrong."""
        try:
            return cls.model_validate(document)
        except ValidationError as error:
            first = error.errors()[0]
            raise FitError(f"Stored stage powers: {'.'.join(map(str, first['loc']))}: {first['msg']}.") from None


def fit_stage_powers(windows: Sequence[WindowTotals]) -> StagePowerFit:
    """Non-negative least squares of the windows' mean powers on the shares of time of their stages.

    Standard errors allow for noise that drifts from window to window (see drift.py). The time between stages
    has a power of its own where the windows can tell it, else the stages share it. Raises FitError in one
    sentence when windows are fewer than 12, not finite, or do not tell the stages apart (it says which).
    """
    _check(windows)
    names = tuple(dict.fromkeys(name for w in windows for name, spent_s in w.stages_s.items() if spent_s > 0))
    total_s = sum(w.time_s for w in windows)
    between_s = total_s - sum(sum(w.stages_s.values()) for w in windows)
    if not names or between_s > OWN_COLUMN_SHARE * total_s:
        try:
            return _fit(windows, (*names, BETWEEN))
        except FitError:
            if not names:
                raise
    return _fit(windows, names)


def _fit(windows: Sequence[WindowTotals], stages: tuple[str, ...]) -> StagePowerFit:
    """The fit with these columns, the time between stages in one of them or shared."""
    needed = max(FEWEST_WINDOWS, len(stages) + SPARE_WINDOWS)
    if len(windows) < needed:
        raise FitError(f"Stage powers of {len(stages)} stages need {needed} metered windows; there are {len(windows)}.")
    lengths_s = np.array([w.time_s for w in windows])
    design = np.array([_row(w.stages_s, w.time_s, stages) for w in windows]) / lengths_s[:, None]
    power_w = np.array([w.energy_j for w in windows]) / lengths_s
    _check_rank(design, stages)
    starts_s = _starts(windows, lengths_s)
    whole = drift.fit(design, power_w, starts_s, lengths_s, WITHOUT_DRIFT)
    _check_told_apart(whole, stages, power_w)
    positive = _positive(np.tensordot(whole.weights, whole.ratios, 1), design, power_w)
    free = drift.fit(design[:, positive], power_w, starts_s, lengths_s, WITHOUT_DRIFT)
    return _assembled(stages, positive, whole, free, len(windows))


def _check(windows: Sequence[WindowTotals]) -> None:
    for number, window in enumerate(windows, start=1):
        values = [window.time_s, window.energy_j, *window.stages_s.values()]
        if not all(np.isfinite(values)) or window.time_s <= 0 or min(values) < 0:
            raise FitError(f"Window {number} of the fit needs finite times above 0 s and energies, not {window}.")
        if sum(window.stages_s.values()) > 1.01 * window.time_s:
            raise FitError(
                f"Window {number} of the fit spends {sum(window.stages_s.values()):.4g} s in its stages, "
                f"more than its {window.time_s:.4g} s; stages must not overlap."
            )


def _row(stages_s: Mapping[str, float], time_s: float, stages: tuple[str, ...]) -> list[float]:
    """Seconds in every column; without a column of its own the time between stages is shared by the stages."""
    inside_s = sum(stages_s.values())
    if BETWEEN in stages:
        return [max(0.0, time_s - inside_s) if name == BETWEEN else stages_s.get(name, 0.0) for name in stages]
    factor = time_s / inside_s if inside_s > 0 else 0.0
    return [factor * stages_s.get(name, 0.0) for name in stages]


def _starts(windows: Sequence[WindowTotals], lengths_s: drift.Floats) -> drift.Floats:
    given = [w.start_s for w in windows if w.start_s is not None]
    if len(given) < len(windows):
        return np.concatenate([[0.0], np.cumsum(lengths_s)[:-1]])
    return np.array(given)


def _check_rank(design: drift.Floats, stages: tuple[str, ...]) -> None:
    """Columns that are combinations of each other cannot be fitted at all."""
    scaled = design / np.linalg.norm(design, axis=0)
    _, singular, vectors = np.linalg.svd(scaled, full_matrices=False)
    dependent = vectors[singular < DEPENDENT * singular[0]]
    if len(dependent):
        raise _not_told_apart(np.linalg.norm(dependent, axis=0), stages)


def _check_told_apart(fit: drift.LinearFit, stages: tuple[str, ...], power_w: drift.Floats) -> None:
    """A power whose half-width exceeds the whole machine's is no answer."""
    half_w = t_quantile(fit.degrees_of_freedom) * np.sqrt(np.diag(fit.covariance))
    if half_w.max() > power_w.mean():
        _, vectors = np.linalg.eigh(fit.covariance)
        raise _not_told_apart(vectors[:, -1], stages)


def _not_told_apart(direction: drift.Floats, stages: tuple[str, ...]) -> FitError:
    mixed = [name for name, part in zip(stages, direction, strict=True) if abs(part) > 0.2 * np.abs(direction).max()]
    subject = f"The stages {', '.join(mixed)}" if len(mixed) > 1 else f"The stage {mixed[0]}"
    return FitError(
        f"{subject} cannot be told apart by these windows: meter configurations whose stages take different shares."
    )


def _positive(correlation: drift.Floats, design: drift.Floats, power_w: drift.Floats) -> list[int]:
    """Columns that non-negative least squares leaves above 0 W."""
    from scipy.optimize import nnls  # loads for half a second, which no other command should wait for

    root = np.linalg.cholesky(correlation)
    solution, _ = nnls(np.linalg.solve(root, design), np.linalg.solve(root, power_w))
    return [column for column, watts in enumerate(solution) if watts > 0]


def _assembled(
    stages: tuple[str, ...],
    positive: list[int],
    whole: drift.LinearFit,
    free: drift.LinearFit,
    window_count: int,
) -> StagePowerFit:
    quantile = t_quantile(free.degrees_of_freedom)
    covariance = np.zeros((len(stages), len(stages)))
    covariance[np.ix_(positive, positive)] = free.covariance
    powers_w: dict[str, Interval] = {}
    for column, name in enumerate(stages):
        if column in positive:
            watts = float(free.coefficients[positive.index(column)])
            half = quantile * float(covariance[column, column]) ** 0.5
            powers_w[name] = Interval(value=watts, low=max(0.0, watts - half), high=watts + half)
        else:  # held at 0 W: how high it could be comes from the fit without the bound
            high = whole.coefficients[column] + quantile * float(whole.covariance[column, column]) ** 0.5
            powers_w[name] = Interval(value=0.0, low=0.0, high=max(0.0, float(high)))
    return StagePowerFit(
        stages=stages,
        powers_w=powers_w,
        covariance=tuple(tuple(map(float, row)) for row in covariance),
        residual_w=free.row_variance**0.5,
        window_count=window_count,
        degrees_of_freedom=free.degrees_of_freedom,
    )
