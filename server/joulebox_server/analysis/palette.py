"""Colours and type of the charts, safe for colour-blind readers (Okabe & Ito 2008)."""

from typing import Any

INK = "#1f2933"
MUTED = "#7b8794"
GRID = "#e4e7eb"
BLUE = "#0072b2"
VERMILION = "#d55e00"
GREEN = "#009e73"

CATEGORIES = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#000000"]
"""Okabe & Ito's set, in an order whose first members stay apart in grey as well."""

STAGES = {
    "photon_map": "#0072b2",
    "precomputed_irradiance": "#56b4e9",
    "direct": "#e69f00",
    "indirect": "#009e73",
    "caustics": "#cc79a7",
}

FONT = "Inter, Helvetica Neue, Helvetica, Arial, Liberation Sans, DejaVu Sans, sans-serif"


def config() -> dict[str, Any]:
    """Vega-Lite configuration that every chart shares."""
    return {
        "background": "#ffffff",
        "font": FONT,
        "view": {"stroke": None},
        "axis": {
            "labelColor": INK,
            "titleColor": INK,
            "titleFontWeight": "normal",
            "labelFontSize": 12,
            "titleFontSize": 13,
            "titlePadding": 10,
            "gridColor": GRID,
            "domainColor": MUTED,
            "tickColor": MUTED,
            "labelFlush": False,
        },
        "legend": {
            "labelColor": INK,
            "titleColor": INK,
            "titleFontWeight": "normal",
            "labelFontSize": 12,
            "titleFontSize": 12,
            "labelLimit": 260,
            "titleLimit": 260,
            "symbolSize": 90,
            "orient": "bottom",
            "columns": 4,
            "padding": 4,
            "layout": {"bottom": {"direction": "vertical", "anchor": "start", "margin": 8}},
        },
        "title": {
            "color": INK,
            "anchor": "start",
            "fontSize": 15,
            "fontWeight": 600,
            "subtitleColor": MUTED,
            "subtitleFontSize": 12,
            "subtitlePadding": 4,
            "offset": 14,
        },
    }
