"""axe-core finds no serious fault in any view, light or dark, wide or narrow; the stored palette stays apart."""

from itertools import combinations

import numpy as np
import pytest
from browser import opened
from fleet_fixture import Fleet
from joulebox_server.analysis import palette
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page, expect
from stored import FAILED, GRID

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core comes with axe-playwright-python")

SERIOUS = ("serious", "critical")


def addresses(stored: Fleet) -> dict[str, tuple[str, str]]:
    """Name of a view -> its address, and what is there once it has drawn itself."""
    grid, point = stored.sweep_id(GRID), stored.points(GRID)[3]["configuration_id"]
    return {
        "fleet": ("/#view=fleet", ".devices li"),
        "sweep": (f"/#sweep={grid}&point={point}&budget=9", "img[data-picture=delta]"),
        "failed": (f"/#sweep={stored.sweep_id(FAILED)}&budget=1", "#recommendation .answer"),
        "compare": (f"/#view=compare&sweep={grid}&point={point}&zoom=4&at=20,30", "#compare .facts"),
        "slider": (f"/#view=compare&sweep={grid}&point={point}&mode=slider", "#compare .facts"),
    }


def serious_faults(page: Page) -> list[str]:
    """What axe-core finds on the page as it is, in its own words."""
    return [
        f"{fault['id']}: {node['html']}: {node['failureSummary']}"
        for fault in axe.Axe().run(page).response["violations"]
        if fault["impact"] in SERIOUS
        for node in fault["nodes"]
    ]


@pytest.mark.long
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
@pytest.mark.parametrize("view", ["fleet", "sweep", "failed", "compare", "slider"])
def test_axe_finds_no_serious_fault(browser: Browser, stored: Fleet, view: str, width: int, scheme: str) -> None:
    address, drawn = addresses(stored)[view]
    with opened(browser, stored.url, width, scheme=scheme, path=address) as watched:
        expect(watched.page.locator(drawn).first).to_be_visible()
        if view in ("sweep", "failed"):
            expect(watched.page.locator("#stages svg")).to_be_visible()
            watched.page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert serious_faults(watched.page) == []


@pytest.mark.long
@pytest.mark.parametrize("view", ["dialog", "new-sweep"])
def test_axe_in_forms(browser: Browser, stored: Fleet, view: str) -> None:
    with opened(browser, stored.url, path="/#view=fleet" if view == "dialog" else "/") as watched:
        page = watched.page
        if view == "dialog":
            page.get_by_role("button", name="Enrol a device").click()
            expect(page.get_by_role("dialog")).to_be_visible()
        else:
            page.get_by_text("New sweep", exact=True).click()
        assert serious_faults(page) == []


# Linear RGB as a dichromat sees it: Machado, Oliveira, Fernandes 2009, table 1, severity 1.
SIGHT = {
    "trichromat": [1, 0, 0, 0, 1, 0, 0, 0, 1],
    "protanope": [0.152286, 1.052583, -0.204868, 0.114503, 0.786281, 0.099216, -0.003882, -0.048116, 1.051998],
    "deuteranope": [0.367322, 0.860646, -0.227968, 0.280085, 0.672501, 0.047413, -0.01182, 0.04294, 0.968881],
    "tritanope": [1.255528, -0.076749, -0.178779, -0.078411, 0.930809, 0.147602, 0.004733, 0.691367, 0.3039],
}
LEAST_APART = 8.0
"""CIE 1976 colour difference; 2.3 is just noticeable, and stages lie side by side in a bar with a legend below."""


def lab(colour: str, sight: list[float]) -> NDArray[np.float64]:
    """CIE L*a*b* (D65) of an sRGB colour as somebody sees it."""
    encoded = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.reshape(sight, (3, 3)) @ linear, 0, 1)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(to_xyz @ seen / [0.9505, 1.0, 1.089])
    found: NDArray[np.float64] = np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])
    return found


@pytest.mark.parametrize("sight", SIGHT)
def test_stages_stay_apart_for_every_eye(sight: str) -> None:
    for one, other in combinations(palette.STAGES.values(), 2):
        apart = float(np.linalg.norm(lab(one, SIGHT[sight]) - lab(other, SIGHT[sight])))
        assert apart > LEAST_APART, (one, other)
