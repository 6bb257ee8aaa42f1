"""A page made of blocks, in the style of the report: for every result that is not a comparison of runs."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from jinja2 import Environment, PackageLoader, StrictUndefined

Tone = Literal["", "good", "bad", "warn"]


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; ``tone`` "note" is small print, "warn" a coloured call."""

    body: str
    tone: Literal["", "note", "warn"] = ""
    kind: Literal["text"] = "text"


@dataclass(frozen=True, slots=True)
class Bullets:
    """A list of sentences."""

    items: Sequence[str]
    kind: Literal["bullets"] = "bullets"


@dataclass(frozen=True, slots=True)
class Column:
    """A heading; ``number`` aligns to the right, ``tip`` explains."""

    label: str
    unit: str = ""
    number: bool = False
    tip: str = ""


@dataclass(frozen=True, slots=True)
class Cell:
    """A table's cell: what is read, what it sorts by (None: by the text), its colour, a hint and where it leads."""

    text: str
    sort: float | str | None = None
    tone: Tone = ""
    tip: str = ""
    link: str = ""

    def __post_init__(self) -> None:
        if self.link and not self.link.startswith(("#", "https://", "http://")):
            raise ValueError(f"link: expected a place on the page or a web address, got {self.link!r}")


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts and cells, the first of each its heading; a row must be as long as ``columns``."""

    columns: Sequence[Column | str]
    rows: Sequence[Sequence[Cell | str]]
    caption: str = ""
    sortable: bool = True
    kind: Literal["table"] = "table"

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ValueError(f"table row {number}: expected {len(self.columns)} cells, got {len(row)}")

    def headings(self) -> list[Column]:
        """Every column in full."""
        return [column if isinstance(column, Column) else Column(column) for column in self.columns]

    def cells(self) -> list[list[Cell]]:
        """Every cell in full."""
        return [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in self.rows]


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing with what it shows (for those who cannot see it too) and how to read it."""

    svg: bytes
    title: str
    caption: str = ""
    media: Literal["svg+xml", "png"] = "svg+xml"
    kind: Literal["figure"] = "figure"

    @property
    def uri(self) -> str:
        """The drawing within the page."""
        return f"data:image/{self.media};base64,{b64encode(self.svg).decode()}"


@dataclass(frozen=True, slots=True)
class Figures:
    """Drawings side by side as the window allows; ``small`` fits more of them."""

    figures: Sequence[Figure]
    small: bool = False
    kind: Literal["figures"] = "figures"


@dataclass(frozen=True, slots=True)
class Command:
    """A line to be typed."""

    text: str
    kind: Literal["command"] = "command"


@dataclass(frozen=True, slots=True)
class Fold:
    """Blocks that are folded away until somebody asks."""

    title: str
    blocks: Sequence[Block]
    kind: Literal["fold"] = "fold"


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading within a section."""

    text: str
    kind: Literal["heading"] = "heading"

    @property
    def anchor(self) -> str:
        """What a link ends in."""
        return slug(self.text)


Block = Text | Bullets | Table | Figure | Figures | Command | Fold | Heading


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page that the bar at its top leads to."""

    title: str
    blocks: Sequence[Block]
    anchor: str = ""

    @property
    def target(self) -> str:
        """What a link to this section ends in."""
        return self.anchor or slug(self.title)


@dataclass(frozen=True, slots=True)
class Document:
    """A whole page: ``facts`` are pairs of name and text below the title."""

    kicker: str
    title: str
    lead: str
    sections: Sequence[Section]
    facts: Sequence[tuple[str, str]] = field(default=())


def render(document: Document) -> str:
    """The HTML of a page that needs nothing else: no network, no other file."""
    environment = Environment(
        loader=PackageLoader("evalkit.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("document.html.j2").render(document=document)


def slug(title: str) -> str:
    """A title as the end of a link: lower case, hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"
