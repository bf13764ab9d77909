"""The sweep document: what to render, on what, and how to judge it."""

from functools import lru_cache
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from joulebox_server.schemas.base import Document, Name, Scalar

LARGEST_SEED = 2**53
"""Repeats, references and noise floors count on from a seed; beyond this browsers and databases lose digits."""

DRAWN = ("random", "sobol")
"""Rules that draw configurations from the axes."""


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
    """What a device must be; every field given must fit: texts as the beginning of the device's, in any case.

    `energy_method` and `renderer_version` must be the very words.
    """

    platform: str | None = None
    machine: str | None = None
    os: str | None = None
    isa: str | None = None
    min_cores: int | None = Field(default=None, ge=1)
    energy_method: str | None = None
    renderer: str | None = None
    renderer_version: str | None = None


class Range(Document):
    """Values to draw from, both ends included; whole numbers when both ends are."""

    low: int | float
    high: int | float
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.low < self.high:
            raise ValueError(f"low {self.low} must be less than high {self.high}")
        if max(abs(self.low), abs(self.high)) > LARGEST_SEED:
            raise ValueError(f"low and high must be within {LARGEST_SEED} of 0")
        if self.scale == "log" and self.low <= 0:
            raise ValueError(f'low is {self.low}; with scale = "log" it must be more than 0')
        return self


def _kind(value: object) -> str:
    return "(range)" if isinstance(value, dict | Range) else "(list)"


# Discriminated, so that an error is about the kind that was given and not about both.
Axis = Annotated[
    Annotated[list[Scalar], Field(min_length=1, max_length=1000), Tag("(list)")] | Annotated[Range, Tag("(range)")],
    Discriminator(_kind),
]


class MeasureRules(Document):
    """Windows of `window_s`; as many as the wanted relative `half_width` takes, within the limits.

    With `meter = "few"` every configuration is timed, and only so many are metered as take `metered_windows`
    windows: their joules give the power of each stage, which prices the others. With `meter = "none"` every job is
    one image and its time, and of a short one as many as begin within a second, or within `window_s` where that is
    less.
    """

    window_s: float = Field(default=60.0, gt=0, le=3600)
    min_windows: int = Field(default=5, ge=1, le=1000)
    max_windows: int = Field(default=20, ge=1, le=1000)
    half_width: float = Field(default=0.05, gt=0, lt=1)
    max_seconds: float = Field(default=900.0, gt=0, le=86_400)
    meter: Literal["all", "few", "none"] = "all"
    metered_windows: int = Field(default=20, ge=1, le=10_000)

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
    axes: dict[str, Axis] = Field(default_factory=dict, max_length=100)
    rule: Literal["grid", "one_at_a_time", "random", "sobol", "list"] = "grid"
    samples: int | None = Field(default=None, ge=1, le=100_000)
    """Configurations that `random` and `sobol` draw."""
    sample_seed: int = Field(default=0, ge=0, le=LARGEST_SEED)
    configurations: list[dict[str, Scalar]] = Field(default_factory=list, max_length=100_000)
    repeats: int = Field(default=3, ge=1, le=1000)
    seeds: Literal["shared", "own"] | None = None
    """Whether configurations share the repeats' seeds; see `sweeps.seeds`. Unless given, what is drawn has its own."""
    controls: int = Field(default=0, ge=0, le=100)
    """Control runs of each scene in each block: the first configuration once more, spread over the block."""
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
        if (self.samples is None) == (self.rule in DRAWN):
            raise ValueError('samples and rule = "random" or "sobol" belong together; give both or neither')
        if self.rule in DRAWN and not self.axes:
            raise ValueError(f'rule = "{self.rule}" draws from axes; give at least one')
        if self.seeds == "own" and self.reference.seed_policy == "same":
            raise ValueError(
                'seeds = "own" needs reference.seed_policy = "other": with "same" a repeat is compared with the '
                "reference of its own seed, which all configurations share"
            )
        self._check_axes()
        given = [self.settings, self.reference.settings, *self.configurations]
        seeds = [settings["seed"] for settings in given if "seed" in settings]
        axis = self.axes.get("seed", [])
        seeds += [axis.low, axis.high] if isinstance(axis, Range) else axis
        for seed in seeds:
            if type(seed) is not int or not 0 <= seed <= LARGEST_SEED:
                raise ValueError(f"seed is {seed!r}, it must be a whole number from 0 to {LARGEST_SEED}")
        return self

    def _check_axes(self) -> None:
        for axis, values in self.axes.items():
            if isinstance(values, Range):
                if self.rule not in DRAWN:
                    raise ValueError(f'axes.{axis} is a range; rule = "{self.rule}" needs a list of values')
            elif len({(type(value), value) for value in values}) != len(values):
                raise ValueError(f"axes.{axis} holds a value twice")

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
    def own_seeds(self) -> bool:
        """Whether every configuration has seeds of its own."""
        return self.seeds == "own" or (
            self.seeds is None and self.rule in DRAWN and self.reference.seed_policy == "other"
        )

    @property
    def base_seed(self) -> int:
        """The seed that the repeats count from."""
        seed = self.settings.get("seed", 0)
        return seed if isinstance(seed, int) else 0


@lru_cache(maxsize=256)
def definition_of(text: str) -> SweepDefinition:
    """The definition in JSON text that was checked before; the same text is read once."""
    return SweepDefinition.model_validate_json(text)
