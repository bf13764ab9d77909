"""Rows that a device of our invention would bring: a world is two functions of scene and settings."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.sweeps.expansion import configurations, plan_jobs, reference_configuration
from joulebox_server.thesis.batch import Batch, Plan
from joulebox_server.thesis.results import Results
from joulebox_server.thesis.rows import Cost, Row
from joulebox_server.thesis.study import Study

World = Callable[[str, Mapping[str, Any]], Any]


def invented(
    batch: Batch,
    cost: World,
    difference: World,
    noise: float = 0.001,
    basis: str = "measured",
    defaults: Mapping[str, Any] | None = None,
) -> Results:
    """Results of a quick run of a batch in a world.

    cost         stages by name, of a scene's label and settings
    difference   to the reference, of the same; 0 for the reference's own settings
    noise        renders of a sweep with several are alternately this much (of a logarithm) above and below, from seed
                 to seed and from configuration to configuration
    defaults     of the renderer, for settings that the sweeps do not name
    """
    study = Study(None, "", True, None, None, False)  # type: ignore[arg-type]
    rows = [
        row
        for sweep in batch.sweeps(Plan(quick=True))
        for row in _rows(
            SweepDefinition.model_validate(study.definition(sweep)), cost, difference, noise, defaults or {}
        )
    ]
    return Results(tuple(rows), basis, quick=True)  # type: ignore[arg-type]


def _rows(
    definition: SweepDefinition, cost: World, difference: World, noise: float, defaults: Mapping[str, Any]
) -> Iterable[Row]:
    measured, reference = configurations(definition), reference_configuration(definition)
    for job in plan_jobs(definition, measured, reference, "order"):
        entry = definition.scenes[job.scene]
        settings = {"caustics": True, "caustic_hints": False, "direct_photons": 10_000, "photon_spacing": 0}
        settings |= defaults
        settings |= (reference if job.configuration == len(measured) else measured[job.configuration]).settings
        turn = (-1) ** (job.repeat + job.configuration)
        off = math.exp(noise * turn) if definition.repeats > 1 else 1.0
        stages = {name: Cost(c * off, c * off, c * off) for name, c in cost(entry.label, settings).items()}
        whole = sum(stage.cpu_s for stage in stages.values())
        apart = None if job.purpose in ("reference", "control") else difference(entry.label, settings) * off
        yield Row(
            sweep=definition.name, scene=entry.label, defines=entry.defines, purpose=job.purpose,
            settings=settings | {"seed": job.seed}, repeat=job.repeat, seed=job.seed, image=Cost(whole, whole, whole),
            stages=stages, quality="measured", difference=apart, image_sha256="00", reference_sha256="11",
            delta_sha256="22", pixel_sha256=None, photons={"caustic_stored": settings.get("caustic_photons", 0)},
        )  # fmt: skip


def without(results: Results, sweep: str) -> Results:
    """The results as if a sweep had not been run."""
    return replace(results, rows=tuple(row for row in results.rows if not row.sweep.startswith(sweep)))
