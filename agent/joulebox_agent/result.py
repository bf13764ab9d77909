"""From a recording to the measure document: intervals over windows, joules per stage, notes."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joulebox_agent.conditions import Conditions
from joulebox_agent.document import (
    EnergyPerImage,
    MeasureDocument,
    RendererBuild,
    StageEnergy,
    StageRecord,
    StateAround,
    WindowRecord,
)
from joulebox_agent.energies import WindowEnergies, idle_power, window_energies
from joulebox_agent.errors import RendererError
from joulebox_agent.estimate import Interval, net_of_idle, two_stage_interval
from joulebox_agent.loop import ImageEvent, ReadyEvent
from joulebox_agent.recording import Recording
from joulebox_agent.rule import MeasureRule
from joulebox_agent.sampler import samples_ndjson
from joulebox_agent.series import PowerSeries
from joulebox_agent.windows import Window, stage_energies_j


@dataclass(frozen=True)
class Result:
    """The document and the bytes its hashes name: blobs[sha256]."""

    document: MeasureDocument
    blobs: dict[str, bytes]
    notes: tuple[str, ...]


def build_result(record: Recording, rule: MeasureRule, image_file: Path) -> Result:
    """Turns what was recorded into the document. Raises RendererError when not even `ready` was seen."""
    if record.ready is None:
        raise RendererError(f"The measurement ended before the renderer was ready: {record.void}.")
    found = _find(record, rule)
    windows, energies = found.windows, found.energies
    samples_sha256, image_sha256, blobs = _blobs(record, image_file)
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
        stages=_stages(windows, energies if found.per_image.gross else None),
        window_data=tuple(_window_record(w, e, record.start_s) for w, e in zip(windows, energies.gross_j, strict=True)),
        power_samples=samples_sha256,
        image_blob=image_sha256,
        conditions=_conditions(record, found),
        void=record.void,
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
    windows, notes = _usable_windows(record), list(record.notes)
    series = PowerSeries(record.samples)
    energies = _energies(record, series, windows, rule.min_windows)
    notes += energies.notes
    idle_w = idle_power(series, record.source, record.idle, energies.lag_s) if record.idle else None
    if record.idle and idle_w is None:
        notes.append("net energy is unknown: the source is too slow for the idle time, make --idle-s longer")
    per_image = _energy_per_image(energies, windows, idle_w, rule.min_windows)
    if record.source.quality != "none" and per_image.gross is None and not energies.notes and record.void is None:
        notes.append("energy is unknown: it needs at least two windows with readings")
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


def _usable_windows(record: Recording) -> list[Window]:
    """The closed windows; without any, the images there are as one window, the warm-up as the last resort."""
    if record.windows:
        return record.windows
    rest = record.splitter.rest() if record.splitter else None
    if rest is not None:
        return [rest]
    if record.warm_up is None:
        return []
    only = Window(record.warm_up.start_s)
    only.add(record.warm_up, record.warm_up_stages)
    return [only]


def _energies(record: Recording, series: PowerSeries, windows: list[Window], pilot_count: int) -> WindowEnergies:
    if record.void is not None:
        nothing = (None,) * len(windows)
        return WindowEnergies(nothing, nothing, ())
    return window_energies(series, record.source, windows, record.source_report.resolution_j, pilot_count)


def _energy_per_image(
    energies: WindowEnergies, windows: list[Window], idle_w: Interval | None, pilot_count: int
) -> EnergyPerImage:
    def interval(values_j: tuple[float | None, ...]) -> Interval | None:
        known = [v / w.images for v, w in zip(values_j, windows, strict=True) if v is not None]
        return two_stage_interval(known, pilot_count, widening=energies.widening) if len(known) >= 2 else None

    gross, counter = interval(energies.gross_j), interval(energies.counter_j)
    net = None
    if gross is not None and idle_w is not None:
        net = net_of_idle(gross, idle_w, sum(w.wall_s for w in windows) / sum(w.images for w in windows))
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


def _stages(windows: list[Window], energies: WindowEnergies | None) -> dict[str, StageRecord]:
    """Means per image over all windows; joules over the windows whose energy is known."""
    images = sum(w.images for w in windows)
    names = dict.fromkeys(name for w in windows for name in w.stages)
    gross_j = energies.gross_j if energies else (None,) * len(windows)
    shares = [(w, stage_energies_j(w, g)) for w, g in zip(windows, gross_j, strict=True) if g is not None]
    metered = sum(w.images for w, _ in shares)
    stages = {}
    for name in names:
        totals = [w.stages[name] for w in windows if name in w.stages]
        joules = sum(share.get(name, 0.0) for _, share in shares) / metered if metered else None
        stages[name] = StageRecord(
            time_s=sum(t.time_s for t in totals) / images,
            cpu_s=sum(t.cpu_s for t in totals) / images,
            rays=round(sum(t.rays for t in totals) / images),
            energy_j=StageEnergy(equation_2=joules),
        )
    return stages


def _window_record(window: Window, energy_j: float | None, start_s: float) -> WindowRecord:
    return WindowRecord(
        start_s=window.start_s - start_s,
        time_s=window.wall_s,
        images=window.images,
        energy_j=energy_j,
        cpu_s=window.cpu_s,
        stages_s={name: totals.time_s for name, totals in window.stages.items()},
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
