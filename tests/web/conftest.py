"""One browser for all tests of the pages, one server over the stored sweeps, and one that made-up devices fill."""

from collections.abc import Iterator

import pytest

pytest.importorskip("playwright.sync_api", reason="the dashboard's tests need the playwright package")

from browser import started_browser
from fleet_fixture import Fleet, fill, running_fleet
from playwright.sync_api import Browser, expect

expect.set_options(timeout=30_000)  # a busy machine is no fault of the page


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with started_browser() as found:
        if found is None:
            pytest.skip("no browser is installed: chromium, chromium-browser, google-chrome or Playwright's own")
        yield found


@pytest.fixture(scope="session")
def stored(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """The two sweeps that the real agent measured; tests only look at them."""
    with running_fleet(tmp_path_factory.mktemp("stored"), stored=True) as running:
        yield running


@pytest.fixture(scope="session")
def fleet(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """After `browser`, so that nothing is made where nothing can look at it."""
    with running_fleet(tmp_path_factory.mktemp("fleet")) as running:
        yield running


@pytest.fixture(scope="session")
def sweeps(fleet: Fleet) -> dict[str, str]:
    return fill(fleet)
