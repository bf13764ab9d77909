"""Settings: what is accepted, what is refused and how, and that each setting does what it says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from joulebox_render.errors import SettingsError
from joulebox_render.settings import (
    PRESETS,
    Settings,
    make_settings,
    parse_assignments,
    read_settings_file,
    settings_schema,
)

FIELDS = settings_schema()["properties"]
NUMBERS = [name for name, field in FIELDS.items() if "anyOf" in field or field["type"] in ("integer", "number")]


def limits(name: str) -> dict[str, Any]:
    """The JSON Schema of a number: minimum, maximum, exclusiveMinimum."""
    field = FIELDS[name]
    return next((part for part in field.get("anyOf", []) if part["type"] != "null"), field)


def refusal(**values: Any) -> str:
    with pytest.raises(SettingsError) as caught:
        make_settings(values)
    return str(caught.value)


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_are_held_to_their_limits(name: str) -> None:
    given = limits(name)
    whole = given["type"] == "integer"
    least = given.get("minimum", given.get("exclusiveMinimum"))
    for value in (given["maximum"], least if "minimum" in given else least + 0.001):
        assert getattr(make_settings({name: value}), name) == value
    below = least - 1 if whole else (least if "exclusiveMinimum" in given else least - 0.001)
    for value in (below, given["maximum"] + 1):
        said = refusal(**{name: value})
        assert said.startswith(f"setting '{name}' cannot be {value!r}: input should be ")
        assert "\n" not in said


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), "many", [], {}, True, False])
def test_what_is_no_number_is_refused(name: str, value: Any) -> None:
    assert refusal(**{name: value}).startswith(f"setting '{name}' cannot be {value!r}: ")


@pytest.mark.parametrize("name", [name for name in NUMBERS if limits(name)["type"] == "integer"])
def test_counts_are_whole(name: str) -> None:
    assert "integer" in refusal(**{name: 1.5})


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("indirect", ["none", "direct_visualization", "final_gather", "path"]),
        ("gather_filter", ["constant", "cone", "epanechnikov"]),
        ("sampler", ["independent", "stratified"]),
    ],
)
def test_choices_are_named_when_refused(name: str, words: list[str]) -> None:
    for word in words:
        assert getattr(make_settings({name: word}), name) == word
    said = refusal(**{name: "other"})
    assert all(f"'{word}'" in said for word in words)


@pytest.mark.parametrize("name", ["jitter", "caustics", "store_at_every_bounce"])
def test_switches(name: str) -> None:
    assert getattr(make_settings({name: False}), name) is False
    assert "boolean" in refusal(**{name: "perhaps"})


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("shadow_ray", "shadow_rays"), ("gather_distance", "gather_distance_m"), ("Seed", "seed"), ("widht", "width")],
)
def test_a_misspelt_setting_is_met_with_the_nearest(wrong: str, right: str) -> None:
    assert refusal(**{wrong: 1}) == f"setting '{wrong}' is unknown: did you mean '{right}'?"


def test_a_setting_like_no_other_is_met_with_all_there_are() -> None:
    said = refusal(zzz=1)
    assert said.startswith("setting 'zzz' is unknown: known are width, height, ")


def test_later_layers_win_and_a_preset_lies_under_its_layer() -> None:
    settings = make_settings({"preset": "reference", "shadow_rays": 9}, {"shadow_rays": 16, "seed": 2})
    assert (settings.shadow_rays, settings.seed, settings.global_photons) == (16, 2, 250_000)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_settings(name: str) -> None:
    settings = make_settings({"preset": name})
    assert all(getattr(settings, key) == value for key, value in PRESETS[name].items())


def test_the_reference_preset_is_the_thesis_yardstick() -> None:
    settings = make_settings({"preset": "reference"})
    assert (settings.width, settings.height, settings.samples_per_pixel, settings.shadow_rays) == (256, 256, 4, 144)
    assert (settings.global_photons, settings.gather_count, settings.gather_distance_m) == (250_000, 100, 0.02)
    assert (settings.indirect, settings.photon_spacing, settings.final_gather_rays) == ("final_gather", 0, 256)
    assert settings.normal_angle_deg == 30


@pytest.mark.parametrize("preset", ["refrence", "", 3, ["reference"], None])
def test_an_unknown_preset_is_refused(preset: Any) -> None:
    said = refusal(preset=preset)
    assert said.startswith(f"preset {preset!r} is unknown: ")
    if preset == "refrence":
        assert said.endswith("did you mean 'reference'?")


def test_settings_are_frozen() -> None:
    with pytest.raises(Exception, match="frozen"):
        make_settings().seed = 3  # type: ignore[misc]


def test_assignments_read_as_json_or_as_words() -> None:
    given = [
        "shadow_rays=64",
        "indirect=path",
        "jitter=false",
        "gather_distance_m=2e-2",
        "width=null",
        ' sampler = "x" ',
    ]
    assert parse_assignments(given) == {
        "shadow_rays": 64, "indirect": "path", "jitter": False, "gather_distance_m": 0.02, "width": None,
        "sampler": "x",
    }  # fmt: skip


@pytest.mark.parametrize("text", ["", "shadow_rays", "=4", "shadow_rays:4"])
def test_an_assignment_without_its_parts_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="is not of the form key=value"):
        parse_assignments([text])


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 200_000, "NaN", "-Infinity", "{", '"4', "1e999"])
def test_monstrous_values_are_refused_like_any_other(value: str) -> None:
    with pytest.raises(SettingsError, match="setting 'seed' cannot be"):
        make_settings(parse_assignments([f"seed={value}"]))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.json", '{"shadow_rays": 64, "indirect": "path", "width": null}'),
        ("a.toml", 'shadow_rays = 64\nindirect = "path"\n'),
        ("a.TOML", 'shadow_rays = 64\nindirect = "path"\n'),
    ],
)
def test_files_of_settings(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    settings = make_settings(read_settings_file(tmp_path / name))
    assert (settings.shadow_rays, settings.indirect, settings.width) == (64, "path", None)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.json", b'{"shadow_rays": 64', "is not valid JSON"),
        ("a.json", b"", "is not valid JSON"),
        ("a.json", b"[1]", "must hold an object of settings"),
        ("a.json", b"7", "must hold an object of settings"),
        ("a.json", b'{"seed": ' + b"9" * 5000 + b"}", "is not valid JSON"),
        ("a.json", b"[" * 200_000, "is not valid JSON"),
        ("a.json", b"\xff\xfe\x00", "cannot be read"),
        ("a.toml", b"shadow_rays = ", "is not valid TOML"),
        ("a.toml", b"shadow_rays = 1\nshadow_rays = 2\n", "is not valid TOML"),
        ("missing.json", None, "cannot be read"),
        ("folder", None, "cannot be read"),
    ],
)
def test_a_broken_file_is_refused_in_a_sentence(tmp_path: Path, name: str, content: bytes | None, said: str) -> None:
    (tmp_path / "folder").mkdir()
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SettingsError) as caught:
        read_settings_file(tmp_path / name)
    assert said in str(caught.value)
    assert name in str(caught.value)


def test_the_schema_describes_every_setting_and_takes_no_other() -> None:
    schema = json.loads(json.dumps(settings_schema()))
    assert schema["additionalProperties"] is False
    assert set(schema["properties"]) == set(Settings.model_fields)
    assert all(field["description"] for field in schema["properties"].values())
    assert schema["presets"] == PRESETS
    defaults = {name: field["default"] for name, field in schema["properties"].items()}
    assert make_settings(defaults) == make_settings()
    assert make_settings(make_settings().model_dump()) == make_settings()


def test_lengths_and_angles_carry_their_unit() -> None:
    for name, field in FIELDS.items():
        if "[m]" in field["description"]:
            assert name.endswith("_m")
        if "[degree]" in field["description"]:
            assert name.endswith("_deg")


def test_a_seed_out_of_range_is_refused_in_one_sentence() -> None:
    for value, words in ((-1, "greater than or equal to 0"), (2**63, f"less than or equal to {2**63 - 1}")):
        said = refusal(seed=value)
        assert said.startswith(f"setting 'seed' cannot be {value}: input should be {words} (of every random choice")
        assert "\n" not in said
