"""Eye rays: from pixels, through mirrors and glass, to the diffuse points that lighting is computed at."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.transport import CAMERA_STREAM, camera_rays
from joulebox_render.records import F8, Camera, Points, Rays
from joulebox_render.stages.context import Context, grid
from joulebox_render.stages.paths import follow_to_diffuse

# Streams of random numbers between one look at the picture and the next.
OVERTURE_STREAMS = 100


class Sight(NamedTuple):
    """What a band of pixels sees: emitted radiance (pixels, 3) f8 as a sum over samples, and diffuse points,
    those seen directly and those seen through mirrors and glass; owners are pixels counted from the band's first.
    """

    emitted: F8
    direct: Points
    through_specular: Points


def camera_frame(camera: Camera, width: int, height: int) -> F8:
    """(4, 3) f8: position, film right, film down, and axis; see `kernels.transport.camera_rays`."""
    axes = camera.to_world[:3, :3] / np.linalg.norm(camera.to_world[:3, :3], axis=0)
    aspect = width / height
    tangent = math.tan(math.radians(camera.fov_deg) / 2)
    axis = {"smaller": "x" if aspect <= 1 else "y", "larger": "x" if aspect >= 1 else "y"}.get(
        camera.fov_axis, camera.fov_axis
    )
    if axis == "y":
        tangent *= aspect
    elif axis == "diagonal":
        tangent *= width / math.hypot(width, height)
    return np.array([camera.to_world[:3, 3], -tangent * axes[:, 0], -tangent / aspect * axes[:, 1], axes[:, 2]])


def look(
    context: Context, camera: Camera, first_pixel: int, pixel_count: int,
    size: tuple[int, int] | None = None, overture: int = 0,
) -> Sight:  # fmt: skip
    """Trace the eye rays of pixels [first_pixel, first_pixel + pixel_count).

    An overture looks once through each pixel of a picture of its own size (width, height), never through the very
    middle, which symmetric scenes put their edges into.
    """
    settings = context.settings
    assert settings.width and settings.height
    width, height = size or (settings.width, settings.height)
    samples = 1 if overture else settings.samples_per_pixel
    jitter = settings.jitter or overture > 0
    frame = camera_frame(camera, settings.width, settings.height)
    columns = context.columns(samples) if jitter else grid(samples)

    def chunk(first: int, last: int) -> tuple[F8, list[Points]]:
        rays = Rays.empty((last - first) * samples)
        camera_rays(
            settings.seed, CAMERA_STREAM + OVERTURE_STREAMS * overture, first_pixel + first, samples, columns, jitter,
            width, height, frame, camera.near_m, rays,
        )  # fmt: skip
        emitted = np.zeros((last - first, 3))
        parts = follow_to_diffuse(context, rays, emitted, split=True, first_emission=True, specular_emission=True)
        for part in parts:
            part.owner[:] += first
        return emitted, parts

    chunks = context.pool.map_chunks(chunk, pixel_count, samples)
    return Sight(
        emitted=np.concatenate([emitted for emitted, _ in chunks]),
        direct=context.pool.join([parts[0] for _, parts in chunks]),
        through_specular=context.pool.join(
            [part for _, parts in chunks for part in parts[1:] if len(part.owner)] or [Points.empty(0)]
        ),
    )
