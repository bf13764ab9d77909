"""`make contact-sheet`: every shipped scene, and some of its variants, rendered into one labelled docs/scenes.png.

`python docs/contact_sheet.py [-o FILE] [--size PIXELS] [--set key=value ...] [SCENE ...]`; the settings default to the
balanced preset. Exit code 0, or the renderer's own with one sentence.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from joulebox_render.errors import RenderError
from joulebox_render.images import srgb_bytes
from joulebox_render.scene import list_scenes
from joulebox_render.session import Session
from joulebox_render.settings import make_settings, parse_assignments
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parent.parent
COLUMNS = 4
GAP = 8
LABEL = 18
"""[pixels] between pictures, and height of the line below each."""
VARIANTS: dict[str, list[dict[str, str]]] = {
    "cornell-bunny": [
        {"size": "small"},
        {"size": "large"},
        {"size": "large", "detail": "3850"},
        {"size": "large", "detail": "948", "flat": "true"},
    ],
    "cornell-spheres": [{"ior": "2.4", "radius": "0.07"}],
}
"""What is shown of a scene besides the scene as it is."""


def tiles(chosen: list[str]) -> list[tuple[str, dict[str, str]]]:
    """Scene and defines of every picture; all scenes when none is chosen."""
    names = chosen or [entry.name for entry in list_scenes()]
    return [(name, defines) for name in names for defines in ({}, *VARIANTS.get(name, []))]


def label(name: str, defines: dict[str, str]) -> str:
    """The scene's name, or for a variant what sets it apart."""
    return ", ".join(f"{key}={value}" for key, value in defines.items()) or name


def render(name: str, defines: dict[str, str], settings: dict[str, object]) -> Image.Image:
    """One picture, as its PNG would be."""
    with Session(name, make_settings(settings), defines) as session:
        pixels = session.render().pixels
    return Image.fromarray(np.asarray(srgb_bytes(pixels, session.settings.exposure)))


def sheet(pictures: list[tuple[str, Image.Image]], size: int) -> Image.Image:
    """All pictures in rows of COLUMNS, each above its label."""
    rows = -(-len(pictures) // COLUMNS)
    columns = min(COLUMNS, len(pictures))
    page = Image.new("RGB", (columns * (size + GAP) + GAP, rows * (size + LABEL + GAP) + GAP), "white")
    draw = ImageDraw.Draw(page)
    font = ImageFont.load_default(10)
    for i, (text, picture) in enumerate(pictures):
        x = GAP + (i % COLUMNS) * (size + GAP)
        y = GAP + (i // COLUMNS) * (size + LABEL + GAP)
        page.paste(picture, (x, y))
        draw.text((x, y + size + 2), text, fill="black", font=font)
    return page


def main(arguments: list[str]) -> int:
    """Render and write the sheet."""
    parser = argparse.ArgumentParser(prog="contact_sheet", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="default: all shipped scenes")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "scenes.png")
    parser.add_argument("--size", type=int, default=160, help="width and height of a picture [pixels]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the renderer")
    given = parser.parse_args(arguments)
    settings = {"width": given.size, "height": given.size, **parse_assignments(given.set)}
    pictures = []
    for name, defines in tiles(given.scenes):
        start = time.monotonic()
        pictures.append((label(name, defines), render(name, defines, settings)))
        print(f"{name} {label(name, defines) if defines else ''}: {time.monotonic() - start:.1f} s", flush=True)
    sheet(pictures, given.size).save(given.output, optimize=True)
    print(f"{given.output} shows {len(pictures)} pictures.")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except RenderError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
