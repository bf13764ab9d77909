"""What goes through all views: live events and reconnection, tokens, new sweeps, retries, empty and broken states."""

from pathlib import Path

import pytest
from browser import opened
from fleet_fixture import Fleet, running_fleet
from playwright.sync_api import Browser, expect
from test_fleet_view import sign_in

POINTS = "#tradeoff svg .points_marks path"
PASTED = """
name = "pasted"
scenes = ["../scenes/box"]
devices = ["shelf-laptop"]
repeats = 1
[settings]
width = 64
height = 64
[axes]
gather_count = [25, 50]
"""


def test_nothing_measured_yet(browser: Browser, tmp_path: Path) -> None:
    """An empty server, every view of it; then a sweep that appears by itself and fills while the page looks on."""
    with running_fleet(tmp_path) as fresh, opened(browser, fresh.url, 390) as watched:
        page = watched.page
        expect(page.locator("#sweeps")).to_contain_text("joulebox sweep submit")
        expect(page.locator("#overview")).to_contain_text("Nothing to show yet")
        page.get_by_role("link", name="Compare").click()
        expect(page.locator("#compare")).to_contain_text("No picture to compare yet")
        page.get_by_role("link", name="Fleet").click()
        expect(page.locator("#devices")).to_contain_text("joulebox-agent enroll")
        page.get_by_role("link", name="Sweep", exact=True).click()
        expect(page.locator("#connection")).to_have_text("live")
        assert watched.overflow() <= 0
        fresh.add_scene()
        device = fresh.add_device()
        fresh.add_sweep(axes={"gather_count": [25, 100]}, repeats=1)
        expect(page.locator("#overview h2")).to_have_text("box-photons")
        expect(page.locator("#tradeoff")).to_contain_text("No point yet")
        expect(page.locator("#overview .expected")).to_contain_text("no device has taken a job yet")
        device.work(3)
        expect(page.locator("#overview .expected")).to_contain_text("Expected end: ")
        expect(page.locator("#overview .expected")).not_to_contain_text("not known")
        device.work()
        expect(page.locator("#overview")).to_contain_text("4 of 4 jobs done")
        expect(page.locator(POINTS).first).to_be_visible()
        watched.check()


@pytest.mark.long
@pytest.mark.parametrize("width", [1280, 390])
def test_a_sweep_is_pasted_previewed_and_started(browser: Browser, tmp_path: Path, width: int) -> None:
    """What is wrong is said first; then jobs, joules, time and charges; one press makes one sweep, which is shown."""
    with running_fleet(tmp_path) as fresh:
        fresh.add_scene()
        laptop = fresh.add_device(quality="measured")
        fresh.add_sweep(axes={"gather_count": [25]}, repeats=1)
        laptop.work()
        with opened(browser, fresh.url, width) as watched:
            page = watched.page
            page.get_by_text("New sweep", exact=True).click()
            text, preview = page.get_by_label("Sweep file, TOML or JSON"), page.locator("#preview")
            text.fill("name = ")
            page.get_by_role("button", name="Preview").click()
            sign_in(page, fresh.operator_token)
            expect(preview).to_contain_text("this is not valid TOML")
            text.fill(PASTED.replace("gather_count", "gather_cuont"))
            page.get_by_role("button", name="Preview").click()
            expect(preview).to_contain_text("gather_cuont")
            text.fill(PASTED)
            page.get_by_role("button", name="Preview").click()
            expect(preview).to_contain_text("../scenes/box is taken to be the scene box")
            expect(preview).to_contain_text("4: 2 to measure, 1 reference, 1 noise floor")
            expect(preview).to_contain_text("J at 12 W")
            expect(preview).to_contain_text("from 90 to 30 % each")
            assert watched.overflow() <= 0
            page.get_by_role("button", name="Start pasted").click()
            expect(page.locator("#overview h2")).to_have_text("pasted")
            assert [sweep["name"] for sweep in fresh.get("/v1/sweeps")["items"]] == ["pasted", "box-photons"]
            laptop.work()
            expect(page.locator("#overview")).to_contain_text("4 of 4 jobs done")
            expect(page.locator(POINTS)).to_have_count(2)
            assert [text for text in watched.complaints if "401" not in text and "422" not in text] == []


def test_failed_jobs_are_retried(browser: Browser, tmp_path: Path) -> None:
    with running_fleet(tmp_path) as fresh:
        fresh.add_scene()
        laptop = fresh.add_device()
        sweep = fresh.add_sweep(axes={"gather_count": [25, 50]}, repeats=1)
        laptop.work(3)
        laptop.refuse("the renderer refused gather_count = 50: this build gathers at most 30")
        fresh.wait(sweep, "failed")
        with opened(browser, fresh.url) as watched:
            page = watched.page
            expect(page.locator("#overview .error")).to_contain_text("this build gathers at most 30")
            page.get_by_role("button", name="Retry the failed job").click()
            sign_in(page, fresh.viewer_token)
            expect(page.get_by_role("dialog")).to_contain_text("a token of the role viewer may not do this")
            sign_in(page, fresh.operator_token)
            expect(page.locator("#overview")).to_contain_text("3 of 4 jobs done")
            expect(page.locator("#overview .error")).to_have_count(0)
            laptop.work()
            expect(page.locator("#overview")).to_contain_text("4 of 4 jobs done")
            assert [text for text in watched.complaints if "401" not in text and "403" not in text] == []


@pytest.mark.long
def test_a_sweep_is_paused_and_resumed(browser: Browser, tmp_path: Path) -> None:
    with running_fleet(tmp_path) as fresh:
        fresh.add_scene()
        fresh.add_device()
        fresh.add_sweep()
        with opened(browser, fresh.url) as watched:
            page = watched.page
            page.get_by_role("button", name="Pause").click()
            sign_in(page, fresh.operator_token)
            expect(page.locator("#overview .expected")).to_contain_text("the sweep is paused; resume it")
            page.get_by_role("button", name="Resume").click()
            expect(page.get_by_role("button", name="Pause")).to_be_visible()


@pytest.mark.long
def test_a_share_of_the_battery(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    """0.01 % of 48 Wh is 17.28 J for one image: the line stands there, and the answer is that of 17.28 J."""
    address = f"/#sweep={sweeps['replayed']}&budget=0.01&unit=percent&images=1"
    with opened(browser, fleet.url, path=address) as watched:
        expect(watched.page.locator("#tradeoff svg")).to_contain_text("budget 17.3 J")
        wanted = fleet.get(f"/v1/sweeps/{sweeps['replayed']}/recommendation?budget_j=17.28")["label"]
        expect(watched.page.locator("#recommendation .answer")).to_have_text(wanted)
        watched.check()


@pytest.mark.long
def test_promising_settings_are_shown_and_queued(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    """Predictions come into the chart when they are asked for, with a mark of their own."""
    with opened(browser, fleet.url, path=f"/#sweep={sweeps['sparse']}&budget=40") as watched:
        page = watched.page
        expect(page.locator(POINTS).first).to_be_visible()
        page.get_by_label("predictions too").check()
        expect(page.locator("#tradeoff svg")).to_contain_text("predicted, not measured")
        page.get_by_label("settings never measured too").check()
        expect(page.locator("#recommendation")).to_contain_text("and 1 predicted")  # not the answer from before
        expect(page.locator("#recommendation")).to_have_attribute("aria-busy", "false")
        page.get_by_role("button", name="Measure").click()
        sign_in(page, fleet.operator_token)
        expect(page.locator("#recommendation")).to_contain_text("queued; the answer changes as they arrive")


@pytest.mark.long
def test_without_energy_time_takes_its_place(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    with opened(browser, fleet.url, path=f"/#sweep={sweeps['time_only']}") as watched:
        page = watched.page
        expect(page.locator("#overview .notice")).to_contain_text("time only")
        expect(page.locator("select[name=x]")).to_have_value("time_s")
        expect(page.locator("#tradeoff svg")).to_contain_text("time per image [s]")
        page.locator("#budget-value").fill("1.5")
        expect(page.locator("#recommendation .answer")).to_contain_text("gather_count=")
        assert " J" not in (page.locator("#recommendation .facts").text_content() or "")
        page.locator(POINTS).first.click(force=True)
        expect(page.locator("#trace")).to_contain_text("timed without a meter")


@pytest.mark.long
def test_asks_for_a_token(browser: Browser, tmp_path: Path) -> None:
    """A server that lets nobody read: a wrong token is refused in words, the right one opens everything."""
    with running_fleet(tmp_path, stored=True, anonymous_reads=False) as closed, opened(browser, closed.url) as watched:
        page = watched.page
        sign_in(page, "not-a-token")
        expect(page.locator("#sign-in-error")).to_contain_text("did not open the door")
        sign_in(page, closed.viewer_token)
        expect(page.get_by_role("dialog")).to_be_hidden()
        page.get_by_role("button", name="cornell-grid").click()
        expect(page.get_by_role("heading", name="cornell-grid")).to_be_visible()  # the points are its own now
        page.locator(POINTS).first.click(force=True)
        expect(page.locator("img[data-picture=delta]")).to_be_visible()
        page.get_by_role("link", name="Compare closely").click()
        expect(page.locator("#compare")).to_contain_text("SSIM")
        expect(page.locator("#connection")).to_have_text("live")
        assert closed.viewer_token not in page.evaluate("location.href")
        assert [text for text in watched.complaints if "401" not in text] == []


def test_comes_back_after_the_server_was_away(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    """The stream breaks and later events are refused: the page polls, says so, and goes live again."""
    with opened(browser, fleet.url) as watched:
        page = watched.page
        expect(page.locator("#connection")).to_have_text("live")
        page.route("**/v1/**", lambda route: route.abort())
        page.reload()
        expect(page.locator("#sweeps .error")).to_contain_text("does not answer")
        expect(page.locator("#connection")).to_have_text("no answer")
        page.unroute("**/v1/**")
        expect(page.locator("#connection")).to_have_text("live")
        expect(page.get_by_role("button", name="box-photons")).to_be_visible()


@pytest.mark.long
def test_every_panel_says_when_it_cannot_be_drawn(browser: Browser, stored: Fleet) -> None:
    """Each part of the page fails alone, in words, with a way to try again; the others stay."""
    broken = ("charts/stages", "charts/trace", "/points/", "recommendation")
    with opened(browser, stored.url, path="/docs") as watched:
        page = watched.page
        for part in broken:
            page.route(f"**/*{part}*/**", lambda route: route.abort())
            page.route(f"**{part}**", lambda route: route.abort())
        point = stored.points("cornell-grid")[0]["configuration_id"]
        page.goto(f"{stored.url}/#sweep={stored.sweep_id('cornell-grid')}&point={point}&budget=9")
        expect(page.locator(POINTS).first).to_be_visible()
        for panel in ("#stages", "#trace", "#pictures", "#recommendation"):
            expect(page.locator(f"{panel} .error")).to_contain_text("does not answer")
        page.unroute_all()
        for panel in ("#stages", "#trace", "#pictures"):
            page.locator(panel).get_by_role("button", name="Try again").click()
        expect(page.locator("#stages svg")).to_be_visible()
        expect(page.locator("#trace svg")).to_be_visible()
        expect(page.locator("img[data-picture=test]")).to_be_visible()
