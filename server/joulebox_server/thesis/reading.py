"""From a measurement as the server tells it to a row, in the thesis' booking."""

from collections.abc import Mapping
from typing import Any

from joulebox_server.schemas.measure import MeasureDocument, Stage
from joulebox_server.thesis.rows import Cost, Row


def read_row(sweep: str, told: Mapping[str, Any]) -> Row:
    """The row of one line of `/sweeps/{sweep}/measurements`."""
    document = MeasureDocument.model_validate(told["document"])
    assert document.time_s_per_image is not None, "only void results lack it, and they are not told"
    assert document.cpu_s_per_image is not None, "only void results lack it, and they are not told"
    gross = document.energy_j_per_image.gross
    return Row(
        sweep=sweep,
        scene=told["scene"],
        defines=told["defines"],
        purpose=told["purpose"],
        settings=document.settings,
        repeat=told["repeat"],
        seed=told["seed"],
        image=Cost(document.time_s_per_image.value, document.cpu_s_per_image.value, gross.value if gross else None),
        stages=thesis_stages(document.stages),
        quality=document.quality if gross else "none",
        difference=told["difference"],
        image_sha256=document.image_blob,
        reference_sha256=told["reference_sha256"],
        delta_sha256=told["delta_sha256"],
        pixel_sha256=document.pixel_sha256,
        photons=document.photons or {},
        samples_sha256=document.power_samples,
    )


def thesis_stages(stages: Mapping[str, Stage]) -> dict[str, Cost]:
    """Stages as the thesis books them; joules by equation 2, in proportion to time within a stage too."""
    booked: dict[str, list[Cost]] = {}
    for name, stage in stages.items():
        energy_j, cpu_s = stage.energy_j.equation_2, stage.cpu_s or 0.0
        share = stage.specular_time_s / stage.time_s if stage.time_s > 0 else 0.0
        seen = Cost(stage.specular_time_s, stage.specular_cpu_s, None if energy_j is None else energy_j * share)
        own = Cost(stage.time_s - seen.time_s, cpu_s - seen.cpu_s, None if energy_j is None else energy_j * (1 - share))
        booked.setdefault("photon_map" if name == "precomputed_irradiance" else name, []).append(own)
        if share > 0:
            booked.setdefault("direct", []).append(seen)
    return {name: _sum(parts) for name, parts in booked.items()}


def _sum(parts: list[Cost]) -> Cost:
    energies = [part.energy_j for part in parts]
    known = [energy for energy in energies if energy is not None]
    energy_j = sum(known) if len(known) == len(energies) else None
    return Cost(sum(p.time_s for p in parts), sum(p.cpu_s for p in parts), energy_j)
