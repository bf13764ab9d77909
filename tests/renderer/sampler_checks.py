"""Chi-square tests of samples against their density, and the coordinates in which they should be uniform.

Seeds are fixed, so each test either passes or fails for good; ALPHA is the chance that a correct sampler would
have failed when its seed was chosen (two-sided: a fit that is too good is as suspicious for independent samples).
With some forty tests of 0.0002 all files that use it are a false alarm once in a hundred choices.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from joulebox_render.kernels.rng import path_key
from joulebox_render.kernels.vector import tangent_frame
from joulebox_render.records import Points
from scipy import stats

ALPHA = 2e-4
INDEPENDENT = -1


def assert_fits(counts: Any, expected: Any = None) -> None:
    """Chi-square of observed counts against expected ones (equal where not given), two-sided at ALPHA."""
    counts = np.asarray(counts, dtype=np.float64).ravel()
    expected = np.full(len(counts), counts.mean()) if expected is None else np.asarray(expected, np.float64).ravel()
    expected = expected * (counts.sum() / expected.sum())
    assert expected.min() >= 5, "too few samples a bin for the chi-square distribution to hold"
    p = stats.chisquare(counts, expected).pvalue
    assert ALPHA / 2 < p < 1 - ALPHA / 2, f"p = {p:.3g}"


def binned(bins: int, *coordinates: Any) -> Any:
    """Counts of points of the unit cube in bins^n equal cells."""
    return np.histogramdd(np.stack(coordinates, -1), bins=bins, range=[(0, 1)] * len(coordinates))[0]


def keys(count: int, stream: int = 7, seed: int = 1) -> list[np.uint64]:
    return [np.uint64(path_key(seed, stream, index)) for index in range(count)]


def frame_of(normals: Any) -> tuple[Any, Any]:
    """Tangents (N, 3) of each normal, checked to be an orthonormal right-handed frame."""
    frames = np.array([tangent_frame(*map(float, normal)) for normal in normals])
    s, t = frames[:, :3], frames[:, 3:]
    np.testing.assert_allclose(np.cross(s, t), normals, atol=2e-6)
    np.testing.assert_allclose(np.einsum("ij,ij->i", s, s), 1.0, atol=2e-6)
    return s, t


def cosine_cells(directions: Any, normals: Any) -> tuple[Any, Any]:
    """Coordinates in which a cosine distribution about the normals is uniform: sin^2 theta and phi / 2 pi."""
    s, t = frame_of(normals)
    x, y, z = (np.einsum("ij,ij->i", directions, axis) for axis in (s, t, normals))
    assert z.min() >= 0
    np.testing.assert_allclose(x * x + y * y + z * z, 1.0, atol=1e-5)
    return x * x + y * y, (np.arctan2(y, x) / (2 * math.pi)) % 1.0


def points_at(position: Any, normal: Any, count: int = 1) -> Points:
    """White points at one place, each with a key of its own."""
    points = Points.empty(count)
    points.position[:], points.normal[:], points.geometric[:] = position, normal, normal
    points.albedo[:], points.weight[:] = 1, 1
    points.owner[:] = np.arange(count)
    points.key[:], points.sample[:] = keys(count), 0
    return points
