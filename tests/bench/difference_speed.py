"""How long the difference takes, beside SSIM in the same run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from joulebox_server.analysis.difference import Display, compare
from joulebox_server.analysis.images import srgb_from_linear
from skimage.metrics import structural_similarity

from .table import Row

GOALS_MS = {256: 60.0, 512: 200.0}
TURNS = 9


def pictures(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A picture with edges and shades, and the same with noise of 5 %."""
    rng = np.random.default_rng(side)
    place = np.linspace(0, 1, side, dtype=np.float32)
    picture = np.stack([np.outer(place, 0.2 + 0.3 * (place > k / 4)) for k in (1, 2, 3)], axis=2).astype(np.float32)
    noise = rng.standard_normal(picture.shape).astype(np.float32)
    return picture, picture * (1 + np.float32(0.05) * noise)


def cpu_ms(work: Callable[[], object]) -> float:
    """CPU milliseconds of a warm call, the median of a few."""
    work()
    taken = []
    for _ in range(TURNS):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return 1e3 * statistics.median(taken)


def difference_rows(say: Callable[[str], None]) -> list[Row]:
    """The goals of time for a difference at full quality."""
    rows = []
    for side, goal_ms in GOALS_MS.items():
        one, other = pictures(side)
        shown = [srgb_from_linear(picture) for picture in (one, other)]
        ours_ms = cpu_ms(partial(compare, one, other, Display()))
        ssim_ms = cpu_ms(partial(structural_similarity, *shown, data_range=1.0, channel_axis=2))
        say(f"difference at {side}x{side}: {ours_ms:.0f} ms")
        rows.append(
            Row(f"difference at {side}x{side}, one core", f"<= {goal_ms:.0f} ms",
                f"{ours_ms:.0f} ms, {ours_ms / ssim_ms:.1f} times SSIM's", ours_ms <= goal_ms)
        )  # fmt: skip
    return rows
