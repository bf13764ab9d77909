"""What RAPL's watts are worth at this machine's battery: learnt where both are read, kept in the state folder."""

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from joulebox_agent.conditions import Conditions
from joulebox_agent.errors import AgentError
from joulebox_agent.estimates.calibration import Calibration
from joulebox_agent.estimates.stage_power import FitError
from joulebox_agent.files import write_whole
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.choose import Choice, make_source

FILE = "calibration.json"
COMPANION = "rapl"


def companion_of(choice: Choice, sysfs_root: Path) -> str | None:
    """The source to read along with a battery, where it can be read: RAPL."""
    if choice.source.quality != "measured" or not choice.source.method.startswith("battery"):
        return None
    return COMPANION if make_source(COMPANION, sysfs_root).report().available else None


def calibrate(records: Sequence[Recording], conditions: Conditions) -> Calibration:
    """The line through all windows and idle times of a session that read both. Raises FitError."""
    pairs = [pair for pair in _pairs(records) if pair is not None]
    return Calibration.fit(
        [battery_w for battery_w, _ in pairs],
        [rapl_w for _, rapl_w in pairs],
        datetime.now(UTC),
        conditions,
        platform.node(),
    )


def _pairs(records: Sequence[Recording]) -> list[tuple[float, float] | None]:
    first = records[0]
    battery, rapl = PowerSeries(first.samples), PowerSeries(first.companion_samples)
    stretches = [(window.start_s, window.end_s) for record in records for window in record.windows]

    def powers(start_s: float, end_s: float) -> tuple[float, float] | None:
        at_battery_j = battery.energy_j(start_s, end_s, first.source.primary)
        at_cpu_j = rapl.energy_j(start_s, end_s, "counter")
        if at_battery_j is None or at_cpu_j is None:
            return None
        return at_battery_j / (end_s - start_s), at_cpu_j / (end_s - start_s)

    return [powers(*stretch) for stretch in [*stretches, *first.idle]]


def keep(calibration: Calibration, folder: Path) -> None:
    """Stores the calibration of this device. Raises AgentError when the disk does not take it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(folder / FILE, calibration.model_dump_json(indent=1).encode())
    except OSError as error:
        raise AgentError(f"The calibration cannot be kept in {folder / FILE}: {error.strerror}.") from error


def stored(folder: Path, conditions: Conditions) -> tuple[Calibration | None, str | None]:
    """(the stored calibration, None), or (None, why it may not be used now); (None, None) where there is none."""
    try:
        calibration = Calibration.model_validate_json((folder / FILE).read_bytes())
    except FileNotFoundError:
        return None, None
    except OSError as error:
        return None, f"{folder / FILE} cannot be read: {error.strerror}"
    except ValueError:
        return None, f"{folder / FILE} is damaged: calibrate again"
    reason = calibration.valid_reason(datetime.now(UTC), conditions, platform.node())
    return (calibration, None) if reason is None else (None, reason)


def calibration_for(records: Sequence[Recording], folder: Path) -> tuple[Calibration | None, list[str]]:
    """The calibration for a session's stage energies and what to say about it: this session's own, which is kept,
    else the stored one while it is valid."""
    if not records[0].companion_samples:
        return None, []
    conditions = records[0].after
    try:
        own = calibrate(records, conditions)
    except FitError as error:
        kept, reason = stored(folder, conditions)
        if kept is not None:
            return kept, ["stage energies use the stored calibration of RAPL"]
        return None, [f"RAPL is not calibrated: {reason or error}"]
    try:
        keep(own, folder)
    except AgentError as error:
        return own, [str(error)]
    return own, [f"RAPL calibrated: P_battery = {own.a_w:.3g} W + {own.b:.3g} P_rapl, from {own.pair_count} stretches"]
