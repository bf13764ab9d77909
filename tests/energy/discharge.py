"""Scripted discharges with a known answer: what a machine draws, and what its battery's gauge says of it.

Shares no code with the agent. Power is constant within a stage and follows an image's stages over and over;
drift multiplies it. The gauge shows, every `refresh_s`, the mean of the last `lag_s` seconds with white noise
and in whole steps; the counter shows the energy left, in whole steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Machine:
    """stages: (name, power_w, time_s) of one image in order; idle and set-up around the rendering."""

    stages: tuple[tuple[str, float, float], ...] = (("photon_map", 24.0, 0.6), ("direct", 17.0, 1.3),
                                                    ("indirect", 14.0, 0.8))  # fmt: skip
    jitter: float = 0.02  # of an image's time
    between_s: float = 0.01  # from an image's end to the next one's start, at between_w
    between_w: float = 11.0
    idle_w: float = 8.0
    idle_s: float = 40.0
    setup_w: float = 12.0
    setup_s: float = 5.0
    drift_share: float = 0.0  # standard deviation of an Ornstein-Uhlenbeck factor
    drift_time_s: float = 120.0

    @property
    def image_j(self) -> float:
        """Energy of an image in the long run, the time between two included."""
        return sum(power_w * time_s for _, power_w, time_s in self.stages) + self.between_w * self.between_s

    @property
    def image_s(self) -> float:
        return sum(time_s for _, _, time_s in self.stages) + self.between_s


def configured(rng: np.random.Generator, machine: Machine) -> Machine:
    """The same machine with settings under which every stage takes another time."""
    return replace(
        machine,
        stages=tuple((name, power_w, time_s * 3 ** rng.uniform(-1, 1)) for name, power_w, time_s in machine.stages),
    )


@dataclass(frozen=True)
class Gauge:
    refresh_s: float = 4.0
    lag_s: float = 4.0
    noise_w: float = 0.4
    step_w: float = 0.001
    counter_step_j: float = 3.6
    full_j: float = 180_000.0


Image = list[tuple[str, float, float]]  # stages as (name, start_s, end_s)


@dataclass
class Discharge:
    """One run: idle, then set-up and images of every machine in turn, idle. Power is constant between edges."""

    edges_s: Floats
    used_j: Floats
    blocks: list[list[Image]]

    def energy_j(self, start_s: float, end_s: float) -> float:
        """What was really drawn."""
        at_start, at_end = np.interp([start_s, end_s], self.edges_s, self.used_j)
        return float(at_end - at_start)


def script(rng: np.random.Generator, machines: Sequence[Machine], rendering_s: float) -> Discharge:
    """Draws a run in which every machine renders for at least `rendering_s`; the first one's drift is for all."""
    first = machines[0]
    pieces: list[tuple[float, float]] = [(1.0, first.idle_w)] * round(first.idle_s)
    blocks = []
    for machine in machines:
        pieces += [(machine.setup_s / 5, machine.setup_w)] * 5
        begin_s = sum(length_s for length_s, _ in pieces)
        images, lengths = _images(rng, machine, begin_s, rendering_s)
        pieces += lengths
        blocks.append(images)
    pieces += [(1.0, first.idle_w)] * round(first.idle_s)
    lengths_s, power_w = np.array(pieces).T
    if first.drift_share:
        power_w = power_w * (1 + first.drift_share * _wander(rng, lengths_s / first.drift_time_s))
    edges_s = np.concatenate([[0.0], np.cumsum(lengths_s)])
    return Discharge(edges_s, np.concatenate([[0.0], np.cumsum(lengths_s * power_w)]), blocks)


def _images(
    rng: np.random.Generator, machine: Machine, now_s: float, rendering_s: float
) -> tuple[list[Image], list[tuple[float, float]]]:
    """Images from now_s on, and the (time_s, power_w) that they are made of."""
    end_s = now_s + rendering_s
    images, pieces = [], []
    while now_s < end_s:
        stretch = max(0.5, 1 + machine.jitter * rng.standard_normal())
        image = []
        for name, power_w, time_s in machine.stages:
            image.append((name, now_s, now_s + stretch * time_s))
            now_s += stretch * time_s
            pieces.append((stretch * time_s, power_w))
        images.append(image)
        now_s += stretch * machine.between_s
        pieces.append((stretch * machine.between_s, machine.between_w))
    return images, pieces


def _wander(rng: np.random.Generator, steps: Floats) -> Floats:
    """An Ornstein-Uhlenbeck process of variance 1, `steps` in units of its correlation time."""
    value, values = rng.standard_normal(), []
    for keep, kick in zip(np.exp(-steps), rng.standard_normal(steps.size), strict=True):
        value = keep * value + (1 - keep**2) ** 0.5 * kick
        values.append(value)
    return np.array(values)


def gauge_updates(rng: np.random.Generator, discharge: Discharge, gauge: Gauge) -> tuple[Floats, list[int], list[int]]:
    """Times of the refreshes [s], power_now [uW] and energy_now [uWh] from each of them on."""
    first_s, last_s = discharge.edges_s[0], discharge.edges_s[-1]
    times_s = np.arange(first_s + rng.uniform(0.0, gauge.refresh_s), last_s, gauge.refresh_s)
    lag_s = max(gauge.lag_s, 1e-3)
    used_j = np.interp(times_s, discharge.edges_s, discharge.used_j)
    earlier_s = np.maximum(times_s - lag_s, first_s)
    mean_w = (used_j - np.interp(earlier_s, discharge.edges_s, discharge.used_j)) / np.maximum(
        times_s - earlier_s, 1e-6
    )
    shown_w = mean_w + gauge.noise_w * rng.standard_normal(times_s.size)
    shown_w = np.maximum(gauge.step_w, np.round(shown_w / gauge.step_w) * gauge.step_w)
    left_j = gauge.full_j - gauge.counter_step_j * rng.uniform() - used_j
    shown_j = np.floor(left_j / gauge.counter_step_j) * gauge.counter_step_j
    return times_s, [round(w * 1e6) for w in shown_w], [round(j / 3600 * 1e6) for j in shown_j]
