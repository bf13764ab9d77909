"""The dashboard in a real browser, on the real server, over a data set that came in through its HTTP interface."""

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("playwright.sync_api", reason="the dashboard's tests need the playwright package")

from browser import Watched, opened, started_browser
from fleet_fixture import Fleet, fill, running_fleet
from playwright.sync_api import Browser, Page, expect

POINTS = "#tradeoff svg .points_marks path"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with started_browser() as found:
        if found is None:
            pytest.skip("no browser is installed: chromium, chromium-browser, google-chrome or Playwright's own")
        yield found


@pytest.fixture(scope="module")
def fleet(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """One server for the module; after `browser`, so that nothing is made where nothing can look at it."""
    with running_fleet(tmp_path_factory.mktemp("fleet")) as running:
        yield running


@pytest.fixture(scope="module")
def sweeps(fleet: Fleet) -> dict[str, str]:
    return fill(fleet)


def choose_first_point(page: Page) -> None:
    """Click the middle of the first point of the chart, as a finger would."""
    expect(page.locator(POINTS).first).to_be_visible()
    # Forced: the mark's own shape may be covered by its error bars. A click also survives a chart that is redrawn.
    page.locator(POINTS).first.click(force=True)


def expect_three_pictures(page: Page) -> None:
    for kind in ("reference", "test", "delta"):
        picture = page.locator(f"img[data-picture={kind}]")
        expect(picture).to_be_visible()
        assert (picture.get_attribute("alt") or "").strip()
        page.wait_for_function(
            "kind => document.querySelector(`img[data-picture=${kind}]`)?.naturalWidth > 0", arg=kind
        )


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_from_the_list_to_a_recommendation(
    browser: Browser, fleet: Fleet, sweeps: dict[str, str], width: int, scheme: str
) -> None:
    with opened(browser, fleet.url, width, scheme=scheme) as watched:
        page = watched.page
        page.get_by_role("button", name="box-photons").click()
        expect(page.get_by_role("heading", name="box-photons")).to_be_visible()
        expect(page.locator("#overview .notice").first).to_contain_text("replayed joules")
        for badge in page.locator("[data-quality]").all():
            expect(badge).to_have_text("replayed joules")
        expect(page.locator("#stages svg")).to_be_visible()
        expect(page.locator(POINTS)).to_have_count(9)

        choose_first_point(page)
        expect_three_pictures(page)
        expect(page.locator("#pictures")).to_contain_text("J replayed")
        expect(page.locator("#pictures .facts").first).to_contain_text("SSIM")
        expect(page.locator("#tradeoff .ring")).to_be_visible()

        page.get_by_label("Budget", exact=True).fill("18")
        expect(page.locator("#recommendation .answer")).to_contain_text("gather_count=")
        expect(page.locator("#recommendation")).to_contain_text("J replayed")
        expect(page.locator("#recommendation")).to_contain_text("Why")
        expect(page.locator("#tradeoff svg")).to_contain_text("budget 18 J")

        page.get_by_label("Budget", exact=True).fill("0.5")
        expect(page.locator("#recommendation")).to_contain_text("No setting meets this budget")
        expect(page.locator("#recommendation")).to_contain_text("nearest two")
        assert watched.overflow() <= 0
        watched.check()


def test_a_ring_marks_the_chosen_point(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    """Within 3 pixels: half a point's width, and less than the distance of any two points."""
    with opened(browser, fleet.url, path=f"/#sweep={sweeps['replayed']}") as watched:
        choose_first_point(watched.page)
        ring = watched.page.locator("#tradeoff .ring")
        expect(ring).to_be_visible()
        label = watched.page.locator("tr.chosen button").text_content()
        assert label
        middles = watched.page.evaluate(
            """selector => [document.querySelector("#tradeoff .ring"), document.querySelector(selector)].map((node) => {
                const box = node.getBoundingClientRect();
                return [box.x + box.width / 2, box.y + box.height / 2];
            })""",
            POINTS,
        )
        assert middles[0] == pytest.approx(middles[1], abs=3)


def test_watt_hours_for_many_images(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    """5 Wh for 1000 images are 18 J for one: the same answer as 18 J, and the line at 18 J."""
    with opened(browser, fleet.url, path=f"/#sweep={sweeps['replayed']}&budget=18&unit=j") as watched:
        page = watched.page
        answer = page.locator("#recommendation .answer")
        by_joules = answer.text_content()
        page.get_by_label("Budget", exact=True).fill("5")
        page.get_by_label("Unit of the budget").select_option("wh")
        page.get_by_label("for", exact=True).fill("1000")
        expect(page.locator("#tradeoff svg")).to_contain_text("budget 18 J")
        expect(answer).to_have_text(by_joules or "")
        watched.check()


def test_a_link_reproduces_the_view(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    with opened(browser, fleet.url) as watched:
        page = watched.page
        page.get_by_role("button", name="box-photons").click()
        page.locator("select[name=scene]").select_option("hall")
        page.locator("select[name=x]").select_option("time_s")
        page.locator("select[name=scale]").select_option("linear")
        expect(page.locator("#tradeoff svg")).to_contain_text("time per image")
        expect(page.locator("#tradeoff svg")).to_contain_text("hall on shelf-laptop")
        choose_first_point(page)
        expect_three_pictures(page)
        page.get_by_label("Exposure").fill("1.5")
        page.get_by_label("Exposure").press("Enter")
        page.get_by_label("Unit of the budget").select_option("s")
        page.get_by_label("Budget", exact=True).fill("1.5")
        expect(page.locator("#recommendation .answer")).to_be_visible()
        page.wait_for_function("location.hash.includes('budget=1.5')")
        address = page.evaluate("location.pathname + location.hash")
        told = page.locator(".chosen-point").text_content()
        answer = page.locator("#recommendation").text_content()
        watched.check()
    with opened(browser, fleet.url, path=address) as watched:
        page = watched.page
        expect_three_pictures(page)
        expect(page.locator("select[name=scene]")).to_have_value("hall")
        expect(page.locator("select[name=x]")).to_have_value("time_s")
        expect(page.locator("select[name=scale]")).to_have_value("linear")
        expect(page.get_by_label("Exposure")).to_have_value("1.5")
        expect(page.locator("#tradeoff svg")).to_contain_text("time per image")
        expect(page.locator(".chosen-point")).to_have_text(told or "")
        expect(page.locator("#recommendation")).to_have_text(answer or "")
        watched.check()


def test_the_back_button_returns(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    with opened(browser, fleet.url) as watched:
        page = watched.page
        page.get_by_role("button", name="box-photons").click()
        expect(page.locator("#overview h2")).to_have_text("box-photons")
        page.get_by_role("button", name="handheld-times").click()
        expect(page.locator("#overview h2")).to_have_text("handheld-times")
        page.go_back()
        expect(page.locator("#overview h2")).to_have_text("box-photons")


def test_by_keyboard_alone(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    """A row of the table does what a click on the chart does, and keeps the focus."""
    with opened(browser, fleet.url, path=f"/#sweep={sweeps['replayed']}") as watched:
        page = watched.page
        expect(page.get_by_text("All points as a table")).to_be_visible()
        page.get_by_text("All points as a table").focus()
        page.keyboard.press("Enter")
        row = page.locator("#points tbody button").first
        row.focus()
        page.keyboard.press("Enter")
        expect_three_pictures(page)
        expect(page.locator("#points tbody button").first).to_be_focused()
        expect(page.locator("#points tbody button").first).to_have_attribute("aria-pressed", "true")
        watched.check()


def test_without_energy_time_takes_its_place(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    with opened(browser, fleet.url, path=f"/#sweep={sweeps['time_only']}") as watched:
        page = watched.page
        expect(page.locator("#overview .notice")).to_contain_text("time only")
        expect(page.locator("select[name=x]")).to_have_value("time_s")
        expect(page.locator("#tradeoff svg")).to_contain_text("time per image [s]")
        page.get_by_label("Budget", exact=True).fill("1.5")
        expect(page.locator("#recommendation .answer")).to_contain_text("gather_count=")
        assert " J" not in (page.locator("#recommendation .facts").text_content() or "")
        watched.check()


def test_a_failed_job_says_why_and_what_to_do(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    with opened(browser, fleet.url, path=f"/#sweep={sweeps['failed']}") as watched:
        failure = watched.page.locator("#overview .error")
        expect(failure).to_contain_text("this build gathers at most 64")
        expect(failure).to_contain_text(f"joulebox sweep retry {sweeps['failed']}")
        watched.check()


def test_an_unknown_sweep_is_a_sentence(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    with opened(browser, fleet.url, path="/#sweep=nonsense") as watched:
        expect(watched.page.locator("#overview .error")).to_contain_text("nonsense")
        watched.page.get_by_role("button", name="box-photons").click()
        expect(watched.page.locator("#overview h2")).to_have_text("box-photons")


def test_nothing_measured_yet(browser: Browser, tmp_path: Path) -> None:
    """An empty server, then a sweep that appears by itself and fills while the page looks on."""
    with running_fleet(tmp_path) as fresh, opened(browser, fresh.url, 390) as watched:
        page = watched.page
        expect(page.locator("#sweeps")).to_contain_text("joulebox sweep submit")
        expect(page.locator("#devices")).to_contain_text("joulebox-agent enroll")
        expect(page.locator("#connection")).to_have_text("live")
        assert watched.overflow() <= 0
        fresh.add_scene()
        device = fresh.add_device()
        expect(page.locator("#devices")).to_contain_text("shelf-laptop")
        fresh.add_sweep(axes={"gather_count": [25, 100]}, repeats=1)
        expect(page.locator("#overview h2")).to_have_text("box-photons")
        expect(page.locator("#tradeoff")).to_contain_text("No point yet")
        device.work()
        expect(page.locator("#overview")).to_contain_text("4 of 4 jobs done")
        expect(page.locator(POINTS).first).to_be_visible()
        watched.check()


def test_asks_for_a_token(browser: Browser, tmp_path: Path) -> None:
    """A server that lets nobody read: a wrong token is refused in words, the right one opens everything."""
    with running_fleet(tmp_path, anonymous_reads=False) as closed, opened(browser, closed.url) as watched:
        fill(closed)
        page = watched.page
        field = page.get_by_label("Viewer token")
        expect(field).to_be_visible()
        field.fill("not-a-token")
        page.get_by_role("button", name="Sign in").click()
        expect(page.locator("#sign-in .error")).to_contain_text("did not open the door")
        field.fill(closed.viewer_token)
        page.get_by_role("button", name="Sign in").click()
        expect(field).to_be_hidden()
        page.get_by_role("button", name="box-photons").click()
        choose_first_point(page)
        expect_three_pictures(page)
        expect(page.locator("#connection")).to_have_text("live")
        assert closed.viewer_token not in page.evaluate("location.href")
        refused = [text for text in watched.complaints if "401" not in text]
        assert refused == []


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


def total_transfer(watched: Watched) -> int:
    return int(
        watched.page.evaluate(
            "performance.getEntriesByType('resource').reduce((sum, entry) => sum + entry.transferSize, 0)"
        )
    )


def test_light_on_the_wire(browser: Browser, fleet: Fleet, sweeps: dict[str, str]) -> None:
    """First load stays below 1.5 MB; the chart library comes from the cache afterwards."""
    with opened(browser, fleet.url, path=f"/#sweep={sweeps['replayed']}") as watched:
        expect(watched.page.locator(POINTS).first).to_be_visible()
        assert 100_000 < total_transfer(watched) < 1_500_000
        watched.page.reload()
        expect(watched.page.locator(POINTS).first).to_be_visible()
        assert total_transfer(watched) < 100_000
