"""Memory that one picture frees serves the next."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from typing import Any

import pytest

DRAFT = {
    "width": 160, "height": 160, "threads": 1, "global_photons": 30_000, "final_gather_rays": 144,
    "irradiance_cache_tolerance": 1.0, "gather_distance_m": 0.04,
}  # fmt: skip


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "gnu_get_libc_version"), reason="glibc alone is tuned"
)
def test_a_warm_picture_asks_the_system_for_hardly_any_memory(open_session: Callable[..., Any]) -> None:
    """Its arrays take some 9,000 pages, each a fault where it comes fresh from the system."""
    import resource

    session = open_session("cornell-boxes", **DRAFT)
    for _ in range(3):
        session.render()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    session.render()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before < 1000
