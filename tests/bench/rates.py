"""What stages make of their rays and photons: ratios to bare embreex on the very same rays."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from typing import Any

from joulebox_render.bench import RATE_SCENE, stage_rates
from joulebox_render.session import Session
from joulebox_render.settings import Settings, make_settings
from joulebox_render.stages.eye import look

from .table import Row

NO_EMBREE = "embreex is not installed"
# stage, what is compared, least shares of bare embreex
SHARES = (
    ("direct", "shadow rays, whole direct stage, of bare embreex on the same rays", ">= 60 %", 0.60),
    ("indirect", "final gather (trace, lookup, accumulate), of bare closest hits",
     ">= 45 % (with a table)", 0.45),
    ("photon_map, emission", "photon tracing, of bare closest hits", ">= 35 %", 0.35),
)  # fmt: skip
# A cache of irradiance would leave few gather rays to measure.
RATE_SETTINGS = {"threads": 1, "samples_per_pixel": 1, "shadow_rays": 36, "irradiance_cache_tolerance": 0.0}
GATHER_SETTINGS = {
    "threads": 1, "samples_per_pixel": 1, "shadow_rays": 1, "indirect": "direct_visualization",
    "global_photons": 250_000, "gather_count": 100, "gather_distance_m": 0.02, "photon_spacing": 0,
}  # fmt: skip
GATHER_LIMIT_US = 5.0


def known(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values whose settings this version has."""
    return {name: value for name, value in values.items() if name in Settings.model_fields or name == "preset"}


def share_rows(say: Callable[[str], None], size: Mapping[str, Any]) -> list[Row]:
    """A row for each kind of ray."""
    say("stages against bare embreex on the same rays")
    with Session(RATE_SCENE, make_settings(known(RATE_SETTINGS), size)) as session:
        rates = stage_rates(session)
    rows = []
    for stage, what, goal, least in SHARES:
        if stage not in rates:
            rows.append(Row.not_run(what, goal, NO_EMBREE if not rates else f"no rays in {stage}"))
            continue
        share, rays = rates[stage]["share_of_bare"], rates[stage]["rays"] / rates[stage]["cpu_s"]
        rows.append(Row(what, goal, f"{100 * share:.0f} % ({rays / 1e6:.1f} Mray per CPU second)", share >= least))
    return rows


def gather_row(say: Callable[[str], None], size: Mapping[str, Any]) -> Row:
    """CPU time of a density estimate from 100 photons, asked for pixel after pixel."""
    say("gathering 100 of 250,000 photons")
    with Session(RATE_SCENE, make_settings(GATHER_SETTINGS, size)) as session:
        width, height = session.settings.width, session.settings.height
        assert width and height
        sight = look(session.context, session.scene.camera, 0, width * height)
        session.render()
        spent = [session.render().clock.totals()["indirect"]["cpu_s"] for _ in range(3)]
    each_us = 1e6 * statistics.median(spent) / len(sight.direct.owner)
    return Row(
        "100-nearest gather, 250k photons, 0.02 m, coherent queries", f"<= {GATHER_LIMIT_US:g} us CPU a query",
        f"{each_us:.2f} us", each_us <= GATHER_LIMIT_US,
    )  # fmt: skip
