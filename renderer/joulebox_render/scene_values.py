"""Typed reading of the properties of one scene object; whatever nobody asked for is refused."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from joulebox_render.records import F8
from joulebox_render.scene_transforms import numbers, parse_number, read_transform, read_vector
from joulebox_render.scene_xml import OBJECT_TAGS, VALUE_TAGS, Element, suggest

# A uniform spectrum (CIE illuminant E) in linear Rec.709: what Mitsuba 3 makes of <spectrum> in a light.
_EQUAL_ENERGY = np.array([1.2047937, 0.9482798, 0.9089125])
_HEX = re.compile(r"#([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})")


class Properties:
    """The children of one object element by name; read each with `take_*`, then call `finish`."""

    def __init__(self, element: Element, objects_by_id: Mapping[str, Element]) -> None:
        """Raises SceneError for a property without name, a name given twice, or a reference to nothing."""
        element.allow_attributes("type", "id", "name")
        self.element = element
        self.type = element.type
        self._values: dict[str, Element] = {}
        self._objects: list[Element] = []
        self._known: set[str] = set()
        for child in element.children:
            if child.tag == "ref":
                self._objects.append(_referred(child, objects_by_id))
            elif child.tag in OBJECT_TAGS:
                self._objects.append(child)
            elif child.tag in VALUE_TAGS:
                self._add(child)
            elif child.tag != "default":
                raise child.error(f"<{child.tag}> cannot stand inside <{element.tag}>")

    def _add(self, child: Element) -> None:
        name = child.attributes.get("name")
        if not name:
            raise child.error(f'<{child.tag}> has no name; write <{child.tag} name="...">')
        if name in self._values:
            raise child.error(
                f'"{name}" is given twice in {self._what()}, also on line {self._values[name].line}; keep one'
            )
        self._values[name] = child

    def _what(self) -> str:
        return f'<{self.element.tag} type="{self.type}">'

    def _take(self, name: str, *tags: str) -> Element | None:
        self._known.add(name)
        child = self._values.pop(name, None)
        if child is None:
            return None
        if child.tag not in tags:
            raise child.error(f'"{name}" is a <{child.tag}> here; in {self._what()} it is a <{tags[0]}>')
        if child.tag not in ("transform", "point", "vector"):
            child.allow_attributes("name", "value")
            if "value" not in child.attributes:
                raise child.error(f'"{name}" has no value; write value="..."')
        return child

    def line_of(self, name: str) -> Element:
        """The element to blame for a property: the property itself if given, else its object."""
        return self._values.get(name, self.element)

    def has(self, name: str) -> bool:
        """Whether the property is given and was not taken yet."""
        self._known.add(name)
        return name in self._values

    def take_float(
        self,
        name: str,
        default: float,
        above: float = -math.inf,
        at_least: float = -math.inf,
        below: float = math.inf,
    ) -> float:
        """A finite number > `above`, >= `at_least` and < `below`."""
        child = self._take(name, "float", "integer")
        if child is None:
            return default
        value = parse_number(child, child.attributes["value"])
        if not (above < value < below and value >= at_least):
            bounds = [
                f"above {above:g}" if above > -math.inf else "",
                f"at least {at_least:g}" if at_least > -math.inf else "",
                f"below {below:g}" if below < math.inf else "",
            ]
            raise child.error(f'"{name}" is {value:g}; it must be {" and ".join(b for b in bounds if b)}')
        return value

    def take_integer(self, name: str, default: int, at_least: int, at_most: int) -> int:
        """A whole number in [at_least, at_most]."""
        child = self._take(name, "integer")
        if child is None:
            return default
        text = child.attributes["value"].strip()
        if not re.fullmatch(r"[+-]?[0-9]{1,18}", text):
            raise child.error(f'"{name}" is "{text}"; it must be a whole number')
        if not at_least <= int(text) <= at_most:
            raise child.error(f'"{name}" is {int(text)}; it must be from {at_least} to {at_most}')
        return int(text)

    def take_boolean(self, name: str, default: bool) -> bool:
        """true or false."""
        child = self._take(name, "boolean")
        if child is None:
            return default
        text = child.attributes["value"].strip().lower()
        if text not in ("true", "false"):
            raise child.error(f'"{name}" is "{text}"; it must be true or false')
        return text == "true"

    def take_string(self, name: str, default: str) -> str:
        """Text as written."""
        child = self._take(name, "string")
        return default if child is None else child.attributes["value"]

    def take_choice(self, name: str, default: str, choices: tuple[str, ...]) -> str:
        """One of a few words."""
        child = self.line_of(name)
        text = self.take_string(name, default)
        if text not in choices:
            raise child.error(f'"{name}" is "{text}"{suggest(text, choices)}')
        return text

    def take_point(self, name: str, default: tuple[float, float, float]) -> F8:
        """(3,) a <point> or <vector>."""
        child = self._take(name, "point", "vector")
        if child is None:
            return np.array(default, dtype=np.float64)
        child.allow_attributes("name", "value", "x", "y", "z")
        return read_vector(child, None)

    def take_transform(self, name: str) -> F8:
        """(4, 4) the composed <transform>; the identity when it is not given."""
        child = self._take(name, "transform")
        return np.eye(4) if child is None else read_transform(child)

    def take_number_or_name(self, name: str, default: float, named: Mapping[str, float]) -> float:
        """A number > 0, or one of `named`, for example an index of refraction."""
        child = self._values.get(name)
        if child is None or child.tag != "string":
            return self.take_float(name, default, above=0.0)
        text = self.take_string(name, "").strip().lower()
        if text not in named:
            raise child.error(f'"{name}" is "{text}"{suggest(text, named)}; or give a <float>')
        return named[text]

    def take_reflectance(self, name: str, default: float) -> F8:
        """(3,) linear Rec.709, each 0..1."""
        child = self._take(name, "rgb", "spectrum", "float")
        if child is None:
            return np.full(3, default)
        color = _color(child)
        if color.min() < 0.0 or color.max() > 1.0:
            raise child.error(f'"{name}" is {_show(color)}; a surface reflects from 0 to 1 of the light')
        return color

    def take_emission(self, name: str) -> F8:
        """(3,) linear Rec.709 radiance or intensity, each >= 0; 1 when it is not given."""
        child = self._take(name, "rgb", "spectrum", "float")
        if child is None:
            return np.ones(3)
        color = _color(child)
        if child.tag == "spectrum":
            color = color * _EQUAL_ENERGY
        if color.min() < 0.0:
            raise child.error(f'"{name}" is {_show(color)}; a light emits 0 or more')
        return color

    def take_objects(self, tag: str) -> list[Element]:
        """The nested or referred-to objects of one tag, in document order."""
        found = [child for child in self._objects if child.tag == tag]
        self._objects = [child for child in self._objects if child.tag != tag]
        return found

    def finish(self) -> None:
        """Refuse every property and object that was not taken."""
        for name, child in self._values.items():
            raise child.error(f'unknown <{child.tag} name="{name}"> in {self._what()}{suggest(name, self._known)}')
        for child in self._objects:
            raise child.error(f"<{child.tag}> cannot stand inside {self._what()}")


def _referred(ref: Element, objects_by_id: Mapping[str, Element]) -> Element:
    ref.allow_attributes("id", "name")
    target = ref.attributes.get("id")
    if not target:
        raise ref.error('<ref> has no id; write <ref id="..."/>')
    if target not in objects_by_id:
        raise ref.error(f'<ref id="{target}"> refers to nothing in this file{suggest(target, objects_by_id)}')
    return objects_by_id[target]


def _color(child: Element) -> F8:
    text = child.attributes["value"].strip()
    if child.tag == "rgb" and text.startswith("#"):
        match = _HEX.fullmatch(text)
        if match is None:
            raise child.error(f'"{text}" is not a colour; write #rrggbb or one or three numbers')
        encoded = np.array([int(match[i], 16) / 255.0 for i in (1, 2, 3)])
        # Hexadecimal colours are sRGB-encoded wherever they are used; reflectance is linear.
        return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    if child.tag == "spectrum" and ":" in text:
        raise child.error("wavelength:value pairs are not supported; give one number, or <rgb> with three")
    values = numbers(child, text)
    counts = (1, 3) if child.tag == "rgb" else (1,)
    if len(values) not in counts:
        raise child.error(f"{len(values)} numbers for <{child.tag}>; give {' or '.join(map(str, counts))}")
    return np.array(values * 3 if len(values) == 1 else values, dtype=np.float64)


def _show(color: F8) -> str:
    return " ".join(f"{value:g}" for value in color)
