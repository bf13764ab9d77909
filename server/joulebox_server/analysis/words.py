"""Figures and settings in words."""

from collections.abc import Mapping
from typing import Any

WRITTEN_OUT_BELOW = 1e12


def figure(value: float) -> str:
    """Three significant digits, thousands separated: 0.0123, 1.23, 123, 12,300; 1e+12 and what no text has room for."""
    if value == 0:
        return "0"
    rounded = float(f"{value:.3g}")
    if 100 <= abs(rounded) < WRITTEN_OUT_BELOW:
        return f"{rounded:,.0f}"
    return f"{rounded:.3g}"


def share(value: float) -> str:
    """A share in per cent: 0.4 %, 12 %."""
    percent = 100 * value
    return f"{percent:.1f} %" if abs(percent) < 10 else f"{percent:.0f} %"


def setting(value: object) -> str:
    """A setting's value: numbers with thousands separated, words as they are."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def settings(values: Mapping[str, Any]) -> str:
    """Settings as `name value, name value`."""
    return ", ".join(f"{name} {setting(value)}" for name, value in values.items())


def quality_suffix(quality: str) -> str:
    """What the title of joules adds: nothing where they were measured or there are none."""
    return "" if quality in ("measured", "time_only") else f", {quality}"
