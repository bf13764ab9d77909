"""How far a picture is from a converged one: relMSE, FLIP and mean brightness."""

from __future__ import annotations

import math
from collections.abc import Sequence

import flip_evaluator
import numpy as np
from joulebox_render.bench import relative_mse
from joulebox_render.records import F4
from joulebox_server.analysis.images import srgb_from_linear

__all__ = ["EXPOSURE", "brightness_error", "cost_at", "flip", "relative_mse"]

EXPOSURE = 3.0


def flip(image: F4, reference: F4) -> float:
    """Mean FLIP (Andersson 2020) of clip(3 x linear) -> sRGB at its default of 67 pixels per degree, 0..1."""
    shown = [srgb_from_linear(picture, EXPOSURE).astype(np.float32) for picture in (reference, image)]
    # positional: LDR, inputs are sRGB, no colour map, compute the mean, default viewing conditions
    _, mean, _ = flip_evaluator.evaluate(*shown, "LDR", True, False, True, {})
    return float(mean)


def brightness_error(image: F4, reference: F4) -> float:
    """Mean of the image over mean of the reference, less 1."""
    return float(image.mean(dtype=np.float64) / reference.mean(dtype=np.float64)) - 1


def cost_at(curve: Sequence[tuple[float, float]], target: float) -> float | None:
    """Cost at which a curve of (cost, error), cheapest first, falls to `target`; None where it never does.

    Between two points error is taken for a power of cost. A curve that starts at or below the target gives the cost
    of its first point, which is an upper bound.
    """
    for index, (cost, error) in enumerate(curve):
        if error > target:
            continue
        if index == 0:
            return cost
        cost_before, error_before = curve[index - 1]
        share = math.log(error_before / target) / math.log(error_before / error)
        return float(cost_before * (cost / cost_before) ** share)
    return None
