"""The settings of a render: names after the thesis, validated, with units; presets; and how text becomes settings."""

from __future__ import annotations

import difflib
import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from joulebox_render.errors import SettingsError


class Settings(BaseModel):
    """What to render and how; see the fields' descriptions. Numbers are SI units; counts are counts."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    width: int | None = Field(None, ge=1, le=16384, description="pixels across; null: the scene's film")
    height: int | None = Field(None, ge=1, le=16384, description="pixels down; null: the scene's film")
    samples_per_pixel: int = Field(8, ge=1, le=65536, description="eye rays a pixel")
    jitter: bool = Field(True, description="place eye rays at random in their strata of the pixel")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="of every random choice; a whole number of up to 63 bits")
    threads: int = Field(0, ge=0, le=1024, description="worker threads; 0: one a usable core")
    exposure: float = Field(1.0, gt=0, le=1e6, description="factor on radiance for PNG pictures and differences")

    global_photons: int = Field(100_000, ge=1, le=50_000_000, description="photons stored in the global map")
    caustic_photons: int = Field(100_000, ge=0, le=50_000_000, description="photons stored in the caustic map")
    direct_photons: int = Field(
        10_000, ge=0, le=50_000_000,
        description="photons kept where they first hit, with the shadow photons behind them, for use_shadow_photons",
    )  # fmt: skip
    max_photon_bounces: int = Field(64, ge=0, le=1000, description="a photon is dropped after this many bounces")
    store_at_every_bounce: bool = Field(
        True, description="store photons at every diffuse bounce; false: only where they are absorbed"
    )

    shadow_rays: int = Field(
        4, ge=1, le=16384, description="shadow rays to each area light, from every point that a sample of a pixel sees"
    )
    use_shadow_photons: bool = Field(
        False, description="save shadow rays where direct and shadow photons agree that a light is seen or hidden"
    )
    max_depth: int = Field(12, ge=0, le=100, description="mirror, glass and glossy bounces in a row")

    indirect: Literal["none", "direct_visualization", "final_gather", "path"] = Field(
        "final_gather", description="how light that bounced off diffuse surfaces is found"
    )
    gather_count: int = Field(100, ge=2, le=100_000, description="photons in a density estimate, at most")
    gather_distance_m: float = Field(0.02, gt=0, le=1e6, description="[m] photons farther away do not count")
    normal_angle_deg: float = Field(
        30.0, gt=0, le=90, description="[degree] photons on surfaces turned away by more do not count"
    )
    gather_filter: Literal["constant", "cone", "epanechnikov"] = Field(
        "constant", description="weight of photons over the gather disc of the global map; caustics always use the cone"
    )
    photon_spacing: int = Field(
        4, ge=0, le=1_000_000, description="precompute irradiance at every nth photon; 0: estimate it at every look-up"
    )
    final_gather_rays: int = Field(256, ge=1, le=16384, description="rays of a final gather")
    importance_sampling: bool = Field(
        False, description="send gather rays where the global map says that light comes from"
    )
    irradiance_cache_tolerance: float = Field(
        0.8, ge=0, le=10, description="error allowed in reusing a final gather nearby (Ward); 0: gather at every point"
    )
    irradiance_gradients: bool = Field(
        True, description="interpolate cached irradiance with its rotation and translation gradients"
    )

    caustics: bool = Field(True, description="show caustics from a photon map of their own")
    caustic_gather_count: int = Field(100, ge=2, le=100_000, description="photons in a caustic estimate, at most")
    caustic_gather_distance_m: float = Field(
        0.006, gt=0, le=1e6, description="[m] caustic photons farther away do not count"
    )
    caustic_hints: bool = Field(True, description="aim the caustic map's photons at mirrors, glass and glossy surfaces")

    sampler: Literal["independent", "stratified", "sobol"] = Field(
        "sobol", description="how samples of a pixel, a light, a hemisphere and (sobol) the photons are placed"
    )

    @field_validator("*", mode="before")
    @classmethod
    def _true_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        """pydantic would take true for 1."""
        if isinstance(value, bool) and cls.model_fields[str(info.field_name)].annotation is not bool:
            raise PydanticCustomError("not_a_boolean", "Input should not be true or false")
        return value


_DRAFT: dict[str, Any] = {
    "samples_per_pixel": 4, "shadow_rays": 2, "global_photons": 30_000, "caustic_photons": 30_000,
    "final_gather_rays": 144, "irradiance_cache_tolerance": 1.0, "caustic_gather_distance_m": 0.01,
    "gather_distance_m": 0.04,
}  # fmt: skip
_FINE: dict[str, Any] = {
    "samples_per_pixel": 16, "shadow_rays": 8, "global_photons": 250_000, "caustic_photons": 200_000,
    "final_gather_rays": 576, "irradiance_cache_tolerance": 0.5, "caustic_gather_distance_m": 0.004,
}  # fmt: skip
# The thesis' yardstick: 250k photons within 0.02 m, 144 shadow rays, 256 gather rays, tolerance 0.02, no
# precomputation; and none of what goes beyond it.
_REFERENCE: dict[str, Any] = {
    "width": 256, "height": 256, "samples_per_pixel": 4, "shadow_rays": 144, "global_photons": 250_000,
    "caustic_photons": 50_000, "direct_photons": 10_000, "indirect": "final_gather", "gather_count": 100,
    "gather_distance_m": 0.02, "caustic_gather_distance_m": 0.01, "photon_spacing": 0, "final_gather_rays": 256,
    "irradiance_cache_tolerance": 0.02, "caustic_hints": False, "sampler": "stratified",
}  # fmt: skip
PRESETS: dict[str, dict[str, Any]] = {"draft": _DRAFT, "balanced": {}, "fine": _FINE, "reference": _REFERENCE}


def preset_values(name: object) -> dict[str, Any]:
    """The values a preset sets; SettingsError on an unknown name."""
    if not isinstance(name, str) or name not in PRESETS:
        raise SettingsError(f"preset {name!r} is unknown: {_suggestion(str(name), list(PRESETS))}")
    return PRESETS[name]


def make_settings(*layers: Mapping[str, Any]) -> Settings:
    """Settings from layers, later ones over earlier; a layer's key `preset` puts that preset under it.

    Raises SettingsError with one sentence: the first setting that is unknown (with the nearest known one), or
    malformed or out of range (with what is allowed).
    """
    values: dict[str, Any] = {}
    for layer in layers:
        rest = dict(layer)
        if "preset" in rest:
            values.update(preset_values(rest.pop("preset")))
        values.update(rest)
    for name in values:
        if name not in Settings.model_fields:
            raise SettingsError(f"setting '{name}' is unknown: {_suggestion(name, list(Settings.model_fields))}")
    try:
        return Settings(**values)
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0])
        raise SettingsError(
            f"setting '{name}' cannot be {first['input']!r}: {_allowed(name, str(first['msg']))}"
        ) from None


def parse_assignments(assignments: Sequence[str]) -> dict[str, Any]:
    """Values of `key=value` texts as JSON where they read as JSON, else as strings."""
    values: dict[str, Any] = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise SettingsError(f"'--set {text}' is not of the form key=value, such as --set shadow_rays=64")
        try:
            values[name.strip()] = json.loads(value)
        except (ValueError, RecursionError):
            values[name.strip()] = value.strip()
    return values


def read_settings_file(path: Path) -> dict[str, Any]:
    """Values of a JSON or TOML file of settings."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"settings file {path} cannot be read: {_reason(error)}") from None
    try:
        values = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SettingsError(f"settings file {path} is not valid {path.suffix[1:].upper() or 'JSON'}: {error}") from None
    if not isinstance(values, dict):
        raise SettingsError(f'settings file {path} must hold an object of settings, such as {{"shadow_rays": 64}}')
    return values


def settings_schema() -> dict[str, Any]:
    """JSON Schema of the settings, with the presets beside it."""
    schema = Settings.model_json_schema()
    schema["title"] = "joulebox-render settings"
    schema["presets"] = PRESETS
    return schema


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _suggestion(name: str, known: list[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"known are {', '.join(known)}"


def _allowed(name: str, message: str) -> str:
    """A range or type in words: pydantic's own message, lower case, with the setting's unit."""
    field = Settings.model_fields[name]
    return f"{message[0].lower()}{message[1:]} ({field.description})"
