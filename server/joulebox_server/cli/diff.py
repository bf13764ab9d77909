"""`joulebox diff`: how much a picture differs from its reference."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from joulebox_server.analysis.difference import METRIC, VERSION, Difference, Display, compare, delta_image
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.images import Picture, encode_png, read_picture
from joulebox_server.analysis.opinions import second_opinions, yee_failing_share


def diff(
    reference: Annotated[Path, typer.Argument(help="EXR or NPY (linear) or PNG (sRGB).")],
    test: Annotated[Path, typer.Argument(help="The picture to judge, of the same size.")],
    delta: Annotated[
        Path | None, typer.Option(help="Write the delta image here, a PNG: black is equal, white 10 JND.")
    ] = None,
    exposure: Annotated[float, typer.Option(help="Factor on the linear values of both.")] = 1.0,
    ppd: Annotated[
        float | None, typer.Option(help="Pixels per degree; the short side fills 8 degrees unless given.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    yee: Annotated[bool, typer.Option("--yee", help="Ask Yee's metric as well; slow.")] = False,
) -> None:
    """Difference of TEST to REFERENCE on a perceptual scale, with second opinions."""
    display = Display(exposure=exposure, pixels_per_degree=ppd)
    pictures = read_picture(reference), read_picture(test)
    result = compare(*pictures, display)
    document = difference_document(*pictures, result, display, yee)
    if delta is not None:
        _write_delta(delta, result)
    if as_json:
        typer.echo(json.dumps(document, indent=1))
    else:
        _print_table(document, reference, test, delta)


def difference_document(
    reference: Picture, test: Picture, result: Difference, display: Display, yee: bool = False
) -> dict[str, Any]:
    """The document of `joulebox diff --json`."""
    opinions = second_opinions(reference, test, display.exposure)
    document: dict[str, Any] = {
        "metric": METRIC,
        "version": VERSION,
        "value": result.value,
        "value_per_pixel": result.value_per_pixel,
        "max_jnd": result.max_jnd,
        "p99_jnd": result.p99_jnd,
        "share_above_3_jnd": result.share_above_3_jnd,
        "limit": result.limit,
        "acceptable": result.acceptable,
        **opinions.document(),
    }
    if yee:
        document["yee_failing_share"] = yee_failing_share(reference, test, display.exposure)
    document["display"] = display.document(*result.jnd.shape)
    return document


def _write_delta(path: Path, result: Difference) -> None:
    try:
        path.write_bytes(encode_png(delta_image(result.jnd)))
    except OSError as error:
        raise AnalysisError(f"the delta image cannot be written to {path}: {error.strerror}") from None


def _print_table(document: dict[str, Any], reference: Path, test: Path, delta: Path | None) -> None:
    console = Console()
    table = Table(title=escape(f"{test} against {reference}"), title_justify="left", show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_column()
    verdict = "acceptable" if document["acceptable"] else "not acceptable"
    rows = [
        (
            f"difference ({METRIC} {VERSION})",
            f"{document['value']:,.2f}",
            f"{verdict}: limit {document['limit']:,.4g}",
        ),
        ("per pixel", f"{document['value_per_pixel']:.3g}", ""),
        ("largest, 99th percentile", f"{document['max_jnd']:.2f}, {document['p99_jnd']:.2f}", "JND"),
        ("pixels above 3 JND", f"{document['share_above_3_jnd']:.2%}", ""),
        ("FLIP", f"{document['flip_mean']:.4f}", "mean at 67 pixels per degree; 0 is equal"),
        ("SSIM", f"{document['ssim']:.4f}", "1 is equal"),
        ("RMSE in sRGB", f"{document['rmse_srgb']:.4f}", ""),
        ("relMSE", f"{document['relmse']:.3g}", "linear, worst 0.1 % of pixels dropped"),
    ]
    if "yee_failing_share" in document:
        rows.append(("Yee", f"{document['yee_failing_share']:.2%}", "of pixels differ visibly"))
    for row in rows:
        table.add_row(*row)
    console.print(table)
    console.print(
        f"{METRIC}: in the manner of ltdiff, not ltdiff itself. Acceptable does not mean invisible: "
        "a uniform difference at the limit is about 3.5 just noticeable differences (JND)."
    )
    if delta is not None:
        console.print(f"delta image: {escape(str(delta))} (black is equal, white 10 JND)")
