"""The view of a sweep in a real browser, over the sweeps that the real agent measured (see `record.py`)."""

import json
import re
from itertools import pairwise

import pytest
from browser import opened
from fleet_fixture import Fleet
from playwright.sync_api import Browser, Page, expect
from stored import FAILED, GRID

POINTS = "#tradeoff svg .points_marks path"
WIDTHS = [(1280, "light"), (390, "dark")]
ALL = 12  # settings of the grid


def grid(stored: Fleet, **more: object) -> str:
    """Address of the measured sweep's view."""
    return f"/#sweep={stored.sweep_id(GRID)}" + "".join(f"&{name}={value}" for name, value in more.items())


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


def line(page: Page, name: str) -> tuple[float, float]:
    """Middle of a line's handle [px]."""
    handle = page.get_by_role("slider", name=name, exact=True)
    handle.scroll_into_view_if_needed()
    box = handle.bounding_box()
    assert box
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.mark.parametrize(("width", "scheme"), WIDTHS)
def test_from_the_list_to_a_recommendation(browser: Browser, stored: Fleet, width: int, scheme: str) -> None:
    with opened(browser, stored.url, width, scheme=scheme) as watched:
        page = watched.page
        page.get_by_role("button", name=GRID).click()
        expect(page.get_by_role("heading", name=GRID)).to_be_visible()
        expect(page.locator("#overview .notice").first).to_contain_text("replayed joules")
        for badge in page.locator("[data-quality]").all():
            expect(badge).to_have_text("replayed joules")
        expect(page.locator("#stages svg")).to_be_visible()
        expect(page.locator(POINTS)).to_have_count(ALL)

        choose_first_point(page)
        expect_three_pictures(page)
        expect(page.locator("#pictures")).to_contain_text("J replayed")
        expect(page.locator("#pictures .facts").first).to_contain_text("SSIM")
        expect(page.locator("#tradeoff .ring")).to_be_visible()
        expect(page.locator("#trace svg")).to_contain_text("power [W]")

        page.locator("#budget-value").fill("9")
        expect(page.locator("#recommendation .answer")).to_contain_text("final_gather_rays=")
        expect(page.locator("#recommendation")).to_contain_text("J replayed")
        expect(page.locator("#recommendation")).to_contain_text("Why")
        expect(page.locator("#tradeoff svg")).to_contain_text("budget 9 J")

        page.locator("#budget-value").fill("0.5")
        expect(page.locator("#recommendation")).to_contain_text("No setting meets this budget")
        expect(page.locator("#recommendation")).to_contain_text("nearest two")
        assert watched.overflow() <= 0
        watched.check()


@pytest.mark.long
def test_a_ring_marks_the_chosen_point(browser: Browser, stored: Fleet) -> None:
    """Within 3 pixels: half a point's width, and less than the distance of any two points."""
    with opened(browser, stored.url, path=grid(stored)) as watched:
        choose_first_point(watched.page)
        expect(watched.page.locator("#tradeoff .ring")).to_be_visible()
        middles = watched.page.evaluate(
            """selector => [document.querySelector("#tradeoff .ring"), document.querySelector(selector)].map((node) => {
                const box = node.getBoundingClientRect();
                return [box.x + box.width / 2, box.y + box.height / 2];
            })""",
            POINTS,
        )
        assert middles[0] == pytest.approx(middles[1], abs=3)


@pytest.mark.long
def test_hover_tells_all_settings(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path=grid(stored)) as watched:
        expect(watched.page.locator(POINTS)).to_have_count(ALL)
        watched.page.locator(POINTS).first.hover(force=True)
        tooltip = watched.page.locator("#vg-tooltip-element")
        for words in ("final_gather_rays", "global_photons", "shadow_rays", "samples_per_pixel", "energy", "front"):
            expect(tooltip).to_contain_text(words)
        expect(tooltip).to_contain_text(re.compile("acceptable|beyond the limit"))
        watched.check()


@pytest.mark.long
def test_the_limit_is_dragged_and_typed(browser: Browser, stored: Fleet) -> None:
    """To a hundredth of its height: the chart says so, the judgements follow, and a link keeps it."""
    with opened(browser, stored.url, path=grid(stored, budget=9)) as watched:
        page = watched.page
        page.get_by_text("All points as a table").click()
        within = page.locator("#points td", has_text="within the limit")
        expect(within).to_have_count(sum(bool(p["acceptable"]) for p in stored.points(GRID)))
        x, y = line(page, "Limit line")
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x, y + 60, steps=5)
        page.mouse.up()
        page.wait_for_function("() => location.hash.includes('limit=')")
        limit = float(page.locator("[name=limit]").input_value())
        assert limit < stored.get(f"/v1/sweeps/{GRID}/tradeoff")["limit"]
        assert line(page, "Limit line")[1] == pytest.approx(y + 60, abs=2)  # in view still: nothing scrolled
        expect(within).to_have_count(sum(p["difference"]["value"] <= limit for p in stored.points(GRID)))
        page.locator("[name=limit]").fill("0.001")  # beyond the axis: the chart makes room
        page.locator("[name=limit]").press("Enter")
        expect(within).to_have_count(0)
        expect(page.locator("#tradeoff svg")).to_contain_text("acceptable below 0.001")
        expect(page.locator("#recommendation")).to_contain_text("No setting meets this budget")
        watched.check()


@pytest.mark.long
def test_the_budget_is_dragged_slid_and_moved_by_keyboard(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path=grid(stored, budget=9)) as watched:
        page = watched.page
        field = page.locator("#budget-value")
        x, y = line(page, "Budget line")
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 80, y, steps=4)
        expect(page.locator("#tradeoff svg")).not_to_contain_text("budget 9 J")  # while it moves
        page.mouse.up()
        page.wait_for_function("() => !location.hash.includes('budget=9&') && !location.hash.endsWith('budget=9')")
        dragged = float(field.input_value())
        assert dragged > 9
        handle = page.get_by_role("slider", name="Budget line", exact=True)
        handle.press("ArrowLeft")
        page.wait_for_function("before => Number(document.querySelector('#budget-value').value) < before", arg=dragged)
        slider = page.get_by_role("slider", name="Budget, from the cheapest point to the reference")
        slider.press("Home")
        cheapest = min(p["energy_j"]["value"] for p in stored.points(GRID))
        page.wait_for_function("least => Number(document.querySelector('#budget-value').value) < least", arg=cheapest)
        expect(page.locator("#recommendation")).to_contain_text("No setting meets this budget")
        slider.press("End")
        expect(page.locator("#recommendation .answer")).to_contain_text("final_gather_rays=")
        watched.check()


@pytest.mark.long
def test_units_of_the_budget(browser: Browser, stored: Fleet) -> None:
    """2.5 Wh for 1000 images are 9 J for one: the same answer as 9 J, and the line at 9 J. Seconds have their own."""
    with opened(browser, stored.url, path=grid(stored, budget=9, unit="j")) as watched:
        page = watched.page
        answer = page.locator("#recommendation .answer")
        by_joules = answer.text_content()
        page.get_by_label("Unit of the budget").select_option("wh")
        page.locator("#budget-value").fill("2.5")
        page.get_by_label("for", exact=True).fill("1000")
        expect(page.locator("#tradeoff svg")).to_contain_text("budget 9 J")
        expect(answer).to_have_text(by_joules or "")
        page.get_by_label("Unit of the budget").select_option("s")
        page.locator("#budget-value").fill("0.5")
        expect(page.locator("#recommendation")).to_contain_text("within the budget of 0.5 s")
        expect(page.locator("option[value=percent]")).to_be_disabled()  # this device told of no battery
        watched.check()


@pytest.mark.long
def test_points_are_looked_at_by_setting(browser: Browser, stored: Fleet) -> None:
    """The others turn pale and leave the table; colour follows the setting chosen for it; a link keeps both."""
    with opened(browser, stored.url, path=grid(stored)) as watched:
        page = watched.page
        page.get_by_text("Look at some settings only").click()
        page.locator("fieldset", has_text="shadow_rays").get_by_label("8", exact=True).check()
        expect(page.locator("#selection-state")).to_contain_text("6 of 12 points")
        expect(page.locator(f"{POINTS}[opacity='0.12']")).to_have_count(6)
        page.get_by_text("All points as a table").click()
        expect(page.locator("#points tbody tr")).to_have_count(6)
        page.locator("[name=colour]").select_option("global_photons")
        expect(page.locator("#tradeoff svg")).to_contain_text("100,000")
        address = page.evaluate("location.pathname + location.hash")
        watched.check()
    with opened(browser, stored.url, path=address) as again:
        expect(again.page.locator(f"{POINTS}[opacity='0.12']")).to_have_count(6)
        expect(again.page.locator("[name=colour]")).to_have_value("global_photons")
        again.page.get_by_text("Look at some settings only").click()
        again.page.get_by_role("button", name="Show all").click()
        expect(again.page.locator(f"{POINTS}[opacity='0.12']")).to_have_count(0)


@pytest.mark.long
def test_a_link_reproduces_the_view(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url) as watched:
        page = watched.page
        page.get_by_role("button", name=GRID).click()
        page.locator("select[name=scene]").select_option("cornell-spheres")
        page.locator("select[name=x]").select_option("time_s")
        page.locator("select[name=y]").select_option("difference_per_pixel")
        page.locator("select[name=scale]").select_option("linear")
        expect(page.locator("#tradeoff svg")).to_contain_text("time per image")
        expect(page.locator("#tradeoff svg")).to_contain_text("cornell-spheres on shelf-laptop")
        choose_first_point(page)
        expect_three_pictures(page)
        page.get_by_label("Unit of the budget").select_option("s")
        page.locator("#budget-value").fill("0.9")
        expect(page.locator("#recommendation .answer")).to_be_visible()
        page.wait_for_function("() => location.hash.includes('budget=0.9')")
        address = page.evaluate("location.pathname + location.hash")
        told = page.locator(".chosen-point").text_content()
        answer = page.locator("#recommendation").text_content()
        watched.check()
    with opened(browser, stored.url, path=address) as again:
        page = again.page
        expect_three_pictures(page)
        expect(page.locator("select[name=scene]")).to_have_value("cornell-spheres")
        expect(page.locator("select[name=x]")).to_have_value("time_s")
        expect(page.locator("select[name=y]")).to_have_value("difference_per_pixel")
        expect(page.locator("select[name=scale]")).to_have_value("linear")
        expect(page.locator("#tradeoff svg")).to_contain_text("difference per pixel")
        expect(page.locator(".chosen-point")).to_have_text(told or "")
        expect(page.locator("#recommendation")).to_have_text(answer or "")
        again.check()


@pytest.mark.long
def test_energy_per_pixel(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path=grid(stored, x="energy_j_per_pixel", budget=9)) as watched:
        expect(watched.page.locator("#tradeoff svg")).to_contain_text("energy per pixel [J]")
        expect(watched.page.locator("#tradeoff svg")).to_contain_text("budget 0.0022 J")  # 9 J / 64²
        watched.check()


@pytest.mark.long
def test_the_settings_are_taken_along(browser: Browser, stored: Fleet) -> None:
    """What is copied is what the server recommends: as a file, and as a line that the renderer reads back."""
    with opened(browser, stored.url, path=grid(stored, budget=9)) as watched:
        page = watched.page
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        page.get_by_text("Take the settings along").click()
        page.get_by_role("button", name="Copy the settings file").click()
        expect(page.locator("#recommendation")).to_contain_text("Copied.")
        wanted = stored.get(f"/v1/sweeps/{GRID}/recommendation?budget_j=9")["settings"]
        assert json.loads(page.evaluate("navigator.clipboard.readText()")) == wanted
        page.get_by_role("button", name="Copy the command line").click()
        page.wait_for_function(
            "() => navigator.clipboard.readText().then((text) => text.startsWith('joulebox-render'))"
        )
        words = page.evaluate("navigator.clipboard.readText()").split()
        assert words[:3] == ["joulebox-render", "render", "cornell-boxes"]
        told = dict(word.split("=") for before, word in pairwise(words) if before == "--set")
        assert told.keys() == wanted.keys()
        assert int(told["final_gather_rays"]) == wanted["final_gather_rays"]
        watched.check()


@pytest.mark.long
def test_the_chart_is_downloaded(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path=grid(stored)) as watched:
        for name, start in (("SVG", b"<svg"), ("PNG", b"\x89PNG"), ("Vega-Lite", b"{")):
            with watched.page.expect_download() as started:
                watched.page.get_by_role("button", name=name, exact=True).click()
            assert started.value.path().read_bytes().startswith(start)
        watched.check()


@pytest.mark.long
def test_by_keyboard_alone(browser: Browser, stored: Fleet) -> None:
    """A row of the table does what a click on the chart does, and keeps the focus."""
    with opened(browser, stored.url, path=grid(stored)) as watched:
        page = watched.page
        expect(page.locator(POINTS).first).to_be_visible()
        page.get_by_text("All points as a table").focus()
        page.keyboard.press("Enter")
        row = page.locator("#points tbody button").first
        row.focus()
        page.keyboard.press("Enter")
        expect_three_pictures(page)
        expect(page.locator("#points tbody button").first).to_be_focused()
        expect(page.locator("#points tbody button").first).to_have_attribute("aria-pressed", "true")
        watched.check()


@pytest.mark.parametrize(("width", "scheme"), WIDTHS)
def test_a_failed_sweep_says_why_and_what_to_do(browser: Browser, stored: Fleet, width: int, scheme: str) -> None:
    sweep = stored.sweep_id(FAILED)
    with opened(browser, stored.url, width, scheme=scheme, path=f"/#sweep={sweep}") as watched:
        failure = watched.page.locator("#overview .error")
        expect(failure).to_contain_text('there is no file "bunny-1234.ply"')
        expect(failure).to_contain_text(f"joulebox sweep retry {sweep}")
        expect(watched.page.locator(POINTS)).to_have_count(3)
        watched.page.locator("select[name=scene]").select_option("cornell-bunny detail=1234")
        expect(watched.page.locator("#tradeoff")).to_contain_text("No point yet")
        expect(watched.page.locator("#pictures")).to_contain_text("No picture yet")
        expect(watched.page.locator("#recommendation")).to_contain_text("as soon as there are points")
        assert watched.overflow() <= 0
        watched.check()


@pytest.mark.long
def test_an_unknown_sweep_is_a_sentence(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path="/#sweep=nonsense") as watched:
        expect(watched.page.locator("#overview .error")).to_contain_text("nonsense")
        watched.page.get_by_role("button", name=GRID).click()
        expect(watched.page.locator("#overview h2")).to_have_text(GRID)


@pytest.mark.long
def test_the_back_button_returns(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url) as watched:
        page = watched.page
        page.get_by_role("button", name=GRID).click()
        expect(page.locator("#overview h2")).to_have_text(GRID)
        page.get_by_role("button", name=FAILED).click()
        expect(page.locator("#overview h2")).to_have_text(FAILED)
        page.get_by_role("link", name="Fleet").click()
        expect(page.locator("#devices")).to_be_visible()
        page.go_back()
        expect(page.locator("#overview h2")).to_have_text(FAILED)
        page.go_back()
        expect(page.locator("#overview h2")).to_have_text(GRID)
