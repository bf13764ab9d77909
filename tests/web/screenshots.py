"""Pictures of the dashboard's views at 1280 and 390 pixels: `python tests/web/screenshots.py FOLDER`.

Over the recorded sweeps of the tests, light and dark; with `--docs` only those that docs/dashboard.md shows. With
`--url` over a server that runs. Exit code 1 and one sentence when no browser is installed or a page is wider than
its window.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from browser import opened, started_browser
from fleet_fixture import Fleet, running_fleet
from playwright.sync_api import Browser, expect
from stored import FAILED, GRID

HEIGHTS = {1280: 900, 390: 844}
SCHEMES = ("light", "dark")
SETTLED_MS = 700  # fonts, transitions, the last chart; what is loaded is waited for by name
IN_DOCS = {
    ("sweep", 1280, "light"), ("sweep", 390, "dark"), ("failed", 390, "light"), ("fleet", 1280, "light"),
    ("compare", 1280, "light"), ("slider", 1280, "dark"), ("map", 390, "light"),
}  # fmt: skip

# Name of a picture -> its address over the recorded sweeps, and what is there once it has drawn itself.
VIEWS = {
    "fleet": ("view=fleet", [".devices li"]),
    "sweep": (
        f"sweep={GRID}&point={{point}}&budget=9",
        ["#recommendation .answer", "img[data-picture=delta]", "#trace svg", "#stages svg"],
    ),
    "no-answer": (f"sweep={GRID}&budget=0.5", ["#recommendation .answer", "#stages svg"]),
    "failed": (f"sweep={FAILED}", ["#overview .error", "#stages svg"]),
    "compare": (f"view=compare&sweep={GRID}&point={{point}}&zoom=4&at=33,32", ["#compare .facts"]),
    "slider": (f"view=compare&sweep={GRID}&point={{point}}&mode=slider&zoom=8", ["#compare .facts"]),
    "map": (f"view=compare&sweep={GRID}&point={{point}}&mode=map", ["#compare .facts"]),
}


@contextmanager
def addresses(url: str | None) -> Iterator[dict[str, tuple[str, list[str]]]]:
    """Name of a picture -> address to show, and what to wait for."""
    if url is not None:
        yield {"page": (url, ["#tradeoff svg, #tradeoff canvas, .devices li, #compare .facts"])}
        return
    with tempfile.TemporaryDirectory() as folder, running_fleet(Path(folder), stored=True) as fleet:
        yield {name: (f"{fleet.url}/#{_filled(fleet, part)}", drawn) for name, (part, drawn) in VIEWS.items()}


def _filled(fleet: Fleet, part: str) -> str:
    """An address with the ids of this server: names of sweeps serve as ids, points have no names."""
    return part.format(point=fleet.points(GRID)[3]["configuration_id"])


def take(browser: Browser, shown: tuple[str, list[str]], target: Path, width: int, scheme: str) -> int:
    """Write one picture of the whole page; returns by how many pixels it is too wide."""
    address, drawn = shown
    url, _, hash_part = address.partition("/#")
    with opened(browser, url, width, HEIGHTS[width], scheme, f"/#{hash_part}" if hash_part else "/") as watched:
        for selector in drawn:
            expect(watched.page.locator(selector).first).to_be_visible(timeout=20_000)
        watched.page.wait_for_timeout(SETTLED_MS)
        watched.page.screenshot(path=target, full_page=True)
        watched.check()
        return watched.overflow()


def main() -> int:
    """Take all pictures; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="where the PNG files go")
    parser.add_argument("--url", help="address of a running server, with its #... if wanted")
    parser.add_argument("--docs", action="store_true", help="only those that docs/dashboard.md shows")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    too_wide = []
    with started_browser() as browser:
        if browser is None:
            print("no browser is installed: install chromium, or run `playwright install chromium`", file=sys.stderr)
            return 1
        with addresses(given.url) as found:
            for name, width, scheme in ((n, w, s) for n in found for w in HEIGHTS for s in SCHEMES):
                if given.docs and (name, width, scheme) not in IN_DOCS:
                    continue
                target = given.folder / f"dashboard-{name}-{width}-{scheme}.png"
                if take(browser, found[name], target, width, scheme) > 0:
                    too_wide.append(str(target))
                print(target, flush=True)
    if too_wide:
        print(f"wider than their window: {', '.join(too_wide)}", file=sys.stderr)
    return 1 if too_wide else 0


if __name__ == "__main__":
    sys.exit(main())
