"""The fleet in a real browser: devices as the server knows them, what an operator should look at and do."""

from pathlib import Path

import httpx2
import pytest
from browser import opened
from fleet_fixture import Fleet, running_fleet
from playwright.sync_api import Browser, Page, expect

WIDTHS = [(1280, "light"), (390, "dark")]


def sign_in(page: Page, token: str) -> None:
    """Answer the dialog that an operator's action opens."""
    dialog = page.get_by_role("dialog")
    expect(dialog).to_be_visible()
    dialog.get_by_label("Token").fill(token)
    dialog.get_by_role("button", name="Sign in").click()


@pytest.mark.parametrize(("width", "scheme"), WIDTHS)
def test_what_devices_are_and_measure_by(
    browser: Browser, stored: Fleet, fleet: Fleet, sweeps: dict[str, str], width: int, scheme: str
) -> None:
    """Of the recorded device its meter and last control run; of a made-up one its battery."""
    with opened(browser, stored.url, width, scheme=scheme, path="/#view=fleet") as watched:
        device = watched.page.locator(".devices li")
        expect(device).to_contain_text("replay (replayed): replayed joules")
        expect(device).to_contain_text("a reading every 0.1 s, last energy to ±")
        expect(device).to_contain_text("cornell-spheres,")  # of the control run
        expect(device).to_contain_text("joulebox-render 0.1.0")
        expect(device).to_contain_text("good")
        assert watched.overflow() <= 0
        watched.check()
    with opened(browser, fleet.url, width, scheme=scheme, path="/#view=fleet") as watched:
        laptop = watched.page.locator(".devices li", has_text="shelf-laptop")
        expect(laptop).to_contain_text("71 % of 48 Wh, on battery")
        meterless = watched.page.locator(".devices li", has_text="handheld-without-meter")
        expect(meterless).to_contain_text("time only: no energy source")
        watched.check()


def test_enrolment_by_one_line(browser: Browser, tmp_path: Path) -> None:
    """The code is asked for with an operator's token; the line holds it; the device appears by itself."""
    with running_fleet(tmp_path) as fresh, opened(browser, fresh.url, path="/#view=fleet") as watched:
        page = watched.page
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        expect(page.locator("#devices")).to_contain_text("joulebox-agent enroll")
        page.get_by_role("button", name="Enrol a device").click()
        sign_in(page, fresh.operator_token)
        line = page.locator("#enrol pre")
        expect(line).to_contain_text(f"joulebox-agent enroll --server {fresh.url} --code ")
        page.get_by_role("button", name="Copy the line").click()
        expect(page.locator("#enrol")).to_contain_text("Copied.")
        copied = page.evaluate("navigator.clipboard.readText()")
        assert copied == line.text_content()
        code = copied.split("--code ")[1].split()[0]
        body = {"code": code, "name": "new-handheld", "boot_id": "boot-1"}
        assert httpx2.post(f"{fresh.url}/v1/devices", json=body).status_code == 201
        expect(page.locator(".devices")).to_contain_text("new-handheld")
        expect(page.locator(".devices")).to_contain_text("not known before the first result")
        assert [text for text in watched.complaints if "401" not in text] == []


@pytest.mark.long
def test_a_suspect_device_is_cleared(browser: Browser, tmp_path: Path) -> None:
    with running_fleet(tmp_path, suspect_after=2, retry_pause_s=0) as fresh:
        fresh.add_scene()
        device = fresh.add_device()
        fresh.add_sweep(axes={"gather_count": [25, 100]}, repeats=1)
        device.work(1)  # a scene that nobody has rendered may be at fault itself
        for _ in range(2):
            device.refuse("the renderer ended with exit code -11")
        with opened(browser, fresh.url, path="/#view=fleet") as watched:
            page = watched.page
            card = page.locator(".devices li")
            expect(page.locator("#fleet-words")).to_contain_text("1 suspect")
            expect(card).to_contain_text("2 failures in a row, the last: the renderer ended with exit code -11")
            card.get_by_role("button", name="Clear: give it jobs again").click()
            sign_in(page, fresh.operator_token)
            expect(card).to_contain_text("good")
            expect(page.locator("#fleet-words")).not_to_contain_text("suspect")
        assert device.work() > 0


@pytest.mark.long
def test_disagreeing_pictures_are_found_and_compared(browser: Browser, tmp_path: Path) -> None:
    """Two devices of one class make different pixels of the same settings; a third has another build."""
    with running_fleet(tmp_path) as fresh:
        fresh.add_scene()
        devices = [
            fresh.add_device("one"),
            fresh.add_device("two", blemish=0.3),
            fresh.add_device("old", version="0.9"),
        ]
        fresh.add_sweep(devices=["one", "two"], axes={"gather_count": [25]}, repeats=1)
        for device in devices[:2]:
            device.work()
        with opened(browser, fresh.url, path="/#view=fleet") as watched:
            page = watched.page
            card = page.locator(".devices li", has_text="two")
            expect(card).to_contain_text("differ from what another device made")
            expect(page.locator(".devices li", has_text="old")).to_contain_text("renders with formula 0.9")
            card.get_by_text("disagreeing picture").click()
            expect(card).to_contain_text("not the same pixels, although both are of one class")
            card.get_by_role("link", name="Compare the pictures").first.click()
            expect(page.locator("#compare")).to_contain_text("which should agree")
            expect(page.locator("canvas.pane")).to_have_count(3)
            expect(page.locator("#compare .facts")).to_contain_text("SSIM")
            watched.check()
