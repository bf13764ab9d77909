"""A report as files: one HTML page that holds everything it shows, and its figures and tables beside it.

The page asks nobody for anything, and its content security policy keeps it from it: charts are drawn by a
script inside it (vl-convert's bundle of Vega-Embed), and without scripts their pictures stand in.
"""

import base64
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import vl_convert
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from joulebox_server import __version__
from joulebox_server.analysis import palette
from joulebox_server.analysis.drawing import render
from joulebox_server.errors import ServerError
from joulebox_server.reports.document import Block, Chart, Fold, Picture, Pictures, Report, Section

PAGE = "report.html"
FIGURES = "figures"
GENERATOR = "joulebox report"
"""What the page names as its maker, and what tells a folder with a report from others."""
PAGE_COLOURS = {
    "#ffffff": "--card",
    palette.INK: "--ink",
    palette.MUTED: "--soft",
    palette.GRID: "--line",
    palette.GREEN: "--limit",
    palette.VERMILION: "--budget",
}
"""Colours of a chart on white paper, and the page's own that replace them where it is dark."""
_CHART_SNIPPET = "globalThis.vegaEmbed = vegaEmbed;"


class ReportError(ServerError):
    """A report cannot be written; the message says why."""


@dataclass(frozen=True)
class DrawnChart:
    """A chart with its pictures."""

    chart: Chart
    svg: bytes
    png: bytes

    @property
    def stand_in(self) -> Markup:
        """The address of the smaller of them: thousands of points make an SVG of megabytes."""
        if len(self.svg) <= len(self.png):
            return _data_address(self.svg, "image/svg+xml")
        return _data_address(self.png, "image/png")


def write(report: Report, folder: Path) -> list[Path]:
    """Write the page, its figures and its attachments into a folder, which is made; returns the files, page first.

    Raises ReportError where that cannot be, AnalysisError for a chart that cannot be drawn.
    """
    drawn = {chart.name: _draw(chart) for chart in _charts(report)}
    contents = {PAGE: html(report, drawn).encode(), **report.attachments}
    for name, figure in drawn.items():
        contents |= {f"{FIGURES}/{name}.svg": figure.svg, f"{FIGURES}/{name}.png": figure.png}
    contents |= {f"{FIGURES}/{picture.name}.png": picture.png for picture in _pictures(report)}
    written = []
    try:
        for name, content in contents.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            written.append(path)
    except OSError as error:
        raise ReportError(f"the report cannot be written to {folder}: {error.strerror}") from None
    return written


def html(report: Report, drawn: dict[str, DrawnChart]) -> str:
    """The page, given its charts' pictures by name."""
    scripts = [Markup(_chart_library()), Markup(_own("report.js"))] if drawn else []
    template = _environment().get_template("report.html.j2")
    return template.render(
        report=report,
        drawn=drawn,
        generator=f"{GENERATOR} {__version__}",
        policy=_policy(scripts),
        style=Markup(_own("report.css")),
        scripts=scripts,
        page_colours=PAGE_COLOURS,
    )


def _draw(chart: Chart) -> DrawnChart:
    spec = dict(chart.spec)
    return DrawnChart(chart, render(spec, "svg", chart.width), render(spec, "png", chart.width))


def _policy(scripts: list[Markup]) -> str:
    """Nothing from anywhere, and only these very scripts."""
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    allowed = " ".join(f"'sha256-{value}'" for value in hashes) or "'none'"
    return f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:; base-uri 'none'"


@cache
def _chart_library() -> str:
    """Vega-Embed with all it needs, as a script that leaves `vegaEmbed` behind; bundled offline in about 3 s."""
    source = str(vl_convert.javascript_bundle(_CHART_SNIPPET))
    if "</script" in source or "<!--" in source:
        raise ReportError("this vl-convert's bundle cannot stand inside a page; install the version of constraints.txt")
    return source


def _own(name: str) -> str:
    return (files("joulebox_server.reports") / "templates" / name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("joulebox_server.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_address"] = _data_address
    return environment


def _data_address(content: bytes, media_type: str) -> Markup:
    """The content as an address that holds it."""
    return Markup(f"data:{media_type};base64,{base64.b64encode(content).decode()}")


def _blocks(report: Report) -> Iterator[Block]:
    def of_section(section: Section) -> Iterator[Block]:
        for block in section.blocks:
            yield from _with_folded(block)
        for below in section.sections:
            yield from of_section(below)

    for section in report.sections:
        yield from of_section(section)


def _with_folded(block: Block) -> Iterator[Block]:
    yield block
    if isinstance(block, Fold):
        for inner in block.blocks:
            yield from _with_folded(inner)


def _charts(report: Report) -> list[Chart]:
    return _named([block for block in _blocks(report) if isinstance(block, Chart)])


def _pictures(report: Report) -> list[Picture]:
    return _named([picture for block in _blocks(report) if isinstance(block, Pictures) for picture in block.pictures])


def _named(figures: list[Any]) -> list[Any]:
    """The figures, whose names must tell them apart. Raises ReportError."""
    names = [figure.name for figure in figures]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ReportError(f"two figures of the report have the name {min(twice)!r}, each must have its own")
    return figures
