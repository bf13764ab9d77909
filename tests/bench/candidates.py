"""The settings among which the cheapest that is good enough is sought, and their measurement.

Edit FRONT to change what `make bench` tries. Settings that this version does not know are skipped with a word.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from joulebox_render.errors import SettingsError
from joulebox_render.records import F4
from joulebox_render.session import Image, Session
from joulebox_render.settings import PRESETS, make_settings

from .picture_error import brightness_error, flip, relative_mse

Values = Mapping[str, Any]

NAMED = ("draft", "balanced", "fine")  # the presets that must lie on the front
FRONT: list[Values] = [
    *({"preset": name} for name in NAMED),
    {"preset": "draft", "samples_per_pixel": 2, "shadow_rays": 4, "global_photons": 20_000},
    {"preset": "draft", "samples_per_pixel": 2, "shadow_rays": 4, "caustic_photons": 60_000},
    {"preset": "draft", "samples_per_pixel": 2, "shadow_rays": 4, "final_gather_rays": 121},
    {"preset": "draft", "samples_per_pixel": 2, "shadow_rays": 4, "irradiance_cache_tolerance": 1.5,
     "gather_distance_m": 0.03, "final_gather_rays": 80},
    {"preset": "draft", "samples_per_pixel": 2, "shadow_rays": 4, "irradiance_cache_tolerance": 1.5,
     "gather_distance_m": 0.03, "final_gather_rays": 90, "global_photons": 20_000},
    {"preset": "draft", "samples_per_pixel": 2, "shadow_rays": 4, "irradiance_cache_tolerance": 1.5,
     "gather_distance_m": 0.03, "final_gather_rays": 100, "global_photons": 20_000},
    {"preset": "draft", "final_gather_rays": 100, "global_photons": 20_000},
    {"preset": "draft", "final_gather_rays": 256, "caustic_photons": 60_000},
    {"preset": "draft", "caustic_photons": 60_000, "global_photons": 100_000, "gather_distance_m": 0.02},
    {"preset": "draft", "irradiance_cache_tolerance": 1.5},
    {"preset": "draft", "irradiance_cache_tolerance": 1.5, "final_gather_rays": 256, "caustic_photons": 60_000},
    {"preset": "draft", "irradiance_cache_tolerance": 1.5, "final_gather_rays": 225, "global_photons": 60_000,
     "gather_distance_m": 0.03},
    {"preset": "draft", "irradiance_cache_tolerance": 1.5, "final_gather_rays": 196, "global_photons": 60_000,
     "gather_distance_m": 0.03, "caustic_photons": 60_000},
    {"irradiance_cache_tolerance": 1.5, "final_gather_rays": 225},
    {"irradiance_cache_tolerance": 1.5, "final_gather_rays": 484},
    {"irradiance_cache_tolerance": 1.2, "samples_per_pixel": 4},
    {"irradiance_cache_tolerance": 1.5, "final_gather_rays": 441},
    {"final_gather_rays": 400},
    {"final_gather_rays": 400, "global_photons": 200_000},
    {"irradiance_cache_tolerance": 0.3},
    {"samples_per_pixel": 4, "shadow_rays": 4, "irradiance_cache_tolerance": 0, "final_gather_rays": 16},
    {"samples_per_pixel": 9, "shadow_rays": 9, "irradiance_cache_tolerance": 0, "final_gather_rays": 25},
    {"samples_per_pixel": 9, "shadow_rays": 9, "irradiance_cache_tolerance": 0, "final_gather_rays": 25,
     "sampler": "stratified"},
]  # fmt: skip
# A picture below this is rendered once to warm up and WARM_TURNS times to be timed; a dearer one once.
WARM_BELOW_CPU_S = 1.5
WARM_TURNS = 3
# Turns that decide which of two configurations is cheaper.
COMPARED_TURNS = 5


class Measured(NamedTuple):
    """What settings cost and how far their picture is from the reference; brightness is a share of the mean."""

    scene: str
    name: str
    cpu_s: float
    relmse: float
    flip: float
    brightness: float


def name_of(values: Values) -> str:
    """Settings in words."""
    return ", ".join(str(value) if name == "preset" else f"{name}={value}" for name, value in values.items())


def timed(session: Session, turns: int) -> tuple[Image, float]:
    """An image and its CPU seconds, warm: the median of some turns where it is cheap."""
    image = session.render()
    if image.cpu_s > WARM_BELOW_CPU_S or not turns:
        return image, image.cpu_s
    warm = [session.render() for _ in range(turns)]
    return warm[0], statistics.median(turn.cpu_s for turn in warm)


def measure(
    scene: str, values: Values, reference: F4, say: Callable[[str], None], size: Values, name: str = "",
    turns: int = WARM_TURNS,
) -> Measured | None:  # fmt: skip
    """One configuration on one scene; None, with a word, where its settings are not known."""
    try:
        settings = make_settings(values, size)
    except SettingsError as error:
        why, _, _ = str(error).partition(":")
        say(f"{scene}: skipped {name or name_of(values)}: {why}")
        return None
    with Session(scene, settings) as session:
        image, cpu_s = timed(session, turns)
    measured = Measured(
        scene, name or name_of(values), cpu_s, relative_mse(image.pixels, reference),
        flip(image.pixels, reference), brightness_error(image.pixels, reference),
    )  # fmt: skip
    say(f"{scene}: {measured.name}: {cpu_s:.2f} CPU s, FLIP {measured.flip:.4f}, relMSE {measured.relmse:.4f}")
    return measured


def measure_front(scene: str, reference: F4, say: Callable[[str], None], size: Values) -> list[Measured]:
    """Every candidate on one scene, cheapest first."""
    found = [measure(scene, values, reference, say, size) for values in FRONT]
    return sorted((each for each in found if each), key=lambda each: each.cpu_s)


def cost_ratio(scene: str, one: str, other: str, size: Values) -> float:
    """CPU seconds of one candidate over another's: the median over turns of both, since a single run is noisy."""
    named = {name_of(values): values for values in FRONT}
    settings = [make_settings(named[name], size) for name in (one, other)]
    with Session(scene, settings[0]) as first, Session(scene, settings[1]) as second:
        turns = [(first.render().cpu_s, second.render().cpu_s) for _ in range(1 + COMPARED_TURNS)]
    return statistics.median(a / b for a, b in turns[1:])


def is_preset(measured: Measured) -> bool:
    """Whether these are the settings of a preset with nothing changed."""
    return measured.name in PRESETS
