"""What RAPL's watts are worth at this machine's battery: learnt where both are read, kept in the state folder."""

import json
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from joulebox_agent.conditions import Conditions
from joulebox_agent.errors import AgentError
from joulebox_agent.estimates.calibration import Calibration
from joulebox_agent.estimates.energies import stretch_energies_j
from joulebox_agent.estimates.stage_power import FitError
from joulebox_agent.files import write_whole
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.choose import Choice, make_source

FILE = "calibration.json"
COMPANION = "rapl"


def companion_of(choice: Choice, sysfs_root: Path) -> str | None:
    """The source to read along with a battery, where it can be read: RAPL."""
    return COMPANION if why_no_companion(choice, sysfs_root) is None else None


def why_no_companion(choice: Choice, sysfs_root: Path) -> str | None:
    """Why battery and RAPL cannot be compared here and now, or None."""
    if choice.source.quality != "measured" or not choice.source.method.startswith("battery"):
        told = [
            f"{report.method}: {report.reason}" for report in choice.declined if report.method.startswith("battery")
        ]
        return "; ".join(told) or f"{choice.source.method} is no battery"
    report = make_source(COMPANION, sysfs_root).report()
    remedy = f" ({report.remedy})" if report.remedy else ""
    return None if report.available else f"{COMPANION}: {report.reason}{remedy}"


def calibrate(records: Sequence[Recording], conditions: Conditions) -> Calibration:
    """The line through all windows and idle times of a session that read both. Raises FitError."""
    first = records[0]
    stretches = [(window.start_s, window.end_s) for record in records for window in record.windows] + first.idle
    battery_j = stretch_energies_j(PowerSeries(first.samples), first.source.primary, stretches)
    rapl_j = stretch_energies_j(PowerSeries(first.companion_samples), "counter", stretches)
    pairs_w = [
        (at_battery_j / (end_s - start_s), at_cpu_j / (end_s - start_s))
        for (start_s, end_s), at_battery_j, at_cpu_j in zip(stretches, battery_j, rapl_j, strict=True)
        if at_battery_j is not None and at_cpu_j is not None
    ]
    return Calibration.fit(
        [battery_w for battery_w, _ in pairs_w],
        [rapl_w for _, rapl_w in pairs_w],
        datetime.now(UTC),
        conditions,
        platform.node(),
    )


def keep(calibration: Calibration, folder: Path) -> None:
    """Stores the calibration of this device. Raises AgentError when the disk does not take it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(folder / FILE, calibration.model_dump_json(indent=1).encode())
    except OSError as error:
        raise AgentError(f"The calibration cannot be kept in {folder / FILE}: {error.strerror}.") from error


@dataclass(frozen=True)
class Stored:
    """What the state folder holds: the calibration, if any, and why it may not be used now (None: it may)."""

    calibration: Calibration | None
    unused: str | None


def stored(folder: Path, conditions: Conditions) -> Stored:
    """This device's calibration, judged by the conditions of now."""
    try:
        calibration = Calibration.from_json(json.loads((folder / FILE).read_bytes()))
    except FileNotFoundError:
        return Stored(None, "there is none yet")
    except OSError as error:
        return Stored(None, f"{folder / FILE} cannot be read: {error.strerror}")
    except (ValueError, RecursionError, FitError):
        return Stored(None, f"{folder / FILE} is damaged: calibrate again")
    return Stored(calibration, calibration.valid_reason(datetime.now(UTC), conditions, platform.node()))


def calibration_for(records: Sequence[Recording], folder: Path) -> tuple[Calibration | None, list[str]]:
    """The calibration for a session's stage energies and what to say about it: this session's own, which is kept,
    else the stored one while it is valid."""
    if not records[0].companion_samples:
        return None, []
    conditions = records[0].after
    try:
        own = calibrate(records, conditions)
    except FitError as error:
        kept = stored(folder, conditions)
        if kept.calibration is None:
            return None, [f"RAPL is not calibrated: {error}"]
        if kept.unused is not None:
            return None, [f"the stored calibration of RAPL is not used: {kept.unused}"]
        return kept.calibration, [f"stage energies use the stored calibration of RAPL: {kept.calibration.words()}"]
    try:
        keep(own, folder)
    except AgentError as error:
        return own, [str(error)]
    return own, [f"RAPL calibrated: {own.words()}"]
