"""From a recording to the measure document: intervals over windows, joules per stage, notes."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from joulebox_agent.conditions import Conditions
from joulebox_agent.errors import RendererError
from joulebox_agent.estimates.calibration import Calibration
from joulebox_agent.estimates.energies import IDLE_PIECES, WindowEnergies, idle_power, window_energies
from joulebox_agent.estimates.estimate import Interval, net_of_idle, two_stage_interval
from joulebox_agent.estimates.stage_power import StagePowerFit
from joulebox_agent.estimates.windows import Window
from joulebox_agent.loop import ImageEvent, ReadyEvent
from joulebox_agent.measuring.document import (
    EnergyPerImage,
    MeasureDocument,
    RendererBuild,
    StateAround,
    VoidWindowRecord,
    WindowRecord,
)
from joulebox_agent.measuring.recording import Recording, VoidWindow
from joulebox_agent.measuring.rule import MeasureRule
from joulebox_agent.measuring.stages import StageEvidence, stage_records
from joulebox_agent.sampling.sampler import HIGHEST_CPU_SHARE, samples_ndjson
from joulebox_agent.sampling.series import PowerSeries
from joulebox_agent.sources.reading import Primary


@dataclass(frozen=True)
class Result:
    """The document and the bytes its hashes name: blobs[sha256]."""

    document: MeasureDocument
    blobs: dict[str, bytes]
    notes: tuple[str, ...]


def build_result(
    record: Recording,
    rule: MeasureRule,
    image_file: Path,
    powers: StagePowerFit | None = None,
    calibration: Calibration | None = None,
) -> Result:
    """Turns what was recorded into the document. Raises RendererError when not even `ready` was seen.

    powers       stage powers of a sweep that this recording belongs to
    calibration  what RAPL's watts are worth at the battery, where both were read
    """
    if record.ready is None:
        raise RendererError(f"The measurement ended before the renderer was ready: {record.void}.")
    found = _find(record, rule)
    windows, energies = found.windows, found.energies
    samples_sha256, image_sha256, blobs = _blobs(record, image_file)
    fast, primary = _fast_series(record)
    gross_j = energies.gross_j if found.per_image.gross else (None,) * len(windows)
    evidence = StageEvidence(
        windows, gross_j, rule.min_windows, energies.least_share, fast, primary, calibration, powers
    )
    document = MeasureDocument(
        **_identity(record.ready, record.last_image),
        method=record.source.method,
        quality=record.source.quality,
        scope=record.source.scope,
        refresh_s=found.refresh_s,
        images=sum(w.images for w in windows),
        windows=len(windows),
        window_s=rule.window_s if rule.meter else sum(w.wall_s for w in windows),
        time_s_per_image=_time_interval(record, windows, "time_s", rule.min_windows),
        cpu_s_per_image=_time_interval(record, windows, "cpu_s", rule.min_windows),
        energy_j_per_image=found.per_image,
        stages=stage_records(evidence),
        window_data=_window_records(record, windows, energies.gross_j),
        void_windows=tuple(_void_record(voided, record.start_s) for voided in record.voided),
        sampler_cpu_share=round(record.sampler_cpu_share, 6) if record.source.quality != "none" else None,
        power_samples=samples_sha256,
        image_blob=image_sha256,
        conditions=_conditions(record, found),
        void=record.void,
        suspect=record.suspect,
    )
    return Result(document, blobs, found.notes)


@dataclass(frozen=True)
class _Findings:
    """What the samples say about the windows."""

    windows: list[Window]
    energies: WindowEnergies
    per_image: EnergyPerImage
    idle_w: Interval | None
    refresh_s: float | None
    notes: tuple[str, ...]


def _find(record: Recording, rule: MeasureRule) -> _Findings:
    windows, notes = usable_windows(record), list(record.notes)
    series = PowerSeries(record.samples)
    energies = _energies(record, series, windows)
    notes += energies.notes
    idle_w = idle_power(series, record.source, record.idle, energies.lag_s) if record.idle else None
    if record.idle and idle_w is None:
        notes.append("net energy is unknown: the source is too slow for the idle time, make --idle-s longer")
    per_image = _energy_per_image(energies, windows, idle_w, IDLE_PIECES * len(record.idle), rule.min_windows)
    per_image = per_image.within(record.source_report.scale_range)
    if record.source.quality != "none" and per_image.gross is None and not energies.notes and record.void is None:
        notes.append("energy is unknown: it needs at least two windows with readings")
    if record.voided:
        reasons = "; ".join(dict.fromkeys(voided.reason for voided in record.voided))
        notes.append(f"{len(record.voided)} void windows were left out: {reasons}")
    if record.source.quality != "none" and record.sampler_cpu_share > HIGHEST_CPU_SHARE:
        notes.append(
            f"the sampler took {record.sampler_cpu_share:.2%} of a core, more than {HIGHEST_CPU_SHARE:.1%}: "
            "it is part of what was measured"
        )
    if record.suspect is not None:
        notes.append(record.suspect)
    return _Findings(windows, energies, per_image, idle_w, series.refresh_s(), tuple(notes))


def _identity(ready: ReadyEvent, last_image: ImageEvent | None) -> dict[str, Any]:
    """What was rendered and by what, in the renderer's own words."""
    return {
        "scene": ready.scene,
        "scene_sha256": ready.scene_sha256,
        "settings": ready.settings,
        "renderer": RendererBuild(**ready.build.model_dump()),
        "plan": ready.plan,
        "photons": last_image.photons if last_image else {},
        "pixel_sha256": last_image.pixel_sha256 if last_image else None,
    }


def _conditions(record: Recording, found: _Findings) -> StateAround:
    after: Conditions = {
        "notes": list(found.notes),
        "sampler_cpu_share": round(record.sampler_cpu_share, 6),
        "idle_power_w": found.idle_w.value if found.idle_w else None,
    }
    before: Conditions = {"source_files": list(record.source_report.files)}
    return StateAround(before={**record.before, **before}, after={**record.after, **after})


def usable_windows(record: Recording) -> list[Window]:
    """The closed windows; without any, the images there are as one window, the warm-up as the last resort."""
    if record.windows:
        return record.windows
    if record.rest is not None:
        return [record.rest]
    if record.warm_up is None:
        return []
    only = Window(record.warm_up.start_s)
    only.add(record.warm_up, record.warm_up_stages)
    return [only]


def _energies(record: Recording, series: PowerSeries, windows: list[Window]) -> WindowEnergies:
    if record.void is not None:
        nothing = (None,) * len(windows)
        return WindowEnergies(nothing, nothing, ())
    return window_energies(series, record.source, windows, record.source_report.resolution_j)


def _energy_per_image(
    energies: WindowEnergies,
    windows: list[Window],
    idle_w: Interval | None,
    idle_pieces: int,
    pilot_count: int,
) -> EnergyPerImage:
    def interval(values_j: tuple[float | None, ...], least_share: float) -> Interval | None:
        known = [v / w.images for v, w in zip(values_j, windows, strict=True) if v is not None]
        if len(known) < 2:
            return None
        return two_stage_interval(known, pilot_count, least_half=least_share * float(np.mean(known)))

    gross = interval(energies.gross_j, energies.least_share)
    counter = interval(energies.counter_j, energies.counter_least_share)
    net = None
    if gross is not None and idle_w is not None:
        known = [(e, w) for e, w in zip(energies.gross_j, windows, strict=True) if e is not None]
        net = net_of_idle(
            [energy_j / w.images for energy_j, w in known],
            [w.wall_s / w.images for _, w in known],
            idle_w,
            idle_pieces,
            pilot_count,
            energies.least_share * gross.value,
        )
    return EnergyPerImage(gross=gross, net=net, counter=counter)


def _time_interval(record: Recording, windows: list[Window], name: str, pilot_count: int) -> Interval | None:
    """Over windows; over single images where there is one window; an image alone has no spread to tell."""
    if len(windows) >= 2:
        sums = [w.image_time_s if name == "time_s" else w.cpu_s for w in windows]
        return two_stage_interval([s / w.images for s, w in zip(sums, windows, strict=True)], pilot_count)
    images = record.images or ([record.warm_up] if record.warm_up else [])
    values = [float(getattr(image, name)) for image in images]
    if not values:
        return None
    if len(values) == 1:
        return Interval(value=values[0], low=values[0], high=values[0])
    return two_stage_interval(values, len(values))


def _fast_series(record: Recording) -> tuple[PowerSeries | None, Primary]:
    """The series that may resolve stages: RAPL's where it was read along, else the source's own."""
    if record.companion_samples:
        return PowerSeries(record.companion_samples), "counter"
    if record.source.quality == "none":
        return None, "power"
    return PowerSeries(record.samples), record.source.primary


def _window_records(
    record: Recording, windows: list[Window], gross_j: Sequence[float | None]
) -> tuple[WindowRecord, ...]:
    blocks: list[int | None] = [block + 1 for block in record.blocks] if record.windows else [None] * len(windows)
    return tuple(
        WindowRecord(
            start_s=window.start_s - record.start_s,
            time_s=window.wall_s,
            images=window.images,
            energy_j=energy_j,
            cpu_s=window.cpu_s,
            stages_s={name: totals.time_s for name, totals in window.stages.items()},
            block=block,
        )
        for window, energy_j, block in zip(windows, gross_j, blocks, strict=True)
    )


def _void_record(voided: VoidWindow, start_s: float) -> VoidWindowRecord:
    return VoidWindowRecord(
        start_s=voided.start_s - start_s,
        time_s=max(0.0, voided.end_s - voided.start_s),
        images=voided.images,
        reason=voided.reason,
    )


def _blobs(record: Recording, image_file: Path) -> tuple[str | None, str | None, dict[str, bytes]]:
    """(hash of the samples, hash of the picture, the bytes by hash); None for what there is not."""
    blobs: dict[str, bytes] = {}
    samples = samples_ndjson(record.samples, record.start_s) if record.source.quality != "none" else b""
    image = image_file.read_bytes() if record.void is None and image_file.exists() else b""

    def kept(content: bytes) -> str | None:
        if not content:
            return None
        sha256 = hashlib.sha256(content).hexdigest()
        blobs[sha256] = content
        return sha256

    return kept(samples), kept(image), blobs
