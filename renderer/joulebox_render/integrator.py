"""Photon mapping, in the order of Jensen 2001 and the thesis' chapter 4.

render_image is the pseudo-code of the method: its names are the stages', in the order they run. Work goes in
bands of the image so that memory does not grow with the resolution and an interval belongs to one stage.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from joulebox_render.clock import StageClock
from joulebox_render.records import F4, F8, Camera, Points
from joulebox_render.stages.context import Context
from joulebox_render.stages.density import caustic_estimate, global_estimate, show_photons
from joulebox_render.stages.direct import light_directly
from joulebox_render.stages.eye import look
from joulebox_render.stages.gather import add_to_owners, final_gather, trace_paths
from joulebox_render.stages.irradiance_cache import IrradianceCache, cached_gather, fill_cache
from joulebox_render.stages.photon_map import PhotonMap, build_photon_map, emit_and_store
from joulebox_render.stages.precomputed import Illumination, IrradianceRecords, precompute_irradiance
from joulebox_render.stages.shadow_photons import ShadowMap, build_shadow_map

# Eye rays a band: so many that threads seldom wait for each other at the end of one, in about a hundred megabytes.
BAND_RAYS = 524_288


@dataclass(frozen=True)
class Maps:
    """What is known before the first pixel: photon maps and precomputed irradiance, None where not needed."""

    global_map: PhotonMap | None
    caustic_map: PhotonMap | None
    irradiance: IrradianceRecords | None
    cache: IrradianceCache | None = None
    shadow_map: ShadowMap | None = None


@dataclass(frozen=True)
class Rendering:
    """A finished image: linear RGB radiance (height, width, 3) f4, first row on top, and the maps behind it."""

    pixels: F4
    maps: Maps


def render_image(
    context: Context, camera: Camera, clock: StageClock, progress: Callable[[float], None] | None = None
) -> Rendering:
    """Render one image; `progress` hears the share of pixels done."""
    settings = context.settings
    assert settings.width and settings.height
    clock.count_rays = lambda: context.intersector.traced
    maps = make_maps(context, clock)
    if context.plan.irradiance_cache:
        with clock.stage("indirect", part="overture"):
            cache = fill_cache(context, camera, illumination(context, maps))
        maps = replace(maps, cache=cache)
    pixel_count = settings.width * settings.height
    band = max(1, BAND_RAYS // settings.samples_per_pixel)
    pixels = np.empty((pixel_count, 3), np.float32)
    for first in range(0, pixel_count, band):
        count = min(band, pixel_count - first)
        render_band(context, camera, maps, clock, first, pixels[first : first + count])
        if progress:
            progress((first + count) / pixel_count)
    return Rendering(pixels.reshape(settings.height, settings.width, 3), maps)


def make_maps(context: Context, clock: StageClock) -> Maps:
    """Emit photons, build the maps, precompute irradiance: what the plan asks for."""
    settings, plan = context.settings, context.plan
    global_map = caustic_map = irradiance = shadow_map = None
    if plan.global_map or plan.caustic_map:
        with clock.stage("photon_map", part="emission"):
            emission = emit_and_store(context)
        with clock.stage("photon_map", part="construction"):
            if emission.global_photons is not None:
                global_map = build_photon_map(
                    emission.global_photons, emission.global_emitted, settings.global_photons, context.pool
                )
            if emission.caustic_photons is not None:
                caustic_map = build_photon_map(
                    emission.caustic_photons, emission.caustic_emitted, settings.caustic_photons, context.pool
                )
    if plan.shadow_photons:
        with clock.stage("photon_map", part="shadow_photons"):
            shadow_map = build_shadow_map(context)
    if plan.precomputed_irradiance and global_map is not None:
        with clock.stage("precomputed_irradiance"):
            irradiance = precompute_irradiance(context, global_map)
    return Maps(global_map, caustic_map, irradiance, shadow_map=shadow_map)


def render_band(context: Context, camera: Camera, maps: Maps, clock: StageClock, first_pixel: int, pixels: F4) -> None:
    """Render pixels from `first_pixel` on into pixels (n, 3) f4."""
    with clock.stage("direct"):
        sight = look(context, camera, first_pixel, len(pixels))
        radiance = sight.emitted
    for points, through_specular in ((sight.direct, False), (sight.through_specular, True)):
        if len(points.owner):
            light_points(context, maps, clock, points, through_specular, radiance)
    with clock.stage("direct"):
        pixels[:] = radiance / context.settings.samples_per_pixel


def light_points(
    context: Context, maps: Maps, clock: StageClock, points: Points, through_specular: bool, radiance: F8
) -> None:
    """Add direct light, indirect light and caustics at points to their pixels' radiance (pixels, 3) f8."""
    with clock.stage("direct", through_specular=through_specular) as interval:
        direct = light_directly(context, points, maps.shadow_map.cells if maps.shadow_map else None)
        add_to_owners(context, points, direct.radiance, radiance)
        interval.rays_saved += direct.rays_saved
    if context.plan.indirect:
        with clock.stage("indirect", through_specular=through_specular):
            add_to_owners(context, points, indirect_light(context, maps, points), radiance)
    if maps.caustic_map is not None:
        with clock.stage("caustics", through_specular=through_specular):
            shown = show_photons(context, caustic_estimate(context, maps.caustic_map), points)
            add_to_owners(context, points, shown, radiance)


def indirect_light(context: Context, maps: Maps, points: Points) -> F8:
    """Indirect light at points by the method that the settings name."""
    if maps.global_map is None:
        return trace_paths(context, points)
    if context.settings.indirect == "direct_visualization":
        return show_photons(context, global_estimate(context, maps.global_map), points)
    light = illumination(context, maps)
    if maps.cache is not None:
        return cached_gather(context, maps.cache, light, points)
    return final_gather(context, light, points, context.settings.final_gather_rays)


def illumination(context: Context, maps: Maps) -> Illumination:
    """What gather rays ask where they end."""
    assert maps.global_map is not None
    caustics = caustic_estimate(context, maps.caustic_map) if maps.caustic_map else None
    return Illumination(global_estimate(context, maps.global_map), maps.irradiance, caustics)
