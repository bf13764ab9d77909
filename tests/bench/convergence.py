"""Error against what is spent: photons, gather rays, tolerance, samples, CPU time; `make convergence`.

    python -m tests.bench.convergence [--size PIXELS] [--redraw] [-o docs/convergence.png]

Writes <output>.csv (the data), .svg and .png. --redraw draws the data there are. On 128 x 128 pixels, which takes two
CPU minutes, unless --size says otherwise (0: the scene's film); references are averaged down.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import altair as alt
import vl_convert
from joulebox_render.bench import shrink
from joulebox_render.errors import RenderError
from joulebox_render.settings import Settings
from joulebox_server.analysis import palette

from . import mitsuba_side
from .candidates import NAMED, Values, measure
from .references import load_reference
from .rivals import mitsuba_curve

TARGET = Path(__file__).resolve().parents[2] / "docs" / "convergence.png"
SCENES = ("cornell-boxes", "cornell-spheres")
SIZE = 128
CPU_TIME, TOLERANCE = "CPU seconds", "cache tolerance"
# Each setting is varied with the others rich enough that its own error shows, down to the floor: of eye rays above all,
# whose error at the edges of things hides all others in a picture of few.
BASE: Values = {"samples_per_pixel": 16, "shadow_rays": 4, "final_gather_rays": 256, "global_photons": 200_000}
AXES: dict[str, tuple[str, Sequence[Any], Values]] = {
    "photons": ("global_photons", (1_000, 4_000, 16_000, 64_000, 256_000), {}),
    "gather rays": ("final_gather_rays", (1, 4, 16, 64), {"irradiance_cache_tolerance": 0.0}),
    # Records of few rays are noisy: one sees the tolerance's own error where each has many.
    TOLERANCE: ("irradiance_cache_tolerance", (3.2, 1.6, 0.8, 0.4), {"final_gather_rays": 1024}),
    "samples a pixel": (
        "samples_per_pixel",
        (1, 4, 9, 16, 25),
        {"irradiance_cache_tolerance": 0.0, "final_gather_rays": 16},
    ),
}
OURS, PRESETS, PATH, MITSUBA = "photon mapping", "its presets", "path", "Mitsuba path"
COLOURS = {OURS: palette.BLUE, PRESETS: palette.INK, PATH: palette.GREEN, MITSUBA: palette.VERMILION}
# On the time panel: the presets, and all that makes a picture better raised together.
NAMED_ONES: list[Values] = [{"preset": name} for name in NAMED]
TIMES: list[Values] = [
    {"samples_per_pixel": s, "shadow_rays": r, "final_gather_rays": r, "global_photons": p}
    for s, r, p in ((1, 4, 20_000), (4, 4, 50_000), (4, 9, 50_000), (9, 9, 100_000), (9, 16, 200_000),
                    (16, 36, 500_000))
]  # fmt: skip
PATHS: list[Values] = [{"indirect": "path", "shadow_rays": 4, "samples_per_pixel": s} for s in (1, 4, 16, 64, 256)]
MITSUBA_UNTIL_FLIP = 0.06
ERRORS = {"relmse": "relMSE", "flip": "FLIP"}
PANEL_WIDTH, PANEL_HEIGHT = 190, 170


class Point(NamedTuple):
    """A dot of the plot: `x` of its panel, and what it cost and erred."""

    scene: str
    panel: str
    series: str
    settings: str
    x: float
    cpu_s: float
    relmse: float
    flip: float


class LogAxis(NamedTuple):
    """A logarithmic axis: its ends and where its ticks are."""

    domain: tuple[float, float]
    ticks: list[float]


def sweep(scene: str, size: int, say: Callable[[str], None]) -> Iterator[Point]:
    """All points of one scene."""
    reference = load_reference(scene)
    assert reference, f"{scene} carries its reference"
    truth = shrink(reference.pixels, size or None)
    film = {"width": size, "height": size} if size else {}
    for panel, (setting, steps, others) in AXES.items():
        for step in steps:
            values = without_unknown({**BASE, **others}, setting) | {setting: step}
            found = measure(scene, values, truth, say, film, f"{setting}={step}", turns=0)
            if found is None:
                break
            yield Point(scene, panel, OURS, found.name, step, found.cpu_s, found.relmse, found.flip)
    for series, configurations in ((PRESETS, NAMED_ONES), (OURS, TIMES), (PATH, PATHS)):
        for configuration in configurations:
            if found := measure(scene, configuration, truth, say, film):
                cpu_s = found.cpu_s
                yield Point(scene, CPU_TIME, series, found.name, cpu_s, cpu_s, found.relmse, found.flip)
    if mitsuba_side.variant() != mitsuba_side.LLVM:
        say(mitsuba_side.NO_LLVM)
        return
    for each in mitsuba_curve(scene, truth, MITSUBA_UNTIL_FLIP, say, size):
        yield Point(scene, CPU_TIME, MITSUBA, each.name, each.cpu_s, each.cpu_s, each.relmse, each.flip)


def without_unknown(values: Values, kept: str) -> dict[str, Any]:
    """The values whose settings this version has, so that only the axis itself can be unknown."""
    return {name: value for name, value in values.items() if name in Settings.model_fields or name == kept}


def draw(points: Sequence[Point]) -> dict[str, Any]:
    """The figure: a row for each scene and error, a panel for each axis."""
    rows = []
    names = list(dict.fromkeys(point.panel for point in points))
    for scene in dict.fromkeys(point.scene for point in points):
        here = [point for point in points if point.scene == scene]
        for error, title in ERRORS.items():
            y = log_axis([getattr(point, error) for point in here])
            panels = [draw_panel([point for point in here if point.panel == name], name, error, y) for name in names]
            rows.append(alt.hconcat(*panels, title=alt.TitleParams(f"{scene}: {title} against converged")))
    spec: dict[str, Any] = alt.vconcat(*rows).resolve_scale(color="shared").to_dict()
    spec["config"] = palette.config()
    return spec


def draw_panel(points: Sequence[Point], panel: str, error: str, y: LogAxis) -> Any:
    """Error over one axis, both logarithmic; to the right is always the dearer side."""
    x = log_axis([point.x for point in points])
    rows = [point._asdict() for point in points]
    base = alt.Chart(alt.InlineData(values=rows)).encode(
        x=alt.X("x:Q", title=panel, axis=alt.Axis(values=x.ticks, format="~s" if x.domain[0] >= 1 else "~g",
                                                  labelOverlap="greedy"),
                scale=alt.Scale(type="log", domain=x.domain, nice=False, reverse=panel == TOLERANCE)),
        y=alt.Y(f"{error}:Q", title=ERRORS[error], axis=alt.Axis(values=y.ticks, format="~g"),
                scale=alt.Scale(type="log", domain=y.domain, nice=False)),
        color=alt.Color("series:N", title=None, scale=alt.Scale(domain=list(COLOURS), range=list(COLOURS.values()))),
    )  # fmt: skip
    swept = base.transform_filter(alt.datum.series != PRESETS)
    named = base.transform_filter(alt.datum.series == PRESETS)
    parts = [
        swept.mark_line(strokeWidth=1.5, opacity=0.6),
        swept.mark_point(filled=True, size=36, opacity=1),
        named.mark_point(filled=True, size=80, shape="diamond", opacity=1),
        named.mark_text(align="left", dx=6, dy=-6, fontSize=11).encode(text="settings:N"),
    ]
    return alt.layer(*parts).properties(width=PANEL_WIDTH, height=PANEL_HEIGHT)


def log_axis(values: Sequence[float]) -> LogAxis:
    """A logarithmic axis that holds all values with a little room, and ticks at 1, 2 and 5 times powers of ten."""
    low, high = 0.8 * min(values), 1.25 * max(values)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if high / low < 300 else (1,)
    ticks = [float(f"{step}e{decade}") for decade in decades for step in steps]
    return LogAxis((low, high), [tick for tick in ticks if low <= tick <= high])


def write_csv(file: Path, points: Sequence[Point]) -> None:
    """The data, a row a point."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(Point._fields)
        writer.writerows(tuple(f"{v:.6g}" if isinstance(v, float) else v for v in point) for point in points)


def read_csv(file: Path) -> list[Point]:
    """What write_csv wrote."""
    with file.open(encoding="utf-8", newline="") as stream:
        return [
            Point(row["scene"], row["panel"], row["series"], row["settings"],
                  *(float(row[name]) for name in ("x", "cpu_s", "relmse", "flip")))
            for row in csv.DictReader(stream)
        ]  # fmt: skip


def write_figure(file: Path, points: Sequence[Point]) -> None:
    """PNG and SVG beside each other."""
    spec = json.dumps(draw(points))
    file.with_suffix(".svg").write_text(vl_convert.vegalite_to_svg(spec), encoding="utf-8")
    file.write_bytes(vl_convert.vegalite_to_png(spec, scale=1.5))


def main() -> int:
    """Measure, write the data, draw."""
    parser = argparse.ArgumentParser(prog="convergence", description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=SIZE, help=f"pixels across and down (default {SIZE}; 0: the film)")
    parser.add_argument("--redraw", action="store_true", help="draw the data there are")
    parser.add_argument("-o", "--output", type=Path, default=TARGET, help="the PNG; its CSV and SVG go beside it")
    given = parser.parse_args()
    start = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - start:5.0f} s] {text}", file=sys.stderr, flush=True)

    data = given.output.with_suffix(".csv")
    try:
        if not given.redraw:
            points = [point for scene in SCENES for point in sweep(scene, given.size, say)]
            write_csv(data, points)
        elif not data.is_file():
            parser.error(f"there is no {data} to redraw; run without --redraw first")
        write_figure(given.output, read_csv(data))
    except RenderError as error:
        print(f"convergence: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("convergence: interrupted; nothing was written", file=sys.stderr)
        return 130
    say(f"written: {given.output} with its .csv and .svg")
    return 0


if __name__ == "__main__":
    sys.exit(main())
