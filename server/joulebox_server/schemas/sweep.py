"""The sweep document: what to render, on what, and how to judge it."""

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from joulebox_server.schemas.base import Document, Name, Scalar

LARGEST_SEED = 2**53
"""Repeats, references and noise floors count on from a seed; beyond this browsers and databases lose digits."""


class SceneEntry(Document):
    """A scene by its name, with values for its `<default>`s."""

    name: Name
    defines: dict[str, str] = Field(default_factory=dict)

    @property
    def label(self) -> str:
        """What tells this entry from others of the sweep: `cornell-bunny detail=948`."""
        return " ".join([self.name, *(f"{key}={value}" for key, value in sorted(self.defines.items()))])


def _entry(value: object) -> object:
    return {"name": value} if isinstance(value, str) else value


class Requires(Document):
    """What a device must be; every field given must fit: texts as the beginning of the device's, in any case."""

    platform: str | None = None
    machine: str | None = None
    os: str | None = None
    isa: str | None = None
    min_cores: int | None = Field(default=None, ge=1)
    energy_method: str | None = None


class MeasureRules(Document):
    """Windows of `window_s`; as many as the wanted relative `half_width` takes, within the limits."""

    window_s: float = Field(default=60.0, gt=0, le=3600)
    min_windows: int = Field(default=5, ge=1, le=1000)
    max_windows: int = Field(default=20, ge=1, le=1000)
    half_width: float = Field(default=0.05, gt=0, lt=1)
    max_seconds: float = Field(default=900.0, gt=0, le=86_400)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_windows > self.max_windows:
            raise ValueError(f"min_windows {self.min_windows} is more than max_windows {self.max_windows}")
        return self


class ReferenceRules(Document):
    """The picture that the others are compared with.

    With `preset`: that preset at the sweep's width and height, then `settings`. With `settings` alone: the
    sweep's base settings, then these. With neither: the preset `reference`.
    """

    settings: dict[str, Scalar] = Field(default_factory=dict)
    preset: str | None = None
    seed_policy: Literal["other", "same"] = "other"


class SweepDefinition(Document):
    """A sweep as a file or a request states it."""

    name: Name
    scenes: list[Annotated[SceneEntry, BeforeValidator(_entry)]] = Field(min_length=1, max_length=50)
    devices: list[str] | None = Field(default=None, min_length=1, max_length=100)
    requires: Requires | None = None
    preset: str | None = None
    settings: dict[str, Scalar] = Field(default_factory=dict)
    axes: dict[str, Annotated[list[Scalar], Field(min_length=1, max_length=1000)]] = Field(default_factory=dict)
    rule: Literal["grid", "one_at_a_time", "list"] = "grid"
    configurations: list[dict[str, Scalar]] = Field(default_factory=list)
    repeats: int = Field(default=3, ge=1, le=1000)
    measure: MeasureRules = MeasureRules()
    reference: ReferenceRules = ReferenceRules()
    exposure: float | None = Field(default=None, gt=0, le=1e6)
    limit: float = Field(default=100.0, gt=0)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.devices is not None and self.requires is not None:
            raise ValueError("devices and requires cannot both be given; name devices or say what one must be")
        if (self.rule == "list") != bool(self.configurations):
            raise ValueError('configurations and rule = "list" belong together; give both or neither')
        if self.rule == "list" and self.axes:
            raise ValueError('rule = "list" takes its settings from configurations; remove axes')
        if len({entry.label for entry in self.scenes}) != len(self.scenes):
            raise ValueError("scenes names one scene twice with the same defines")
        given = [self.settings, self.reference.settings, *self.configurations]
        seeds = [settings["seed"] for settings in given if "seed" in settings] + self.axes.get("seed", [])
        for seed in seeds:
            if type(seed) is not int or not 0 <= seed <= LARGEST_SEED:
                raise ValueError(f"seed is {seed!r}, it must be a whole number from 0 to {LARGEST_SEED}")
        for axis, values in self.axes.items():
            if len({(type(value), value) for value in values}) != len(values):
                raise ValueError(f"axes.{axis} holds a value twice")
        return self

    @property
    def picture_exposure(self) -> float:
        """The exposure that pictures are compared and shown at: the sweep's, else the settings', else 1."""
        if self.exposure is not None:
            return self.exposure
        setting = self.settings.get("exposure", 1.0)
        return float(setting) if isinstance(setting, int | float) and setting > 0 else 1.0

    @property
    def requires_text(self) -> str | None:
        """What a device must be, as JSON text."""
        return None if self.requires is None else self.requires.model_dump_json()

    @property
    def base_seed(self) -> int:
        """The seed that the repeats count from."""
        seed = self.settings.get("seed", 0)
        return seed if isinstance(seed, int) else 0
