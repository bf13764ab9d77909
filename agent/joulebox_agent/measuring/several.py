"""Several configurations of one session as documents: metered ones, and timed ones priced by the stage powers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from joulebox_agent.estimates.calibration import Calibration
from joulebox_agent.estimates.energies import window_energies
from joulebox_agent.estimates.estimate import Interval, two_stage_interval
from joulebox_agent.estimates.stage_power import METHOD, FitError, StagePowerFit, WindowTotals, fit_stage_powers
from joulebox_agent.estimates.windows import Window
from joulebox_agent.measuring.blocks import Course
from joulebox_agent.measuring.document import EnergyPerImage, MeasureDocument, StageEnergy, StageIntervals
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.measuring.result import Result, build_result, usable_windows
from joulebox_agent.measuring.rule import MeasureRule
from joulebox_agent.measuring.session import Configuration, Session
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.reading import Quality


@dataclass(frozen=True)
class SeveralResults:
    """One result a configuration, None for one of which not even `ready` was seen; the fit or why there is none."""

    results: list[Result | None]
    failures: list[str | None]
    powers: StagePowerFit | None
    powers_reason: str | None
    control: dict[str, Any]

    def lacking(self) -> list[str]:
        """A sentence for every configuration that has nothing which may be used."""
        reasons = [r.document.void if r else f for r, f in zip(self.results, self.failures, strict=True)]
        return [f"configuration {at} has no result: {why}" for at, why in enumerate(reasons, start=1) if why]

    def to_json(self) -> dict[str, Any]:
        """The document of `measure --configurations ... --json`."""
        return {
            "configurations": [
                result.document.to_json() if result else {"void": failure}
                for result, failure in zip(self.results, self.failures, strict=True)
            ],
            "stage_powers": self.powers.to_json() if self.powers else None,
            "stage_powers_reason": self.powers_reason,
            "control": self.control,
        }


def build_results(
    session: Session,
    configurations: Sequence[Configuration],
    rule: MeasureRule,
    course: Course,
    calibration: Calibration | None = None,
) -> SeveralResults:
    """Documents of all configurations, with `regressed` stage energies where the sweep can tell them."""
    metered = [
        record
        for record, configuration in zip(session.records, configurations, strict=True)
        if not configuration.timed_only and record.void is None
    ]
    powers, reason = fit_recordings(metered)
    results: list[Result | None] = []
    failures: list[str | None] = []
    for record, configuration in zip(session.records, configurations, strict=True):
        if record.ready is None:
            results.append(None)
            failures.append(record.void or "it was not reached")
            continue
        result = build_result(record, rule, configuration.job.image_file, powers, calibration)
        if configuration.timed_only:
            result = _priced(result, record, powers, reason)
        results.append(result)
        failures.append(None)
    return SeveralResults(results, failures, powers, reason, _control(session, course))


def fit_recordings(records: Sequence[Recording]) -> tuple[StagePowerFit | None, str | None]:
    """(stage powers from all metered windows, None) or (None, why there are none)."""
    totals = [total for record in records for total in window_totals(record)]
    try:
        return fit_stage_powers(totals), None
    except FitError as error:
        return None, str(error)


def window_totals(record: Recording) -> list[WindowTotals]:
    """The recording's windows whose energy is known, as the fit takes them."""
    found = window_energies(
        PowerSeries(record.samples), record.source, record.windows, record.source_report.resolution_j
    )
    return [
        WindowTotals(
            time_s=window.wall_s,
            stages_s={name: stage.time_s for name, stage in window.stages.items()},
            energy_j=energy_j,
            start_s=window.start_s,
        )
        for window, energy_j in zip(record.windows, found.gross_j, strict=True)
        if energy_j is not None
    ]


def _priced(result: Result, record: Recording, powers: StagePowerFit | None, reason: str | None) -> Result:
    """A timed configuration's document: its joules are the model's, and said to be."""
    gross, note = None, f"timed only, and not priced: {reason}"
    windows = usable_windows(record)
    if powers is not None and record.void is None:
        try:
            gross, note = _price(windows, powers), "timed only; its joules are priced by the stage powers of this sweep"
        except FitError as error:
            note = f"timed only, and not priced: {error}"
    quality: Quality = "replayed" if record.source.quality == "replayed" else "estimated"
    document = result.document
    notes = (*(n for n in result.notes if "windows" not in n or "void" in n), note)
    after = {**document.conditions.after, "notes": list(notes)}
    changed = document.model_copy(
        update={
            "method": METHOD if gross is not None else "none",
            "quality": quality if gross is not None else "none",
            "energy_j_per_image": EnergyPerImage(gross=gross, net=None, counter=None),
            "stages": {
                name: stage.model_copy(
                    update={
                        "energy_j": StageEnergy(equation_2=None, regressed=stage.energy_j.regressed),
                        "energy_intervals_j": _only_regressed(stage.energy_intervals_j),
                    }
                )
                for name, stage in document.stages.items()
            },
            "window_data": tuple(w.model_copy(update={"energy_j": None, "block": None}) for w in document.window_data),
            "conditions": document.conditions.model_copy(update={"after": after}),
        }
    )
    return Result(changed, result.blobs, notes)


def _only_regressed(intervals: StageIntervals | None) -> StageIntervals | None:
    if intervals is None or intervals.regressed is None:
        return None
    return StageIntervals(regressed=intervals.regressed)


def _price(windows: Sequence[Window], powers: StagePowerFit) -> Interval:
    """Joules an image: the model's interval and the spread of the timed windows in quadrature."""
    images = sum(w.images for w in windows)
    names = dict.fromkeys(name for w in windows for name in w.stages)
    seconds = {name: sum(w.stages[name].time_s for w in windows if name in w.stages) / images for name in names}
    priced = powers.price(seconds, sum(w.wall_s for w in windows) / images)
    spread_j = 0.0
    if len(windows) >= 2:
        singly = [
            powers.price({n: s.time_s / w.images for n, s in w.stages.items()}, w.wall_s / w.images).value
            for w in windows
        ]
        spread_j = two_stage_interval(singly, len(singly)).half_width
    low_j = ((priced.value - priced.low) ** 2 + spread_j**2) ** 0.5
    high_j = ((priced.high - priced.value) ** 2 + spread_j**2) ** 0.5
    return Interval(value=priced.value, low=max(0.0, priced.value - low_j), high=priced.value + high_j)


def _control(session: Session, course: Course) -> dict[str, Any]:
    drift = session.drift
    told = None
    if drift is not None:
        unit = drift.unit.lower()
        told = {
            "window": drift.index + 1,
            f"seen_{unit}_per_image": drift.seen,
            f"expected_{unit}_per_image": drift.expected.model_dump(),
        }
    return {"configuration": course.control + 1, "order": course.order, "order_seed": course.seed, "drift": told}


def void_everywhere(results: SeveralResults) -> str | None:
    """The reason when not one configuration has a result that may be used, else None."""
    documents: list[MeasureDocument] = [result.document for result in results.results if result]
    if any(document.void is None for document in documents):
        return None
    reasons = [document.void for document in documents] + results.failures
    return next((reason for reason in reasons if reason), "nothing was measured")
