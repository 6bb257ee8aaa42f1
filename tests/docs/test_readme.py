"""The README names only existing back ends, data sets, commands, options and targets, and a valid experiment."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.config.experiment_file import experiment_from_tables, load_experiment
from evalkit.plugins import registry

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = [line.strip() for line in README.splitlines() if line.startswith("    evalkit ")]


def test_the_table_of_methods_lists_exactly_the_registered_back_ends():
    table = README.split("| back end |")[1].split("\n\n")[0]
    assert set(re.findall(r"`([\w-]+)`", table)) - {"make paper"} == set(registry.names("backends"))


def test_every_data_set_is_in_the_readme():
    readers = {name for name in registry.names("datasets") if registry.dataset(name).suffixes}
    line = README.split("Synthetic worlds:")[1].split("`evalkit datasets list`")[0]
    assert set(re.findall(r"`([\w-]+)`", line)) == set(registry.names("datasets")) - readers


def test_the_experiment_of_the_readme_is_valid():
    content = tomllib.loads(README.split("```toml\n")[1].split("```")[0])
    plan = experiment_from_tables(content, "README.md", "readme", "compare my.toml")
    assert [method.label for method in plan.methods] == ["wheel-odometry", "paper, 1e-5"]
    assert plan.methods[1].parameters["keyframes"] == 20
    assert len(list(plan.runs())) == 6


@pytest.mark.checkout
@pytest.mark.parametrize("page", ["README.md", "docs/pages/index.md", "docs/pages/tutorial.md"])
def test_a_reader_learns_how_evalkit_gets_on_the_path_before_the_first_command(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    first = re.search(r"^(    |\$ )evalkit (?!compare drive\.bag$)", text, re.MULTILINE)  # that picture explains, once
    assert first is not None
    assert ". .venv/bin/activate" in text[: first.start()]


def find_links(page):
    """Return the targets of a page's links to files, relative to it, with those out of other files."""
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
    return {link for link in links if "://" not in link}


@pytest.mark.checkout
def test_the_readme_links_the_pages_and_says_which_links_are_dead_in_a_clone():
    pages = ROOT / "docs" / "pages"
    links = find_links(ROOT / "README.md")
    assert {f"docs/pages/{name}.md" for name in ("index", "tutorial", "recording", "which-matcher")} <= links
    assert [link for link in links if not (ROOT / link).exists()] == []
    dead = {link for page in pages.glob("*.md") for link in find_links(page) if not (pages / link).exists()}
    said = set(re.findall(r"`(\w+/)`", README.split("links to ")[1].split(" are dead")[0].replace("\n", " ")))
    assert {f"{link.split('/')[0]}/" for link in dead} == said


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_and_option_of_the_readme_exists(line):
    words = shlex.split(line, comments=True)[1:]
    path = words[:2] if words[0] == "datasets" else words[:1]
    answer = CliRunner().invoke(app, [*path, "--help"], env={"COLUMNS": "200"})
    assert answer.exit_code == 0
    assert all(option in answer.output for option in re.findall(r"(?<!\S)--?[a-z-]+", line))


def test_every_command_is_in_the_readme():
    shown = {line.split()[1] for line in COMMANDS}
    assert shown == set(app_commands())


def app_commands():
    """Return the names of all commands in the help."""
    return re.findall(r"^│ ([a-z]+) ", CliRunner().invoke(app, ["--help"]).output, re.MULTILINE)


@pytest.mark.checkout
@pytest.mark.parametrize("target", sorted(set(re.findall(r"make ([a-z-]+)", README))))
def test_every_make_target_of_the_readme_exists(target):
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.checkout
def test_the_picture_of_the_readme_exists_and_is_small():
    (picture,) = re.findall(r"!\[[^]]+\]\(([^)]+\.png)\)", README)
    assert (ROOT / picture).stat().st_size < 200_000


def test_the_shipped_experiments_are_valid():
    for name in ("default", "quick"):
        plan = load_experiment(ROOT / "reports" / f"{name}.toml")
        assert "wheel-odometry" in [method.label for method in plan.methods]
        assert not any(sequence.label == "" for sequence in plan.sequences)


def anchors(text):
    """Return the anchors of the headings of a Markdown text: as GitHub makes them."""
    titles = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", title) for title in re.findall(r"^#+ (.+)$", text, re.MULTILINE)]
    return {re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", title.lower()).strip()) for title in titles}


@pytest.mark.checkout
@pytest.mark.parametrize("folder", [".", "baselines", "baselines/evalkit_baselines/embedded", "datasets"])
def test_every_link_of_a_page_beside_the_code_leads_to_a_file_and_a_heading(folder):
    """MkDocs checks those of the site."""
    for page in (ROOT / folder).glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for path, anchor in re.findall(r"\]\((?!\w+:)([^)#\s]*)#?([^)\s]*)\)", text):
            target = (page.parent / path).resolve() if path else page
            assert target.exists(), f"{page.name}: {path}"
            assert not anchor or anchor in anchors(target.read_text(encoding="utf-8")), f"{page.name}: {path}#{anchor}"


def test_an_anchor_is_the_heading_in_small_letters_with_dashes():
    assert anchors("# Rules: a `scan`, 2 m\n\ntext\n\n## [Linked](page.md) title") == {
        "rules-a-scan-2-m",
        "linked-title",
    }
