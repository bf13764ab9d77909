"""What a report says, before it is a page: sections of words, facts, tables, charts and pictures.

Text is escaped where the page is made; only `markupsafe.Markup` passes as HTML.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

Tone = Literal["plain", "lede", "notice", "error"]


@dataclass(frozen=True)
class Words:
    """A paragraph."""

    text: str
    tone: Tone = "plain"
    kind: ClassVar[str] = "words"


@dataclass(frozen=True)
class Points:
    """A list of sentences."""

    sentences: Sequence[str]
    kind: ClassVar[str] = "points"


@dataclass(frozen=True)
class Facts:
    """Names with their values, in words."""

    rows: Sequence[tuple[str, str]]
    kind: ClassVar[str] = "facts"


@dataclass(frozen=True)
class Table:
    """A table. Cells that are numbers, or texts in the columns of `numeric`, stand at the right.

    numeric     places of the columns
    file        name of an attachment that holds all of it, linked below
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    numeric: frozenset[int] = frozenset()
    file: str | None = None
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Chart:
    """A Vega-Lite specification: drawn in the page, and as figures/NAME.svg and .png beside it.

    name    of the files: letters, digits and hyphens
    alt     what the chart shows, for who cannot see it
    """

    name: str
    spec: Mapping[str, Any]
    caption: str
    alt: str
    width: int = 800
    kind: ClassVar[str] = "chart"


@dataclass(frozen=True)
class Picture:
    """A rendered image, in the page and as figures/NAME.png beside it."""

    name: str
    png: bytes
    caption: str
    alt: str


@dataclass(frozen=True)
class Pictures:
    """Pictures side by side."""

    pictures: Sequence[Picture]
    kind: ClassVar[str] = "pictures"


@dataclass(frozen=True)
class Fold:
    """Blocks that are shown when asked for."""

    summary: str
    blocks: Sequence["Block"]
    kind: ClassVar[str] = "fold"


Block = Words | Points | Facts | Table | Chart | Pictures | Fold


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it, and sections below that one.

    anchor  of links within the page: letters, digits and hyphens, once in a report
    label   a word beside the heading, such as what joules rest on
    """

    heading: str
    anchor: str
    blocks: Sequence[Block] = ()
    sections: Sequence["Section"] = ()
    label: str = ""


@dataclass(frozen=True)
class Report:
    """A whole report.

    subtitle        one line below the title
    footer          how it was made
    attachments     name -> content of further files in the report's folder
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    footer: str = ""
    attachments: Mapping[str, bytes] = field(default_factory=dict)
