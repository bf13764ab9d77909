"""A chart's specification as a picture. Imports no more than that takes: it runs in a process of its own."""

import json
from typing import Any, Literal

import vl_convert

from joulebox_server.analysis.errors import AnalysisError

VEGA_LITE = "6.4"
_MIN_WIDTH, _MAX_WIDTH = 200, 4000


def render(spec: dict[str, Any], file_format: Literal["svg", "png"], width: int = 800) -> bytes:
    """A specification as a picture, `width` pixels wide inside the axes; PNG at twice that density.

    Raises AnalysisError for a format or width that cannot be, and for a specification that Vega refuses.
    """
    if not _MIN_WIDTH <= width <= _MAX_WIDTH:
        raise AnalysisError(f"the width is {width} pixels, it must be from {_MIN_WIDTH} to {_MAX_WIDTH}")
    sized = json.dumps(spec | {"width": width, "autosize": {"type": "pad"}})
    try:
        if file_format == "svg":
            return str(vl_convert.vegalite_to_svg(sized, vl_version=VEGA_LITE)).encode()
        if file_format == "png":
            return bytes(vl_convert.vegalite_to_png(sized, vl_version=VEGA_LITE, scale=2))
    except ValueError as error:
        raise AnalysisError(f"the chart cannot be drawn: {str(error).splitlines()[0]}") from None
    raise AnalysisError(f"the format is {file_format}, it must be svg or png")
