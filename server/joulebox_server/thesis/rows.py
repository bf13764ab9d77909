"""One row a render: what it cost, stage by stage, and how far its picture is from the reference's.

Stages are in the thesis' booking: precomputed irradiance under `photon_map`, everything that is seen through mirror
or glass under `direct`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Purpose = Literal["measure", "reference", "noise_floor", "control"]
CostBasis = Literal["measured", "replayed", "time"]
STAGES = ("photon_map", "direct", "indirect", "caustics")
AGAIN = "-again"
"""End of the name of a sweep that renders some configurations of another with further seeds."""


@dataclass(frozen=True)
class Cost:
    """Of an image or a stage: wall seconds, CPU seconds of all threads, joules where they are known."""

    time_s: float
    cpu_s: float
    energy_j: float | None = None

    def on(self, basis: CostBasis) -> float:
        """Joules, or CPU seconds where the basis is time: a busy machine stretches wall time, CPU time hardly."""
        if basis == "time" or self.energy_j is None:
            return self.cpu_s
        return self.energy_j


@dataclass(frozen=True)
class Row:
    """One render of one configuration.

    sweep, scene     the sweep's name, the scene's label (`cornell-bunny detail=948 size=small`)
    defines          the scene's own variables
    settings         all of the renderer's settings, the seed among them
    stages           thesis booking; a stage that did not run is not there
    difference       to the sweep's reference of this scene: same seed, but for a noise floor; None for the reference
    reference_sha256 of the picture that it was compared with
    """

    sweep: str
    scene: str
    defines: Mapping[str, str]
    purpose: Purpose
    settings: Mapping[str, Any]
    repeat: int
    seed: int
    image: Cost
    stages: Mapping[str, Cost]
    quality: str
    difference: float | None
    image_sha256: str | None
    reference_sha256: str | None
    delta_sha256: str | None
    pixel_sha256: str | None
    photons: Mapping[str, Any]
    samples_sha256: str | None = None

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> "Row":
        """The row that `dataclasses.asdict` made plain. Raises KeyError, TypeError for another thing."""
        stages = {name: Cost(**cost) for name, cost in told["stages"].items()}
        return cls(**{**told, "image": Cost(**told["image"]), "stages": stages})

    @property
    def pixels(self) -> int:
        """Pixels of the picture."""
        return int(self.settings["width"]) * int(self.settings["height"])


def base_sweep(name: str) -> str:
    """The sweep whose configurations these are: itself, or the one that it renders again."""
    return name.removesuffix(AGAIN)


def configuration_key(settings: Mapping[str, Any]) -> str:
    """Equal for equal settings, the seed aside."""
    return repr(sorted((name, value) for name, value in settings.items() if name != "seed"))
