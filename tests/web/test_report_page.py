"""A sweep's report opened as a file in a real browser: it draws its charts and asks nobody for anything."""

from pathlib import Path

import pytest

pytest.importorskip("playwright.sync_api", reason="the report's tests need the playwright package")

from browser import opened
from fleet_fixture import running_fleet
from joulebox_server.reports.gathering import Asked, gather
from joulebox_server.reports.page import write
from joulebox_server.reports.sweep import sweep_report
from playwright.sync_api import Browser, expect


@pytest.fixture(scope="module")
def page_file(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a sweep that two devices measured."""
    folder = tmp_path_factory.mktemp("report")
    with running_fleet(folder) as fleet:
        fleet.add_scene()
        devices = [fleet.add_device("shelf-laptop"), fleet.add_device("handheld", power_w=5.0)]
        sweep = fleet.add_sweep(devices=["shelf-laptop", "handheld"])
        for device in devices:
            device.work()
        fleet.wait(sweep, "done")

        def ask(path: str, parameters: object) -> bytes:
            answer = fleet.client.get(f"/v1{path}", params=parameters, headers=fleet.operator)
            assert answer.is_success, answer.text
            return bytes(answer.content)

        return write(sweep_report([gather(ask, sweep, Asked())]), folder / "out")[0]


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_the_page_alone(browser: Browser, page_file: Path, width: int, scheme: str) -> None:
    """Every chart becomes a live one in the page's colours; no console message, no request, no wide page."""
    with opened(browser, "file://", width, scheme=scheme, path=str(page_file)) as watched:
        page = watched.page
        drawings = page.locator(".drawing")
        expect(drawings).to_have_count(5)
        for drawing in drawings.all():
            drawing.scroll_into_view_if_needed()
            expect(drawing.locator("svg")).to_be_visible()
            expect(drawing.locator("img")).to_have_count(0)
            assert (drawing.locator("svg").first.get_attribute("aria-label") or "").strip()
        for picture in page.locator(".pictures img").all():
            assert picture.evaluate("image => image.naturalWidth") == 64
        assert watched.overflow() <= 0
        watched.check()


def test_without_scripts_the_pictures_of_the_charts_stand_in(browser: Browser, page_file: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    try:
        page = context.new_page()
        page.goto(f"file://{page_file}")
        expect(page.locator(".drawing > img")).to_have_count(5)
        expect(page.locator(".drawing > img").first).to_be_visible()
    finally:
        context.close()
