"""Pages made of blocks: paragraphs, lists, tables, figures, folds. Every page of evalkit uses them and one template."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

Tone = Literal["", "good", "bad", "warn"]


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; ``tone`` "note": small print, "warn": highlighted."""

    body: str
    tone: Literal["", "note", "warn"] = ""
    kind: Literal["text"] = "text"


@dataclass(frozen=True, slots=True)
class Bullets:
    """A bullet list."""

    items: Sequence[str]
    kind: Literal["bullets"] = "bullets"


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; ``number``: aligned to the right; ``tip``: explanation on hover."""

    label: str
    unit: str = ""
    number: bool = False
    tip: str = ""


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table: text, sort key (None: the text), colour, explanation on hover, and link.

    Raises ValueError for a link other than an anchor of the page or a web address.
    """

    text: str
    sort: float | str | None = None
    tone: Tone = ""
    tip: str = ""
    link: str = ""

    def __post_init__(self) -> None:
        if self.link and not self.link.startswith(("#", "https://", "http://")):
            raise ValueError(f"link: expected an anchor or a web address, got {self.link!r}")


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts and cells; the first cell of a row is its heading. Raises ValueError for a row of wrong length."""

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
        """Return every column as ``Column``."""
        return [column if isinstance(column, Column) else Column(column) for column in self.columns]

    def cells(self) -> list[list[Cell]]:
        """Return every cell as ``Cell``."""
        return [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in self.rows]


@dataclass(frozen=True, slots=True)
class Figure:
    """An image with its title (also the alternative text) and its caption; ``svg``: the file, of type ``media``."""

    svg: bytes
    title: str
    caption: str = ""
    media: Literal["svg+xml", "png"] = "svg+xml"
    kind: Literal["figure"] = "figure"

    @property
    def uri(self) -> str:
        """The image as a data URI."""
        return f"data:image/{self.media};base64,{b64encode(self.svg).decode()}"


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures side by side; ``small``: more of them in a row."""

    figures: Sequence[Figure]
    small: bool = False
    kind: Literal["figures"] = "figures"


@dataclass(frozen=True, slots=True)
class Command:
    """A command line."""

    text: str
    kind: Literal["command"] = "command"


@dataclass(frozen=True, slots=True)
class Fold:
    """Blocks that are hidden until the reader opens them."""

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
        """The anchor of the heading."""
        return slug(self.text)


Block = Text | Bullets | Table | Figure | Figures | Command | Fold | Heading


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the page, with a link in the navigation bar."""

    title: str
    blocks: Sequence[Block]
    anchor: str = ""

    @property
    def target(self) -> str:
        """The anchor of the section."""
        return self.anchor or slug(self.title)


@dataclass(frozen=True, slots=True)
class Document:
    """A page; ``facts``: pairs of name and text below the title."""

    kicker: str
    title: str
    lead: str
    sections: Sequence[Section]
    facts: Sequence[tuple[str, str]] = field(default=())


@dataclass(frozen=True, slots=True)
class NavigationLink:
    """A link in the navigation bar; ``minor``: less prominent."""

    target: str
    title: str
    minor: bool = False


def render(document: Document) -> str:
    """Return the HTML of a page as one file that loads nothing else."""
    links = [NavigationLink(section.target, section.title) for section in document.sections]
    return load_template("base.html.j2").render(document=document, links=links)


def load_template(name: str, **filters: Callable[..., str]) -> Template:
    """Load a template of this package; it escapes every text."""
    environment = Environment(
        loader=PackageLoader("evalkit.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(filters)
    return environment.get_template(name)


def slug(title: str) -> str:
    """Return a title as an anchor: lower case, hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"
