"""The view that looks closely at two pictures, in a real browser, over pictures that the real renderer made."""

import math

import numpy as np
import pytest
from browser import opened
from fleet_fixture import Fleet
from joulebox_server.analysis.images import read_picture, srgb_from_linear
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, expect
from stored import GRID

WIDTHS = [(1280, "light"), (390, "dark")]
SIDE = 64


def address(stored: Fleet, place: int = 3, **more: object) -> str:
    point = stored.points(GRID)[place]["configuration_id"]
    rest = "".join(f"&{name}={value}" for name, value in more.items())
    return f"/#view=compare&sweep={stored.sweep_id(GRID)}&point={point}{rest}"


def linear(stored: Fleet, place: int, which: str) -> NDArray[np.float32]:
    """A point's picture as the server has it on disk."""
    sha256 = stored.points(GRID)[place][which]
    return read_picture(stored.folder / "data" / "blobs" / sha256[:2] / sha256)


def shown(page: Page, pane: str, x: int, y: int) -> list[int]:
    """Colour in the middle of a picture's pixel, at a whole zoom with the picture in the middle of its pane."""
    found: list[int] = page.evaluate(
        """([pane, x, y, side]) => {
            const canvas = document.querySelector(`[data-pane=${pane}]`);
            const zoom = Number(document.querySelector("[name=zoom]").value);
            const left = (canvas.clientWidth - side * zoom) / 2, top = (canvas.clientHeight - side * zoom) / 2;
            const at = [Math.floor(left + (x + 0.5) * zoom), Math.floor(top + (y + 0.5) * zoom)];
            const copy = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
            copy.drawImage(canvas, -at[0], -at[1]);
            return [...copy.getImageData(0, 0, 1, 1).data].slice(0, 3);
        }""",
        [pane, x, y, SIDE],
    )
    return found


def ready(page: Page) -> None:
    expect(page.locator("#compare")).to_contain_text("SSIM")


@pytest.mark.parametrize(("width", "scheme"), WIDTHS)
def test_every_mode(browser: Browser, stored: Fleet, width: int, scheme: str) -> None:
    with opened(browser, stored.url, width, scheme=scheme, path=address(stored)) as watched:
        page = watched.page
        ready(page)
        expect(page.locator("canvas.pane")).to_have_count(3)
        for mode, panes in (("Slider", ["slider"]), ("Blink", ["blink"]), ("Error map", ["map"])):
            page.get_by_text(mode, exact=True).click()
            expect(page.locator("canvas.pane")).to_have_count(1)
            for pane in panes:
                expect(page.locator(f"[data-pane={pane}]")).to_be_visible()
        expect(page.locator(".legend")).to_have_attribute("aria-label", "Scale from 0 to 10 JND")
        assert watched.overflow() <= 0
        watched.check()


def test_pixels_are_the_renderer_s_numbers(browser: Browser, stored: Fleet) -> None:
    """The read-out beside the stored file; what is painted beside the server's tone map, to a level of 256."""
    with opened(browser, stored.url, path=address(stored, zoom=4, at="20,30")) as watched:
        page = watched.page
        ready(page)
        reference, test = (linear(stored, 3, f"{name}image_sha256") for name in ("reference_", ""))
        words = (page.locator("#pixel").text_content() or "").replace("(", "").split()
        for name, picture in (("reference", reference), ("test", test)):
            start = words.index(name) + 1
            assert [float(word) for word in words[start : start + 3]] == pytest.approx(picture[30, 20], rel=5e-3)
        for exposure in (3.0, 0.75):
            page.locator("[name=exposure]").fill(str(exposure))
            page.locator("[name=exposure]").press("Enter")
            page.wait_for_function("exposure => location.hash.includes(`exposure=${exposure}`)", arg=exposure)
            for pane, picture in (("reference", reference), ("test", test)):
                for x, y in ((10, 10), (40, 20), (32, 60)):
                    wanted = np.rint(srgb_from_linear(np.clip(picture[y, x], 0, 1 / exposure), exposure) * 255)
                    assert shown(page, pane, x, y) == pytest.approx(wanted, abs=1)
        watched.check()


@pytest.mark.long
def test_the_slider_parts_the_pictures(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path=address(stored, mode="slider", zoom=4)) as watched:
        page = watched.page
        ready(page)
        level = {
            name: np.rint(srgb_from_linear(np.clip(linear(stored, 3, which), 0, 1 / 3), 3.0) * 255)
            for name, which in (("reference", "reference_image_sha256"), ("test", "image_sha256"))
        }
        apart = np.abs(level["reference"] - level["test"]).max(axis=2)[:, 30:34]  # of the middle
        y, column = map(int, np.unravel_index(apart.argmax(), apart.shape))
        x = 30 + column
        assert apart.max() > 3
        edge = page.get_by_role("slider", name="Edge between reference and test")
        box = edge.bounding_box()
        assert box
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        for offset, name in ((80, "reference"), (-160, "test")):
            page.mouse.move(*middle)
            page.mouse.down()
            page.mouse.move(middle[0] + offset, middle[1], steps=4)
            page.mouse.up()
            assert shown(page, "slider", x, y) == pytest.approx(level[name][y, x], abs=1)
            middle = middle[0] + offset, middle[1]
        edge.press("ArrowRight")
        page.wait_for_function("() => location.hash.includes('split=')")
        watched.check()


@pytest.mark.long
def test_blinking_shows_both_and_can_be_stopped(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path=address(stored, mode="blink", zoom=4)) as watched:
        page = watched.page
        ready(page)
        said = page.locator("#blink-state")
        expect(said).to_contain_text("the reference")
        expect(said).to_contain_text("final_gather_rays")
        page.get_by_role("button", name="Stop blinking").click()
        before = said.text_content()
        page.wait_for_timeout(1600)  # more than two turns
        assert said.text_content() == before
        watched.check()


@pytest.mark.long
def test_zoom_and_drag_by_hand_and_keyboard(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path=address(stored, zoom=1)) as watched:
        page = watched.page
        ready(page)
        pane = page.locator("[data-pane=test]")
        pane.focus()
        for zoom in (2, 4, 8, 16, 16):
            page.keyboard.press("+")
            page.wait_for_function(
                "zoom => location.hash.includes(`zoom=${zoom}&`) || location.hash.endsWith(`zoom=${zoom}`)", arg=zoom
            )
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Shift+ArrowDown")
        expect(page.locator("#pixel")).to_contain_text("x 33, y 42")
        box = pane.bounding_box()
        assert box
        page.mouse.move(box["x"] + 150, box["y"] + 150)
        page.mouse.down()
        page.mouse.move(box["x"] + 150 + 4 * 16, box["y"] + 150, steps=4)
        page.mouse.up()
        expect(page.locator("#pixel")).to_contain_text("x 29, y")  # four pixels of 16
        pane.click(position={"x": 10, "y": 10})
        expect(page.locator("#pixel")).not_to_contain_text("x 29, y")
        watched.check()


@pytest.mark.long
def test_the_error_map_is_the_stored_difference(browser: Browser, stored: Fleet) -> None:
    """The worst pixel's read-out is the comparison's own, as closely as a grey level of the map tells (0.04 JND)."""
    with opened(browser, stored.url, path=address(stored, mode="map", zoom=4)) as watched:
        page = watched.page
        ready(page)
        point = stored.points(GRID)[3]
        pair = f"reference={point['reference_image_sha256']}&test={point['image_sha256']}&exposure=3"
        result = stored.get(f"/v1/compare?{pair}")
        png = stored.folder / "data" / "blobs" / result["delta_sha256"][:2] / result["delta_sha256"]
        levels = np.asarray(Image.open(png))
        y, x = map(int, np.unravel_index(np.argmin(np.abs(levels.astype(float) - 100)), levels.shape))
        page.locator("[data-pane=map]").focus()
        page.evaluate("at => { location.hash = location.hash.replace(/&at=[^&]*/, '') + `&at=${at}`; }", f"{x},{y}")
        expect(page.locator("#pixel")).to_contain_text(f"x {x}, y {y}")
        told = float((page.locator("#pixel").text_content() or "").split("difference ")[1].split()[0])
        assert told == pytest.approx(levels[y, x] / 255 * 10, rel=5e-3)
        page.locator("[name=map]").select_option("luminance")
        expect(page.locator(".legend")).to_have_attribute("aria-label", "Scale from -0.2 to 0.2 of white")
        difference = (linear(stored, 3, "image_sha256") - linear(stored, 3, "reference_image_sha256"))[y, x]
        told = float((page.locator("#pixel").text_content() or "").split("difference ")[1].split()[0])
        wanted = 3 * float(np.dot(difference, (0.2126, 0.7152, 0.0722)))
        assert math.isclose(told, wanted, rel_tol=6e-2, abs_tol=1e-5)
        watched.check()


@pytest.mark.long
def test_two_points_and_a_link(browser: Browser, stored: Fleet) -> None:
    with opened(browser, stored.url, path=address(stored)) as watched:
        page = watched.page
        ready(page)
        points = stored.points(GRID)
        page.locator("[name=compare-against]").select_option(points[0]["configuration_id"])
        page.locator("[name=compare-point]").select_option(points[1]["configuration_id"])
        expect(page.locator("figcaption").first).to_have_text(f"Reference: {points[0]['label']}")
        ready(page)
        link = page.evaluate("location.pathname + location.hash")
        figures = page.locator("#compare .facts").text_content()
        watched.check()
    with opened(browser, stored.url, path=link) as again:
        expect(again.page.locator("#compare .facts")).to_have_text(figures or "")


@pytest.mark.long
def test_pictures_that_are_not_there(browser: Browser, stored: Fleet) -> None:
    zeros = "0" * 64
    with opened(browser, stored.url, path=f"/#view=compare&reference={zeros}&test={zeros}") as watched:
        expect(watched.page.locator("#compare .error")).to_contain_text("blob")
        expect(watched.page.get_by_role("button", name="Try again")).to_be_visible()
