"""The convergence plot: its data says that error falls as settings rise, and it is drawn from that data."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import pytest
import vl_convert

from bench.convergence import (
    AXES,
    CPU_TIME,
    MITSUBA,
    OURS,
    PATH,
    PRESETS,
    SCENES,
    TARGET,
    TOLERANCE,
    Point,
    draw,
    read_csv,
)

# relMSE that is left with all settings of an axis at their richest, the others at BASE: eye rays at edges, the maps'
# blur, and on spheres the caustic's.
FLOOR = {"cornell-boxes": 0.0006, "cornell-spheres": 0.0015}
# A step may come out so much worse than the best before it: seeds move relMSE by a tenth near the floor.
NOISE = 1.15


@pytest.fixture(scope="module")
def points() -> list[Point]:
    return read_csv(TARGET.with_suffix(".csv"))


def errors(points: Sequence[Point], scene: str, panel: str, series: str) -> tuple[np.ndarray, np.ndarray]:
    """x and relMSE of a curve, cheapest first."""
    curve = [point for point in points if (point.scene, point.panel, point.series) == (scene, panel, series)]
    curve.sort(key=lambda point: -point.x if panel == TOLERANCE else point.x)
    return np.array([point.x for point in curve]), np.array([point.relmse for point in curve])


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("panel", AXES)
def test_error_falls_to_the_floor(points: list[Point], scene: str, panel: str) -> None:
    """Along every axis, never worse by more than noise than at a cheaper step; from well above the floor to it."""
    x, error = errors(points, scene, panel, OURS)
    assert sorted(x) == sorted(AXES[panel][1])
    best_before = np.minimum.accumulate(error)[:-1]
    assert (error[1:] <= NOISE * best_before).all(), error
    assert error[-1] <= FLOOR[scene]
    assert error[0] >= 1.5 * error[-1]


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("series", [PATH, MITSUBA])
def test_paths_err_by_the_inverse_of_their_time(points: list[Point], scene: str, series: str) -> None:
    """Without bias relMSE is a variance: a hundredfold time leaves a hundredth of it, where it is finite enough.

    On spheres few samples miss the bright paths altogether and find too little to be wrong about, so the slope, -1 of
    logarithms in the end, is shallower at first.
    """
    x, error = errors(points, scene, CPU_TIME, series)
    slope = np.polyfit(np.log(x), np.log(error), 1)[0]
    assert -1.25 < slope < (-0.8 if scene == "cornell-boxes" else -0.45), slope


@pytest.mark.parametrize("scene", SCENES)
def test_photon_mapping_beats_paths_at_equal_time(points: list[Point], scene: str) -> None:
    """Each preset errs less than either path tracer would in its time, by the line through their dots."""
    presets = [point for point in points if (point.scene, point.series) == (scene, PRESETS)]
    assert len(presets) == 3
    for series in (PATH, MITSUBA):
        x, error = errors(points, scene, CPU_TIME, series)
        for preset in presets:
            line = np.polyval(np.polyfit(np.log(x), np.log(error), 1), np.log(preset.cpu_s))
            assert preset.relmse < np.exp(line), (series, preset)


def test_the_plot_holds_every_point(points: list[Point]) -> None:
    """As a chart that vl-convert draws, with a panel for each axis and error of each scene."""
    spec = draw(points)
    rows = json.dumps(spec)
    assert all(point.settings in rows for point in points)
    svg = vl_convert.vegalite_to_svg(spec)
    assert svg.count("relMSE against converged") >= len(SCENES)  # an axis of a row, and its words for a reader
    assert {point.panel for point in points} == {*AXES, CPU_TIME}
