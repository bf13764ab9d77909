"""A headless browser for the dashboard's tests and pictures, and a page that remembers what went wrong."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from playwright.sync_api import Browser, ConsoleMessage, Page, Playwright, Request, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
WATCH_POLICY = """
window.policyViolations = [];
document.addEventListener("securitypolicyviolation",
  (event) => window.policyViolations.push(`${event.violatedDirective}: ${event.blockedURI} ${event.sample}`));
"""


def browser_path(playwright: Playwright) -> str | None:
    """Program of an installed browser, the system's or Playwright's own; None when there is none."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    own = playwright.chromium.executable_path
    return found or (own if Path(own).is_file() else None)


@contextmanager
def started_browser() -> Iterator[Browser | None]:
    """A running browser, or None when none is installed."""
    with sync_playwright() as playwright:
        path = browser_path(playwright)
        if path is None:
            yield None
            return
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        try:
            yield browser
        finally:
            browser.close()


@dataclass
class Watched:
    """A page and what it must never do: log an error or a warning, break its policy, ask another host."""

    page: Page
    host: str
    complaints: list[str] = field(default_factory=list)
    elsewhere: list[str] = field(default_factory=list)

    def hear(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def see(self, request: Request) -> None:
        url = urlsplit(request.url)
        if url.scheme in ("http", "https", "ws", "wss") and url.netloc != self.host:
            self.elsewhere.append(request.url)

    def check(self) -> None:
        """Fails when anything went wrong since the page was opened."""
        assert self.complaints == []
        assert self.page.evaluate("window.policyViolations") == []
        assert self.elsewhere == []

    def overflow(self) -> int:
        """By how many pixels the page is wider than its window."""
        return int(self.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth"))


@contextmanager
def opened(
    browser: Browser, url: str, width: int = 1280, height: int = 900, scheme: str = "light", path: str = "/"
) -> Iterator[Watched]:
    """A fresh page (own session, nothing cached) showing the dashboard."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if scheme == "dark" else "light"
    )
    try:
        page = context.new_page()
        page.set_default_timeout(30_000)
        page.add_init_script(WATCH_POLICY)
        watched = Watched(page, urlsplit(url).netloc)
        page.on("console", watched.hear)
        page.on("pageerror", lambda error: watched.complaints.append(str(error)))
        page.on("request", watched.see)
        page.goto(url + path)
        yield watched
    finally:
        context.close()
