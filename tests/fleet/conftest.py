"""The fixtures of the server's tests, and the checkout."""

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
sys.path.insert(0, str(TESTS / "server"))


@pytest.fixture(scope="session")
def root() -> Path:
    """Top of the checkout."""
    return TESTS.parent


@pytest.fixture(scope="session")
def executor() -> Iterator[ThreadPoolExecutor]:
    """Computes differences in this process."""
    with ThreadPoolExecutor(1) as pool:
        yield pool
