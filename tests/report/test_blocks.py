"""Pages built from blocks."""

from html.parser import HTMLParser

import pytest

from evalkit.report.html.blocks import (
    Bullets,
    Cell,
    Column,
    Command,
    Document,
    Figure,
    Figures,
    Fold,
    Heading,
    Section,
    Table,
    Text,
    render,
)

VOID = {"meta", "img", "br", "input", "link", "hr"}


class Tags(HTMLParser):
    """Parser that collects all elements and raises at an element closed in the wrong place."""

    def __init__(self):
        super().__init__()
        self.open, self.seen, self.text = [], [], ""

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def page(*blocks):
    tags = Tags()
    tags.feed(render(Document("evalkit", "Title", "Lead", (Section("One thing", blocks),), (("runs", "3"),))))
    assert tags.open == []
    return tags


def test_every_block_is_on_the_page():
    table = Table((Column("k", number=True), "why"), (("1", Cell("two", sort=2.0, tone="bad", link="#there")),), "Cap")
    figure = Figure(b"<svg/>", "Walls", "black")
    tags = page(
        Text("A sentence."), Bullets(("first", "second")), table, figure, Figures((figure, figure)),
        Command("evalkit list"), Fold("More", (Text("hidden"),)), Heading("Half way"),
    )  # fmt: skip
    for words in (
        "A sentence.",
        "first",
        "second",
        "two",
        "Cap",
        "Walls",
        "evalkit list",
        "More",
        "hidden",
        "Half way",
    ):
        assert words in tags.text
    assert ("a", {"href": "#there"}) in tags.seen
    assert sum(tag == "img" and "src" in attrs for tag, attrs in tags.seen) == 3
    assert any(attrs.get("id") == "one-thing" for _, attrs in tags.seen)


def test_data_is_escaped():
    evil = "<script>alert(1)</script>"
    tags = page(Text(evil), Table((evil,), ((Cell(evil, tip=evil),),), evil), Figure(b"", evil, evil), Command(evil))
    assert sum(tag == "script" for tag, _ in tags.seen) == 1
    assert tags.text.count(evil) == 7


def test_a_row_of_another_length_raises():
    with pytest.raises(ValueError, match="row 1: expected 2 cells, got 3"):
        Table(("a", "b"), (("1", "2"), ("1", "2", "3")))


@pytest.mark.parametrize("link", ["javascript:alert(1)", "data:text/html,x", " javascript:x", "//evil"])
def test_a_link_executes_nothing(link):
    with pytest.raises(ValueError, match="link: expected an anchor or a web address"):
        Cell("here", link=link)
