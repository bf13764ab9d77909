"""Checks a sweep's settings against the JSON Schema that a renderer publishes for them."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import SchemaError, ValidationError, best_match
from jsonschema.validators import extend

from joulebox_server.errors import FieldError
from joulebox_server.schemas.sweep import Range, SweepDefinition

PRESET = "preset"
REFERENCES = ("$ref", "$dynamicRef")
DEFINITIONS = ("$defs", "definitions")
LARGEST_ECHO = 60
LARGEST_SCHEMA = 5000
"""Values in a schema; ours holds some hundreds, and to check one takes 0.2 ms a value."""


def schema_fault(schema: Mapping[str, Any]) -> str | None:
    """What makes `schema` no JSON Schema of an object with properties, or None."""
    if _holds_more(schema, LARGEST_SCHEMA):
        return f"it holds more than {LARGEST_SCHEMA} values"
    try:
        Draft202012Validator.check_schema(schema)
    except SchemaError as error:
        return str(error.message)
    if not isinstance(schema.get("properties"), dict):
        return "it has no properties"
    known = {f"#/{key}/{name}": inner for key in DEFINITIONS for name, inner in schema.get(key, {}).items()}
    for name, inner in [*schema["properties"].items(), *known.items()]:
        if not isinstance(inner, dict):
            return f"its {name!r} is {inner!r} and no object that says what it may be"
        if any(True for _ in _values(inner, "$id")):
            return f"its {name!r} has an $id, so that its references lead elsewhere"
    lost = next((reference for reference in _values(schema, *REFERENCES) if reference not in known), None)
    if lost is not None:
        return f"its reference {lost!r} leads to none of its definitions"
    return _circle({name: set(_values(inner, *REFERENCES)) for name, inner in known.items()})


def _circle(leads: dict[str, set[str]]) -> str | None:
    """What is wrong when a definition leads back to itself: to look a setting up in it would never end."""
    while ends := [name for name, others in leads.items() if not others]:
        leads = {name: others - set(ends) for name, others in leads.items() if others}
    return f"its definitions {', '.join(leads)} lead back to themselves" if leads else None


def _holds_more(document: Any, most: int) -> bool:
    waiting, count = [document], 0
    while waiting and count <= most:
        part = waiting.pop()
        count += 1
        if isinstance(part, dict):
            waiting += part.values()
        elif isinstance(part, list):
            waiting += part
    return count > most


def _values(part: Any, *keys: str) -> Iterator[Any]:
    """What these keys hold anywhere in a part of a schema."""
    if isinstance(part, dict):
        for key, inner in part.items():
            if key in keys:
                yield inner
            else:
                yield from _values(inner, *keys)
    elif isinstance(part, list):
        for inner in part:
            yield from _values(inner, *keys)


def _passed_over(*_: Any) -> Iterator[ValidationError]:
    """Of a text's pattern the renderer is judge: a device's regular expression could hold the server for years."""
    yield from ()


Settings = extend(Draft202012Validator, {"pattern": _passed_over, "patternProperties": _passed_over})  # type: ignore[no-untyped-call]


def settings_errors(definition: SweepDefinition, schema: Mapping[str, Any]) -> list[FieldError]:
    """Every setting of a sweep that the renderer would refuse, with the path of the axis or setting."""
    return [
        FieldError(field, problem)
        for field, name, value in _given(definition)
        if (problem := _problem(schema, name, value)) is not None
    ]


def _given(definition: SweepDefinition) -> Iterator[tuple[str, str, Any]]:
    """(path, setting, value) of everything that a definition sets."""
    if definition.preset is not None:
        yield PRESET, PRESET, definition.preset
    if definition.reference.preset is not None:
        yield f"reference.{PRESET}", PRESET, definition.reference.preset
    for name, value in definition.settings.items():
        yield f"settings.{name}", name, value
    for axis, values in definition.axes.items():
        if isinstance(values, Range):
            yield f"axes.{axis}.low", axis, values.low
            yield f"axes.{axis}.high", axis, values.high
            continue
        for position, value in enumerate(values):
            yield f"axes.{axis}[{position}]", axis, value
    for position, settings in enumerate(definition.configurations):
        for name, value in settings.items():
            yield f"configurations[{position}].{name}", name, value
    for name, value in definition.reference.settings.items():
        yield f"reference.settings.{name}", name, value


def _problem(schema: Mapping[str, Any], name: str, value: Any) -> str | None:
    """What is wrong with one setting, as the end of a sentence; None when it is good."""
    properties: Mapping[str, Any] = schema["properties"]
    if name not in properties:
        if name == PRESET:  # the renderer resolves it before its settings are checked
            return None if isinstance(value, str) else f"a preset is a name, not {value!r}"
        nearest = get_close_matches(name, properties, n=1, cutoff=0.5)
        hint = f"did you mean {nearest[0]!r}?" if nearest else f"known are {', '.join(sorted(properties))}"
        return f"the renderer has no setting {name!r}; {hint}"
    # Of a property alone, with the definitions that it may refer to.
    alone = {**properties[name], **{key: schema[key] for key in DEFINITIONS if key in schema}}
    error = best_match(Settings(alone).iter_errors(value))
    return None if error is None else _sentence(_telling(error))


def _telling(error: ValidationError) -> ValidationError:
    """Of "one of these kinds" the error within the kind that the value is of: `-1 or null` says a bound, not null."""
    while error.context:
        of_its_kind = [inner for inner in error.context if inner.validator != "type"]
        error = (of_its_kind or error.context)[0]
    return error


def _sentence(error: ValidationError) -> str:
    bound: Any = error.validator_value
    words = {
        "minimum": "at least",
        "maximum": "at most",
        "exclusiveMinimum": "more than",
        "exclusiveMaximum": "less than",
    }
    given = repr(error.instance)[:LARGEST_ECHO]
    if error.validator in words:
        return f"{given} must be {words[str(error.validator)]} {bound}"
    if error.validator == "enum":
        choices = [str(choice) for choice in bound]
        nearest = get_close_matches(str(error.instance), choices, n=1, cutoff=0.5)
        hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
        return f"{given} is not one of {', '.join(choices)}{hint}"
    if error.validator == "type":
        return f"{given} is not of type {bound}"
    return str(error.message)[: 5 * LARGEST_ECHO]
