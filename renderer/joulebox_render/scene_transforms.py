"""Numbers, vectors and `to_world` transforms of a scene file.

Transforms act on column vectors; those listed later are applied later, as in Mitsuba. Angles are in degrees.
"""

from __future__ import annotations

import math
import re

import numpy as np

from joulebox_render.records import F8
from joulebox_render.scene_xml import Element

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
# Matrices in scene files carry few decimals: how far lengths and angles may be off and still count as equal.
_SHAPE_TOLERANCE = 1e-4


def parse_number(element: Element, text: str) -> float:
    """A finite number that float32 can hold too, or SceneError at `element`."""
    if not _NUMBER.fullmatch(text.strip()):
        raise element.error(f'"{text}" is not a finite number')
    value = float(text)
    if not abs(value) <= float(np.finfo(np.float32).max):
        raise element.error(f'"{text}" is too large for single precision')
    return value


def numbers(element: Element, text: str) -> list[float]:
    """Numbers separated by commas or blanks."""
    return [parse_number(element, token) for token in re.split(r"[\s,]+", text.strip(" \t\r\n,")) if token]


def read_vector(element: Element, missing: float | None, value_name: str = "value") -> F8:
    """(3,) from one or three numbers in one attribute, or from attributes x, y and z.

    missing   stands in for those of x, y, z that are left out; None: all are needed
    """
    given = [axis for axis in "xyz" if axis in element.attributes]
    if value_name in element.attributes:
        if given:
            raise element.error(f'<{element.tag}> mixes "{value_name}" and "{given[0]}"; use one of them')
        values = numbers(element, element.attributes[value_name])
        if len(values) not in (1, 3):
            raise element.error(f"<{element.tag}> has {len(values)} numbers; give one or three")
        return np.array(values * 3 if len(values) == 1 else values, dtype=np.float64)
    if not given or (missing is None and len(given) < 3):
        raise element.error(f'<{element.tag}> lacks numbers; give {value_name}="x, y, z", or x, y and z')
    return np.array(
        [parse_number(element, element.attributes[a]) if a in given else missing for a in "xyz"], np.float64
    )


def read_transform(transform: Element) -> F8:
    """(4, 4) the product of the steps of a <transform>; refused when it is singular or not affine."""
    transform.allow_attributes("name")
    steps = {
        "matrix": _matrix,
        "translate": _translate,
        "scale": _scale,
        "rotate": _rotate,
        "lookat": _look_at,
        "look_at": _look_at,
    }
    to_world = np.eye(4)
    for step in transform.children:
        if step.tag not in steps:
            raise step.error(f"<{step.tag}> cannot stand inside <transform>; use {', '.join(sorted(steps))}")
        to_world = steps[step.tag](step) @ to_world
    linear = to_world[:3, :3]
    lengths = np.linalg.norm(linear, axis=0)
    if lengths.min() == 0.0 or abs(np.linalg.det(linear / lengths)) < 1e-9:
        raise transform.error(
            "the transform squashes space to a plane, a line or a point; its determinant must not be 0"
        )
    return to_world


def _matrix(step: Element) -> F8:
    step.allow_attributes("value")
    values = numbers(step, step.attributes.get("value", ""))
    if len(values) not in (9, 16):
        raise step.error(f"<matrix> has {len(values)} numbers; give 16 (rows first), or 9 without translation")
    size = 4 if len(values) == 16 else 3
    matrix = np.eye(4)
    matrix[:size, :size] = np.reshape(values, (size, size))
    if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        raise step.error("the last row of <matrix> must be 0 0 0 1")
    return matrix


def _translate(step: Element) -> F8:
    step.allow_attributes("value", "x", "y", "z")
    matrix = np.eye(4)
    matrix[:3, 3] = read_vector(step, 0.0)
    return matrix


def _scale(step: Element) -> F8:
    step.allow_attributes("value", "x", "y", "z")
    return np.diag([*read_vector(step, 1.0), 1.0])


def _rotate(step: Element) -> F8:
    """Counter-clockwise around the axis when it points at the viewer (Rodrigues)."""
    step.allow_attributes("value", "x", "y", "z", "angle")
    axis = read_vector(step, 0.0)
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise step.error('the axis of <rotate> is 0 0 0; give it a direction, for example y="1"')
    if abs(length - 1.0) > 1e-3:
        # Mitsuba uses the axis as it is, which turns and stretches in odd ways.
        unit = ", ".join(f"{value:.6g}" for value in axis / length)
        raise step.error(f'the axis of <rotate> has the length {length:.6g}; it must be 1: value="{unit}"')
    if "angle" not in step.attributes:
        raise step.error('<rotate> has no angle; write angle="degrees"')
    angle = math.radians(parse_number(step, step.attributes["angle"]))
    x, y, z = axis / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    return matrix


def _look_at(step: Element) -> F8:
    """Columns left, up, direction, origin: +z looks from origin to target."""
    step.allow_attributes("origin", "target", "up")
    for name in ("origin", "target", "up"):
        if name not in step.attributes:
            raise step.error(f"<{step.tag}> has no {name}; give origin, target and up")
    origin, target, up = (
        read_vector(Element(step.tag, {name: step.attributes[name]}, step.file, step.line), None, name)
        for name in ("origin", "target", "up")
    )
    direction = target - origin
    left = np.cross(up, direction)
    if np.linalg.norm(left) <= 1e-9 * np.linalg.norm(up) * np.linalg.norm(direction):
        raise step.error("<lookat> has no direction: target equals origin, or up is zero or points along the view")
    direction /= np.linalg.norm(direction)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(direction, left), direction, origin], axis=1)
    return matrix


def transform_points(to_world: F8, points: F8) -> F8:
    """(N, 3) points in world space."""
    return points @ to_world[:3, :3].T + to_world[:3, 3]


def transform_normals(to_world: F8, normals: F8) -> F8:
    """(N, 3) unit normals in world space, by the inverse transpose; a zero normal stays zero."""
    return normalized(normals @ np.linalg.inv(to_world[:3, :3]))


def normalized(vectors: F8, shortest: float = 0.0) -> F8:
    """(N, 3) unit vectors; one whose length does not exceed `shortest` becomes 0."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: F8 = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > shortest)
    return unit


def fits_single(*values: F8 | float) -> bool:
    """Whether all numbers are finite in single precision."""
    limit = float(np.finfo(np.float32).max)
    return all(bool(np.all(np.abs(value) <= limit)) for value in values)


def mirrors(to_world: F8) -> bool:
    """Whether the transform turns right hands into left ones."""
    return bool(np.linalg.det(to_world[:3, :3]) < 0.0)


def uniform_scale(linear: F8) -> float | None:
    """The length of all columns of (3, N) `linear`; None if they differ or are not at right angles."""
    lengths = np.linalg.norm(linear, axis=0)
    scale = float(lengths.mean())
    gram = linear.T @ linear / scale**2
    return scale if np.abs(gram - np.eye(linear.shape[1])).max() < _SHAPE_TOLERANCE else None
