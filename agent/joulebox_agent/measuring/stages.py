"""What each stage of an image costs: three estimates with names, none of which is the truth by itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from joulebox_agent.estimates.calibration import Calibration
from joulebox_agent.estimates.energies import integrated_stage_energies
from joulebox_agent.estimates.estimate import Interval, two_stage_interval
from joulebox_agent.estimates.stage_power import StagePowerFit
from joulebox_agent.estimates.windows import Window, stage_energies_j, stage_intervals
from joulebox_agent.measuring.document import StageEnergy, StageIntervals, StageRecord
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.reading import Primary


@dataclass(frozen=True)
class StageEvidence:
    """What the stages' joules are made from.

    windows, gross_j  the windows and the energy of each [J], None where unknown
    pilot_count       windows of the pilot, for the intervals
    least_share       least half-width of those intervals as a share of the mean
    fast, primary     the series that may resolve a stage: a companion's, else the source's own
    calibration       of a companion: what it makes of the battery
    powers            the stage powers of a sweep
    """

    windows: Sequence[Window]
    gross_j: Sequence[float | None]
    pilot_count: int
    least_share: float = 0.0
    fast: PowerSeries | None = None
    primary: Primary = "power"
    calibration: Calibration | None = None
    powers: StagePowerFit | None = None


def stage_records(evidence: StageEvidence) -> dict[str, StageRecord]:
    """Means per image over all windows; joules over the windows whose energy is known."""
    windows = evidence.windows
    images = sum(w.images for w in windows)
    names = dict.fromkeys(name for w in windows for name in w.stages)
    metered = [(w, g) for w, g in zip(windows, evidence.gross_j, strict=True) if g is not None]
    by_equation = [stage_energies_j(w, g) for w, g in metered]
    integrated = [_integrated(evidence, w, g) for w, g in metered]
    resolved = [found for found in integrated if found is not None]
    stages = {}
    for name in names:
        totals = [w.stages[name] for w in windows if name in w.stages]
        shares = _over_windows(name, by_equation, metered, evidence)
        whole = _over_windows(name, resolved, metered, evidence) if len(resolved) == len(metered) else None
        regressed = _regressed(name, evidence)
        intervals = StageIntervals(equation_2=_told(shares), integrated=_told(whole), regressed=regressed)
        stages[name] = StageRecord(
            time_s=sum(t.time_s for t in totals) / images,
            cpu_s=sum(t.cpu_s for t in totals) / images,
            rays=round(sum(t.rays for t in totals) / images),
            energy_j=StageEnergy(
                equation_2=shares[0] if shares else None,
                integrated=whole[0] if whole else None,
                regressed=regressed.value if regressed else None,
            ),
            specular_time_s=sum(t.specular_time_s for t in totals) / images,
            specular_cpu_s=sum(t.specular_cpu_s for t in totals) / images,
            energy_intervals_j=intervals if any((intervals.equation_2, intervals.integrated, regressed)) else None,
        )
    return stages


def _integrated(evidence: StageEvidence, window: Window, gross_j: float) -> Mapping[str, float] | None:
    if evidence.fast is None:
        return None
    return integrated_stage_energies(
        evidence.fast,
        stage_intervals([window]),
        gross_j,
        [(window.start_s, window.end_s)],
        evidence.primary,
        evidence.calibration,
    )


_Mean = tuple[float, Interval | None]


def _told(found: _Mean | None) -> Interval | None:
    return found[1] if found else None


def _over_windows(
    name: str, found: Sequence[Mapping[str, float]], metered: Sequence[tuple[Window, float]], evidence: StageEvidence
) -> _Mean | None:
    """Joules an image of a stage over all metered windows, with the interval over windows where there are two."""
    if not metered:
        return None
    joules = [energies.get(name, 0.0) for energies in found]
    mean = sum(joules) / sum(w.images for w, _ in metered)
    if len(metered) < 2:
        return mean, None
    values = [j / w.images for j, (w, _) in zip(joules, metered, strict=True)]
    interval = two_stage_interval(values, evidence.pilot_count, least_half=evidence.least_share * mean)
    return mean, Interval(value=mean, low=mean - interval.half_width, high=mean + interval.half_width)


def _regressed(name: str, evidence: StageEvidence) -> Interval | None:
    """Stage power of the sweep times the stage's seconds an image; the error of both in quadrature."""
    if evidence.powers is None or name not in evidence.powers.powers_w:
        return None
    power_w = evidence.powers.powers_w[name]
    seconds = [w.stages[name].time_s / w.images if name in w.stages else 0.0 for w in evidence.windows]
    mean_s = sum(w.stages[name].time_s for w in evidence.windows if name in w.stages)
    mean_s /= sum(w.images for w in evidence.windows)
    spread_s = two_stage_interval(seconds, len(seconds)).half_width if len(seconds) >= 2 else 0.0
    value = power_w.value * mean_s
    low = value - ((power_w.value - power_w.low) ** 2 * mean_s**2 + (power_w.value * spread_s) ** 2) ** 0.5
    high = value + ((power_w.high - power_w.value) ** 2 * mean_s**2 + (power_w.value * spread_s) ** 2) ** 0.5
    return Interval(value=value, low=max(0.0, low), high=high)
