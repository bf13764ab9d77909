"""The sensor of a scene: a perspective camera and the size of its film."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from joulebox_render.records import Camera
from joulebox_render.scene_transforms import uniform_scale
from joulebox_render.scene_values import Properties
from joulebox_render.scene_xml import Element, suggest

_FOV_AXES = ("x", "y", "smaller", "larger", "diagonal")
_MAX_PIXELS_A_SIDE = 16384
# The frame that focal lengths are quoted for: 36 mm x 24 mm.
_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)


def read_sensor(element: Element, objects_by_id: Mapping[str, Element], notes: list[str]) -> tuple[Camera, int, int]:
    """Camera, film width and film height; adds a sentence to `notes` for each thing that is ignored."""
    if element.type != "perspective":
        raise element.error(f'unknown sensor "{element.type}"{suggest(element.type, ("perspective",))}')
    properties = Properties(element, objects_by_id)
    blame = properties.line_of("to_world")
    to_world = properties.take_transform("to_world")
    scale = uniform_scale(to_world[:3, :3])
    if scale is None or abs(scale - 1.0) > 1e-3:
        raise blame.error("to_world of a camera must only move and rotate; remove the scaling")
    to_world[:3, :3] /= np.linalg.norm(to_world[:3, :3], axis=0)
    fov_deg, fov_axis = _field_of_view(properties)
    near_m = properties.take_float("near_clip", 0.01, above=0.0)
    far_element = properties.line_of("far_clip")
    far_m = properties.take_float("far_clip", 10000.0, above=0.0)
    if far_m <= near_m:
        raise far_element.error(f'"far_clip" is {far_m:g}; it must exceed near_clip, {near_m:g}')
    for sampler in properties.take_objects("sampler"):
        notes.append(f"line {sampler.line}: the sampler is ignored; samples_per_pixel and seed are settings.")
    width, height = _film(properties, objects_by_id, notes)
    properties.finish()
    return Camera(to_world, fov_deg, fov_axis, near_m, far_m), width, height


def _field_of_view(properties: Properties) -> tuple[float, str]:
    """Angle [degrees] and its axis; from a focal length without fov (50 mm when there is neither)."""
    if properties.has("fov"):
        if properties.has("focal_length"):
            raise properties.line_of("focal_length").error("a camera has a fov or a focal_length, not both")
        fov_deg = properties.take_float("fov", 0.0, above=0.0, below=180.0)
        return fov_deg, properties.take_choice("fov_axis", "x", _FOV_AXES)
    blame = properties.line_of("focal_length")
    text = properties.take_string("focal_length", "50mm").strip().removesuffix("mm").strip()
    try:
        focal_mm = float(text)
    except ValueError:
        focal_mm = math.nan
    if not 0.0 < focal_mm < 1e6:
        raise blame.error(f'"focal_length" is "{text}"; give millimetres, for example "50mm", or a fov')
    properties.take_choice("fov_axis", "x", _FOV_AXES)
    return math.degrees(2.0 * math.atan(_FRAME_DIAGONAL_MM / (2.0 * focal_mm))), "diagonal"


def _film(properties: Properties, objects_by_id: Mapping[str, Element], notes: list[str]) -> tuple[int, int]:
    """Width and height [pixels]; Mitsuba's 768 x 576 without a film."""
    films = properties.take_objects("film")
    if len(films) > 1:
        raise films[1].error("a sensor has one film; remove the others")
    if not films:
        return 768, 576
    if films[0].type != "hdrfilm":
        raise films[0].error(f'unknown film "{films[0].type}"{suggest(films[0].type, ("hdrfilm",))}')
    film = Properties(films[0], objects_by_id)
    width = film.take_integer("width", 768, 1, _MAX_PIXELS_A_SIDE)
    height = film.take_integer("height", 576, 1, _MAX_PIXELS_A_SIDE)
    for name in ("file_format", "pixel_format", "component_format"):
        film.take_string(name, "")
    for name in ("sample_border", "compensate"):
        film.take_boolean(name, False)
    for rfilter in film.take_objects("rfilter"):
        if rfilter.type != "box":
            notes.append(f'line {rfilter.line}: rfilter "{rfilter.type}" is ignored; pixels are averaged with a box.')
    film.finish()
    return width, height
