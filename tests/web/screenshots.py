"""Pictures of the dashboard at 1280 and 390 pixels, light and dark: `python tests/web/screenshots.py FOLDER`.

Over the same data set as the tests, or with `--url` over a server that runs. Exit code 1 and one sentence when
no browser is installed or a page is wider than its window.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from browser import opened, started_browser
from fleet_fixture import fill, running_fleet
from playwright.sync_api import Browser, expect

WIDTHS = {1280: 900, 390: 844}
SETTLED_MS = 400  # fonts and transitions; what is loaded is waited for by name


@contextmanager
def addresses(url: str | None) -> Iterator[dict[str, str]]:
    """Name of a picture -> address to show."""
    if url is not None:
        yield {"page": url}
        return
    with tempfile.TemporaryDirectory() as folder, running_fleet(Path(folder)) as fleet:
        sweeps = fill(fleet)
        path = f"/v1/sweeps/{sweeps['replayed']}/tradeoff"
        points = fleet.client.get(path, headers=fleet.operator).json()["points"]
        chosen = points[len(points) // 2]["configuration_id"]
        base = f"{fleet.url}/#sweep="
        yield {
            "sweep": f"{base}{sweeps['replayed']}&point={chosen}&budget=18&unit=j",
            "no-answer": f"{base}{sweeps['replayed']}&budget=0.5&unit=j",
            "time-only": f"{base}{sweeps['time_only']}&budget=1.5",
            "failed": f"{base}{sweeps['failed']}",
            "running": f"{base}{sweeps['running']}",
        }


def take(browser: Browser, address: str, target: Path, width: int, scheme: str) -> int:
    """Write one picture of the whole page; returns by how many pixels it is too wide."""
    url, _, hash_part = address.partition("/#")
    with opened(browser, url, width, WIDTHS[width], scheme, f"/#{hash_part}" if hash_part else "/") as watched:
        expect(watched.page.locator("#tradeoff svg")).to_be_visible()
        expect(watched.page.locator("#stages svg")).to_be_visible()
        if "point=" in address:
            expect(watched.page.locator("img[data-picture=delta]")).to_be_visible()
        if "budget=" in address:
            expect(watched.page.locator("#recommendation .answer")).to_be_visible()
        watched.page.wait_for_timeout(SETTLED_MS)
        watched.page.screenshot(path=target, full_page=True)
        return watched.overflow()


def main() -> int:
    """Take all pictures; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="where the PNG files go")
    parser.add_argument("--url", help="address of a running server, with its #... if wanted")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    too_wide = []
    with started_browser() as browser:
        if browser is None:
            print("no browser is installed: install chromium, or run `playwright install chromium`", file=sys.stderr)
            return 1
        with addresses(given.url) as found:
            for name, address in found.items():
                for width in WIDTHS:
                    for scheme in ("light", "dark"):
                        target = given.folder / f"{name}-{width}-{scheme}.png"
                        if take(browser, address, target, width, scheme) > 0:
                            too_wide.append(str(target))
                        print(target, flush=True)
    if too_wide:
        print(f"wider than their window: {', '.join(too_wide)}", file=sys.stderr)
    return 1 if too_wide else 0


if __name__ == "__main__":
    sys.exit(main())
