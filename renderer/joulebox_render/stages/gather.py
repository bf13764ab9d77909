"""Indirect light at diffuse points: final gathering over the photon map, and unbiased paths."""

from __future__ import annotations

import numpy as np

from joulebox_render.kernels.gathering import add_weighted, reflect_irradiance
from joulebox_render.kernels.transport import continue_paths, gather_rays
from joulebox_render.records import F8, Points, Rays, rows
from joulebox_render.stages.context import Context
from joulebox_render.stages.density import DensityEstimate, IrradianceRecords, look_up
from joulebox_render.stages.direct import sample_lights
from joulebox_render.stages.paths import follow_to_diffuse, join

# No path is followed through more diffuse bounces; Russian roulette ends nearly all long before.
MAX_PATH_BOUNCES = 1000


def final_gather(
    context: Context, estimate: DensityEstimate, records: IrradianceRecords | None, points: Points
) -> tuple[F8, int]:
    """Radiance (points, 3) f8 that points reflect of light that comes from other surfaces, and the rays traced.

    Light that surfaces emit towards a point is left out: it is sampled directly, or, where it comes through
    mirrors and glass, shown by the caustic map; without a caustic map gather rays find it.
    """
    count = context.settings.final_gather_rays
    columns = context.columns(count)

    def chunk(first: int, last: int) -> tuple[F8, int]:
        radiance = np.zeros((last - first, 3))
        rays = Rays.empty((last - first) * count)
        gather_rays(points, first, last, count, columns, rays)
        reached, traced = follow_to_diffuse(
            context, rays, radiance, split=False, first_emission=False,
            specular_emission=not context.plan.caustic_map,
        )  # fmt: skip
        for far in reached:
            reflect_irradiance(far, look_up(estimate, records, far), radiance)
        return radiance, traced

    chunks = list(context.pool.map_chunks(chunk, len(points.owner), count))
    radiance = np.concatenate([part for part, _ in chunks]) if chunks else np.zeros((0, 3))
    return radiance, sum(traced for _, traced in chunks)


def trace_paths(context: Context, points: Points) -> tuple[F8, int]:
    """Radiance (points, 3) f8 of all light that bounced, one unbiased path a point, and the rays traced.

    Next-event estimation at every diffuse point; emission counts where a path found it through specular
    surfaces, which next-event estimation cannot. Russian roulette after two bounces.
    """

    def chunk(first: int, last: int) -> tuple[F8, int]:
        count = last - first
        radiance = np.zeros((count, 3))
        here = Points(*rows(points, slice(first, last)))._replace(
            weight=np.ones((count, 3), np.float32), owner=np.arange(count, dtype=np.int64)
        )
        traced = 0
        for bounce in range(MAX_PATH_BOUNCES):
            rays = Rays.empty(len(here.owner))
            going_on = continue_paths(here, bounce, rays)
            if going_on == 0:
                break
            reached, through = follow_to_diffuse(
                context, Rays(*rows(rays, slice(0, going_on))), radiance, split=False,
                first_emission=False, specular_emission=True,
            )  # fmt: skip
            here = join(reached)
            light, shadow = sample_lights(context, here, 0, len(here.owner), 1)
            add_weighted(here, light, radiance)
            traced += through + shadow
        return radiance, traced

    chunks = list(context.pool.map_chunks(chunk, len(points.owner), 8))
    radiance = np.concatenate([part for part, _ in chunks]) if chunks else np.zeros((0, 3))
    return radiance, sum(traced for _, traced in chunks)
