"""A scene file as a tree of elements that remember their line, with every $name replaced.

Reads the XML dialect of Mitsuba 3. Document types, and with them entities, are refused: a scene needs none,
and they let a small file expand without bound or read other files.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from xml.parsers import expat

from joulebox_render.errors import SceneError

_MAX_DEPTH = 64
_MAX_BYTES = 64 * 1024 * 1024
_NAME = re.compile(r"\$([A-Za-z_]\w*)")

OBJECT_TAGS = ("bsdf", "emitter", "film", "integrator", "rfilter", "sampler", "sensor", "shape")
VALUE_TAGS = ("boolean", "float", "integer", "point", "rgb", "spectrum", "string", "transform", "vector")
_REFUSED_TAGS = {
    "include": "a scene is one file, so put the elements here instead of <include>",
    "path": "files are read from the scene's folder only, so remove <path>",
    "alias": "<alias> is not supported; give the object one id and refer to that",
    "texture": "textures are not supported; give one colour with <rgb>",
    "medium": "participating media are not supported; remove <medium>",
    "phase": "participating media are not supported; remove <phase>",
    "volume": "participating media are not supported; remove <volume>",
}


@dataclass
class Element:
    """One XML element; `attributes` have their $names replaced once `resolve_defines` has run."""

    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    children: list[Element] = field(default_factory=list)

    @property
    def type(self) -> str:
        """The plugin asked for, such as "rectangle"; refused when missing."""
        if not self.attributes.get("type"):
            raise self.error(f'<{self.tag}> has no type; write <{self.tag} type="...">')
        return self.attributes["type"]

    def error(self, sentence: str) -> SceneError:
        """The error to raise about this element: file, line, and the sentence."""
        return SceneError(f"{self.file}, line {self.line}: {sentence}")

    def walk(self) -> Iterator[Element]:
        """This element and all below it, in document order."""
        yield self
        for child in self.children:
            yield from child.walk()

    def allow_attributes(self, *known: str) -> None:
        """Refuse attributes other than `known`, which would otherwise be silently without effect."""
        for name in self.attributes:
            if name not in known:
                raise self.error(f'<{self.tag}> has no attribute "{name}"{suggest(name, known)}')


def suggest(name: str, known: Iterable[str]) -> str:
    """End of an error sentence: the nearest known name if any is near, and all of them."""
    names = sorted(set(known))
    if not names:
        return "; none is known here"
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    return (f"; did you mean {near[0]}?" if near else ";") + f" known: {', '.join(names)}"


def parse_xml(data: bytes, file: str) -> Element:
    """The root element of a scene file.

    data    the file's bytes;  file  its name for messages
    Raises SceneError for malformed XML, document types, unknown elements, text between them, deep nesting.
    """
    if len(data) > _MAX_BYTES:
        raise SceneError(f"{file}: the file has {len(data)} bytes; a scene file may have {_MAX_BYTES}")
    try:
        root = _build(data, file)
    except expat.ExpatError as error:
        raise SceneError(
            f"{file}, line {error.lineno}: not well-formed XML ({expat.ErrorString(error.code)}, "
            f"column {error.offset + 1})"
        ) from None
    except (LookupError, ValueError):
        raise SceneError(f"{file}: the XML declares an unknown encoding; use UTF-8") from None
    _check_root(root)
    return root


def _build(data: bytes, file: str) -> Element:
    parser = expat.ParserCreate()
    document = Element("", {}, file, 1)
    open_elements = [document]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, file, parser.CurrentLineNumber)
        if len(open_elements) > _MAX_DEPTH:
            raise element.error(f"elements are nested deeper than {_MAX_DEPTH}")
        if len(open_elements) > 1:
            _check_tag(element)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def text(characters: str) -> None:
        if characters.strip():
            raise SceneError(
                f"{file}, line {parser.CurrentLineNumber}: text between elements "
                f'("{characters.strip()[:40]}"); values belong into value="..."'
            )

    def refuse_doctype(*_: object) -> None:
        raise SceneError(f"{file}, line {parser.CurrentLineNumber}: <!DOCTYPE> and entities are refused; remove them")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _tag: open_elements.pop()
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.Parse(data, True)
    return document.children[0]


def _check_root(root: Element) -> None:
    if root.tag != "scene":
        raise root.error(f'the outermost element is <{root.tag}>; a Mitsuba scene is <scene version="3.0.0">')
    version = root.attributes.get("version", "")
    if not re.fullmatch(r"[23]\.\d+(\.\d+)?", version):
        found = f'version="{version}"' if version else "no version"
        raise root.error(f'<scene> has {found}; this reads Mitsuba 3 scenes, version="3.0.0"')
    root.allow_attributes("version")


def _check_tag(element: Element) -> None:
    transforms = ("look_at", "lookat", "matrix", "rotate", "scale", "translate")
    if element.tag in _REFUSED_TAGS:
        raise element.error(_REFUSED_TAGS[element.tag])
    known = (*OBJECT_TAGS, *VALUE_TAGS, *transforms, "default", "ref")
    if element.tag not in known:
        raise element.error(f"unknown element <{element.tag}>{suggest(element.tag, known)}")


def resolve_defines(root: Element, defines: Mapping[str, str]) -> dict[str, str]:
    """Replace $name in every attribute, in document order; overwrites the attributes of the tree.

    defines   what -D gave; it wins over <default>.
    Returns the value of every name, defaults included. Raises SceneError for a $name without a value, and for
    a define that nothing in the file uses.
    """
    values = dict(defines)
    used: set[str] = set()
    declared: set[str] = set()

    def replace(element: Element, text: str) -> str:
        def value(match: re.Match[str]) -> str:
            name = match[1]
            if name not in values:
                raise element.error(
                    f'${name} has no value; add <default name="{name}" value="..."/> above it, or give -D {name}=...'
                )
            used.add(name)
            return values[name]

        return _NAME.sub(value, text)

    for element in root.walk():
        for name, text in element.attributes.items():
            if "$" in text:
                element.attributes[name] = replace(element, text)
        if element.tag == "default":
            declared.add(_declare(element, values))
    unused = sorted(set(defines) - used)
    if unused:
        known = sorted(used | declared)
        raise SceneError(
            f"{root.file}: -D {unused[0]}={defines[unused[0]]} changes nothing, the scene uses no "
            f"${unused[0]}{suggest(unused[0], known) if known else '; it has no <default> at all'}"
        )
    return values


def _declare(element: Element, values: dict[str, str]) -> str:
    element.allow_attributes("name", "value")
    name, value = element.attributes.get("name"), element.attributes.get("value")
    if not name or value is None:
        raise element.error('<default> needs a name and a value: <default name="..." value="..."/>')
    values.setdefault(name, value)
    return name
