"""The documentation is correct: every command runs and prints the shown output, every file and link exists."""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from ruamel.yaml import YAML

site = pytest.importorskip("evalkit_docs.site", reason="the documentation is not part of a wheel")

from evalkit import cli  # noqa: E402 - as above
from evalkit.metrics import all_metrics  # noqa: E402 - as above
from evalkit.plugins import registry  # noqa: E402 - only where there is a documentation
from evalkit_docs import blocks as code  # noqa: E402 - as above
from evalkit_docs import command_reference, example  # noqa: E402 - as above

AFTER = re.compile(r"\A---\n.*?^after: (\S+)$.*?^---$", re.DOTALL | re.MULTILINE)
NEEDS = re.compile(r"\A---\n.*?^needs: (.+?)$.*?^---$", re.DOTALL | re.MULTILINE)
ELSEWHERE = re.compile(r"\A---\n.*?^tested-by: (\S+)$.*?^---$", re.DOTALL | re.MULTILINE)
SLOW_PAGES = frozenset(
    f"{name}.md"
    for name in ("back-end", "basins", "board", "c-port", "cluster", "diff", "experiment", "exports", "lidar-3d",
                 "paper", "paper-table", "python", "real-recording", "realtime", "recording", "slam", "slam-results",
                 "studies", "text-log", "tutorial", "validate")
)  # fmt: skip
"""Pages whose commands take 4 s to 25 s of CPU time: followed in the thorough run."""

WRITTEN = {path.relative_to(site.PAGES).as_posix(): path for path in sorted(site.PAGES.rglob("*.md"))}


def blocks(name):
    """Return the code blocks of a page, in order, including those from other files."""
    return code.find_blocks(site.include_blocks(WRITTEN[name].read_text(encoding="utf-8")))


def consoles(name):
    """Return the console blocks of a page."""
    return [block for block in blocks(name) if block.language == code.CONSOLE]


def pattern(answer):
    """Return a pattern of printed output: "..." matches anything within a line, and any lines if alone on a line."""
    return "".join(map(line_pattern, answer.splitlines()))


def line_pattern(line):
    """Return a pattern of one line with its end; trailing spaces do not count."""
    if line.strip() == "...":
        return r"(?:[^\n]*\n)*?"
    return re.escape(line.rstrip()).replace(r"\.\.\.", r"[^\n]*?") + r"[^\n\S]*\n"


def environment():
    """Return a user's environment: evalkit in the path, a terminal of 100 columns, no recorded data."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    kept = {name: value for name, value in os.environ.items() if name != "EVALKIT_DATA"}
    return {**kept, "PATH": path, "COLUMNS": "100"}


def follow(name, folder):
    """Follow a page in a folder: write its files, run its commands, compare their output. Long steps are skipped
    unless EVALKIT_DOCUMENTATION_LONG is set, as in continuous integration.
    """
    for block in blocks(name):
        if block.long and "EVALKIT_DOCUMENTATION_LONG" not in os.environ:
            continue
        if block.title:
            (folder / block.title).write_text(block.content, encoding="utf-8")
        elif block.language == "python":
            subprocess.run([sys.executable, "-c", block.content], cwd=folder, check=True)
        for command, answer in code.find_commands(block.content) if block.language == code.CONSOLE else ():
            ended = subprocess.run(
                ["bash", "-c", command], cwd=folder, env=environment(), capture_output=True, text=True, check=False
            )
            assert ended.returncode == 0, f"{name}: $ {command}\n{ended.stdout}{ended.stderr}"
            if answer and not re.fullmatch(pattern(answer), ended.stdout.rstrip("\n") + "\n"):
                pytest.fail(f"{name}: $ {command}\nprinted:\n{answer}\n\nanswered:\n{ended.stdout}")


def missing(need):
    """Return why a back end or program of a page is missing, or ""."""
    if need in registry.names("backends"):
        return registry.backend(need).missing()
    return "" if shutil.which(need, path=environment()["PATH"]) else f"no {need} on this machine"


@pytest.fixture(scope="module")
def follow_page(tmp_path_factory):
    """Return ``followed(page)``: the folder that a page leaves, followed once."""
    folders = {}

    def folder_of(name):
        if name not in folders:
            folder = tmp_path_factory.mktemp(Path(name).stem)
            head = site.PAGES.joinpath(name).read_text(encoding="utf-8")
            if before := AFTER.match(head):
                shutil.copytree(folder_of(before[1]), folder, dirs_exist_ok=True)
            for need in (NEEDS.match(head) or ["", ""])[1].split():
                if why := missing(need):
                    pytest.skip(why)
            follow(name, folder)
            folders[name] = folder
        return folders[name]

    return folder_of


@pytest.mark.slow(60)
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.thorough] * (name in SLOW_PAGES)) for name in filter(consoles, WRITTEN)],
)
def test_every_command_of_the_page_runs_and_prints_the_shown_output(follow_page, name):
    if own := ELSEWHERE.match(WRITTEN[name].read_text(encoding="utf-8")):
        assert Path(__file__).with_name(own[1]).exists()  # which follows the page
    else:
        follow_page(name)


@pytest.mark.parametrize("name", WRITTEN)
def test_every_code_block_parses(name):
    for block in blocks(name):
        if block.language == "toml":
            tomllib.loads(block.content)
        elif block.language == "python":
            ast.parse(block.content)
        elif block.language == "yaml":
            assert YAML(typ="safe").load(block.content)
        elif block.language == "sh":  # needs docker, so that only its syntax is checked
            assert all(line.startswith("docker ") for line in block.content.splitlines())
            subprocess.run(["bash", "-n", "-c", block.content], check=True)
        else:
            assert block.language == code.CONSOLE, f"{name}: who runs a block of {block.language}?"
            assert block.content.startswith("$ "), f"{name}: {block.content}"


def test_the_example_runs_the_commands_of_the_tutorial():
    typed = [command for block in consoles("tutorial.md") for command, _ in code.find_commands(block.content)]
    assert {f"evalkit {' '.join(words)}" for words in example.COMMANDS} <= set(typed)


def test_every_command_of_the_program_is_on_a_page_and_every_command_on_a_page_exists():
    known = set(command_reference.load_functions())
    text = "\n".join(path.read_text(encoding="utf-8") for path in WRITTEN.values())
    shown = {match[1] for match in re.finditer(r"\bevalkit ([a-z]+(?: [a-z]+)?)\b", text)}
    assert {name for name in known if not any(f"{one} ".startswith(f"{name} ") for one in shown)} == set()
    for command in re.findall(r"^\$ evalkit ([^\n]*)", text, re.MULTILINE):
        words = command.split()
        assert words[0].startswith("-") or words[0] in known or " ".join(words[:2]) in known, command


@pytest.mark.parametrize("name", list(filter(consoles, WRITTEN)))
def test_every_command_of_evalkit_on_the_page_is_understood(name, tmp_path, monkeypatch):
    """Its options, their values and its arguments: parsed as the program does, without running the command."""
    monkeypatch.chdir(tmp_path)
    for block in consoles(name):
        for command, _ in code.find_commands(block.content):
            for words in evalkit_words(command):
                if not words[0].startswith("-"):
                    parse(cli.load_command(words[0]), words)


def parse(command, words):
    """Parse the words of a command without running it; raises where the program would refuse them."""
    command.make_context(words[0], words[1:])
    if hasattr(command, "commands"):
        parse(command.commands[words[1]], words[1:])


@pytest.mark.parametrize(
    ("command", "why"),
    [
        ("cd x && evalkit compare drive --outt results", "No such option: --outt"),
        ("evalkit datasets exampel drive", "exampel"),
        ("evalkit compare drive --jobs many | cat", "not a valid int"),
    ],
)
def test_a_command_that_the_program_refuses_is_found(command, why):
    (words,) = evalkit_words(command)
    with pytest.raises(Exception, match="(?i)" + re.escape(why)):
        parse(cli.load_command(words[0]), words)


def evalkit_words(command):
    """Return the words after each "evalkit" of a shell command."""
    words = shlex.shlex(command.replace("\\\n", " "), posix=True, punctuation_chars=True)
    words.whitespace_split = True
    found, own = [], None
    for word in words:
        if set(word) <= set("();<>|&"):
            own = None
        elif own is not None:
            own.append(word)
        elif word == "evalkit":
            found.append(own := [])
    return [words for words in found if words]


def test_options_on_written_pages_exist():
    known = {
        name: " ".join(one.written for one in command_reference.find_options(function))
        for name, function in command_reference.load_functions().items()
    }
    for page, path in WRITTEN.items():
        for command in re.findall(r"\bevalkit ([a-z]+(?: [a-z]+)?\b[^\n`|]*)", path.read_text(encoding="utf-8")):
            words = command.split()
            name = " ".join(words[:2]) if " ".join(words[:2]) in known else words[0]
            for option in re.findall(r"(?<!\S)--[a-z-]+", command) if name in known else ():
                assert option in known[name] or option in ("--help", "--version"), f"{page}: evalkit {command}"


def test_the_reference_pages_are_complete():
    made = {name: write() for name, write in site.GENERATED.items()}
    for metric in all_metrics():
        assert f"{{ #{metric.name} }}" in made["reference/metrics.md"]
    for kind, page in (("backends", "back-ends"), ("datasets", "data-sets")):
        for name in registry.names(kind):
            assert f"{{ #{name} }}" in made[f"reference/{page}.md"]
    compare = made["reference/commands.md"].split("{ #compare }")[1].split("\n## ")[0]
    assert "<code>--ground-truth</code></td><td>a path</td><td></td><td>Ground-truth trajectory (TUM).</td>" in compare
    assert "<code>SOURCE</code></td><td>a path</td><td>required</td>" in compare
    assert "<code>--out, -o</code></td><td>a path</td><td>./evalkit-results</td>" in compare
    assert "<code>--json</code></td><td></td><td></td>" in compare


def test_a_missing_block_is_named():
    with pytest.raises(LookupError, match=r"README.md: \d+ blocks of toml, asked for number 99"):
        site.include_blocks("<!-- block: README.md toml 99 -->")


@pytest.fixture(scope="module")
def built(follow_page, tmp_path_factory):
    """Build the site in strict mode, with the report of the tutorial."""
    pytest.importorskip("mkdocs", reason="mkdocs is not installed: pip install 'evalkit[docs]'")
    pytest.importorskip("material", reason="mkdocs-material is not installed: pip install 'evalkit[docs]'")
    folder = tmp_path_factory.mktemp("site").resolve()
    pytest.importorskip("mkdocstrings", reason="mkdocstrings is not installed: pip install 'evalkit[docs]'")
    words = ("--site", str(folder), "--example", str(follow_page("tutorial.md") / "results"))
    ended = subprocess.run(
        [sys.executable, "-m", "evalkit_docs.build", *words], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(site.PAGES.parent)},
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    return folder


def html(built):
    return [page for page in built.rglob("*.html") if "report" not in page.relative_to(built).parts]


@pytest.mark.thorough  # make docs builds the site, too
@pytest.mark.slow
def test_no_page_loads_anything_from_the_network(built):
    loading = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?(?:src|href)=\"?(?:https?:)?//")
    for page in html(built):
        assert not loading.findall(page.read_text("utf-8")), page
    for sheet in built.rglob("*.css"):
        assert not re.search(r"url\([\"']?(?:https?:)?//|@import", sheet.read_text("utf-8")), sheet


@pytest.mark.thorough  # make docs builds the site, too
@pytest.mark.slow
def test_every_internal_link_and_anchor_exists(built):
    anchors = {page: set(re.findall(r"\bid=\"?([^\s\">]+)", page.read_text("utf-8"))) for page in built.rglob("*.html")}
    for page in html(built):
        for link in re.findall(r"<a\b[^>]*?\bhref=\"([^\"]*)\"", page.read_text("utf-8")):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or page.name == "404.html":
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            assert target.exists(), f"{page.name}: {link}"
            assert not parts.fragment or unquote(parts.fragment) in anchors.get(target, ()), f"{page.name}: {link}"


@pytest.mark.thorough  # make docs builds the site, too
@pytest.mark.slow
def test_the_search_of_a_site_opened_from_disk_finds_a_metric_without_a_network(built, browser):
    asked_for = []
    page = browser.new_page()
    page.on("request", lambda request: asked_for.append(request.url))
    page.on("pageerror", lambda error: asked_for.append(f"error {error}"))
    page.goto((built / "index.html").as_uri())
    page.click("[data-md-component=search-query]")
    page.keyboard.type("wall_thickness")
    page.wait_for_selector(".md-search-result__item a[href*='reference/metrics.html']")
    page.close()
    assert [url for url in asked_for if not url.startswith(("file:", "data:", "about:"))] == []


def test_the_page_on_tuning_lists_every_method_that_was_tuned_and_on_what():
    written = site.GENERATED["reference/tuning.md"]()
    for name in registry.names("backends"):
        tuned = registry.backend(name).tuned_on
        assert (f"<td><code>{name}</code></td><td>{', '.join(tuned)}</td>" in written) == bool(tuned)
        assert (f"`{name}`" in written) == (not tuned)
    lasting = [line for line in written.splitlines() if "small-gicp lasting" in line]
    assert [line.count("fr079, intel") for line in lasting] == [1, 1]
    assert all("<code>local_map = voxels</code>" in line for line in lasting)
