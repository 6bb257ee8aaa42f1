"""Pages made of blocks: paragraphs, lists, tables, figures, folds. Every page of evalkit uses them and one template."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from evalkit.report.html.method_colours import Stroke

Tone = Literal["", "good", "bad", "warn", "tied"]
Chips = Sequence[tuple[str, Tone]]
"""Words with a background and their tone."""


_HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufff9-\ufffb\ufffe\uffff]"
)
"""Control characters without tab and line feed, changes of the reading direction, and what no file can hold."""


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
    """A column of a table; ``number``: aligned to the right; ``tip``: explanation on hover.

    ``better``: the direction of better values, for the arrow and the first click. ``of``: the method of the column.
    """

    label: str
    unit: str = ""
    number: bool = False
    tip: str = ""
    better: Literal["lower", "higher", ""] = ""
    of: str = ""


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table: text, sort key (None: the text), colour, explanation on hover, and link.

    ``extent``: small print below the text. ``stroke``: the text is the label of a method, drawn with this stroke.
    ``chips``: words with a background after the text. Raises ValueError for a link other than an anchor of the page, a
    file beside it or a web address.
    """

    text: str
    sort: float | str | None = None
    tone: Tone = ""
    tip: str = ""
    link: str = ""
    extent: str = ""
    stroke: Stroke | None = None
    chips: Chips = ()

    def __post_init__(self) -> None:
        if self.link and not self.link.startswith(("#", "https://", "http://", "trajectories/", "maps/")):
            raise ValueError(f"link: expected an anchor or a web address, got {self.link!r}")


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts and cells; the first cell of a row is its heading.

    ``anchors``: one per row, "" for none. ``label``: name of the table for a screen reader, without a caption.
    Raises ValueError for a row of wrong length.
    """

    columns: Sequence[Column | str]
    rows: Sequence[Sequence[Cell | str]]
    caption: str = ""
    sortable: bool = True
    anchors: Sequence[str] = ()
    label: str = ""
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
    """An image with its title (also the alternative text) and its caption; ``svg``: the file, of type ``media``.

    ``size``: width and height in pixels, so that nothing moves when it is shown. ``stroke``: the title is the label of
    a method. ``scale``: length and label of a scale bar, in percent of the width.
    """

    svg: bytes
    title: str
    caption: str = ""
    media: Literal["svg+xml", "png"] = "svg+xml"
    size: tuple[int, int] | None = None
    alt: str = ""
    stroke: Stroke | None = None
    scale: tuple[float, str] | None = None
    kind: Literal["figure"] = "figure"

    @property
    def uri(self) -> str:
        """The image as a data URI."""
        return f"data:image/{self.media};base64,{b64encode(self.svg).decode()}"


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures side by side; ``small``: more of them in a row; ``maps``: small, and the player shows them too."""

    figures: Sequence[Figure]
    small: bool = False
    maps: bool = False
    kind: Literal["figures"] = "figures"


@dataclass(frozen=True, slots=True)
class Command:
    """A command line, or several lines that are copied as one block."""

    text: str
    kind: Literal["command"] = "command"


@dataclass(frozen=True, slots=True)
class Fold:
    """Blocks that are hidden until the reader opens them.

    ``heading``: the title is a heading of the page. ``lazy``: the blocks are built when opened. ``note``: small print
    beside the title.
    """

    title: str
    blocks: Sequence[Block]
    anchor: str = ""
    note: str = ""
    heading: bool = False
    lazy: bool = False
    is_open: bool = False
    kind: Literal["fold"] = "fold"


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading within a section; ``target``: its anchor, else from the text; ``level`` 3 or 4."""

    text: str
    target: str = ""
    level: Literal[3, 4] = 3
    kind: Literal["heading"] = "heading"

    @property
    def anchor(self) -> str:
        """The anchor of the heading."""
        return self.target or slug(self.text)


@dataclass(frozen=True, slots=True)
class Facts:
    """Pairs of name and text, one below the other; web addresses become links."""

    pairs: Sequence[tuple[str, str]]
    kind: Literal["facts"] = "facts"


@dataclass(frozen=True, slots=True)
class Card:
    """Blocks with a border and a title; ``stroke``: the title is the label of a method."""

    title: str
    blocks: Sequence[Block]
    anchor: str = ""
    stroke: Stroke | None = None
    chips: Chips = ()


@dataclass(frozen=True, slots=True)
class Cards:
    """Cards side by side; ``wide``: fewer of them in a row; ``level`` of their headings."""

    cards: Sequence[Card]
    wide: bool = False
    level: Literal[3, 4] = 4
    kind: Literal["cards"] = "cards"


@dataclass(frozen=True, slots=True)
class Html:
    """Markup that is already escaped."""

    markup: Markup
    kind: Literal["html"] = "html"


Block = Text | Bullets | Table | Figure | Figures | Command | Fold | Heading | Facts | Cards | Html


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


def render(document: Document) -> str:
    """Return the HTML of a page as one file that loads nothing else."""
    return load_template("base.html.j2").render(document=document)


def load_template(name: str, **filters: Callable[..., str]) -> Template:
    """Load a template of this package; it escapes every text, and shows characters that would not be seen."""
    environment = Environment(
        loader=PackageLoader("evalkit.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_show_hidden,
    )
    environment.filters.update(filters)
    return environment.get_template(name)


def _show_hidden(value: Any) -> Any:
    r"""Return a value; in a text, control characters and changes of the reading direction as ``\u202e``.

    So written, they mean the same in HTML, JSON and JavaScript, and damage none of them.
    """
    if not isinstance(value, str) or not _HIDDEN.search(value):
        return value
    shown = _HIDDEN.sub(lambda found: f"\\u{ord(found[0]):04x}", value)
    return Markup(shown) if isinstance(value, Markup) else shown


def slug(title: str) -> str:
    """Return a title as an anchor: lower case, hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"
