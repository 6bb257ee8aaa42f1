"""Digests of the code and the files behind a result."""

from __future__ import annotations

import ast
import hashlib
import json
import re
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple


def hash_code(modules: tuple[str, ...], libraries: tuple[str, ...]) -> str:
    """Return a digest of modules and library versions.

    It covers the sources of the modules and of all that they import within evalkit and their own packages.
    """
    roots = {"evalkit", *(module.partition(".")[0] for module in modules)}
    files = sorted({file for module in modules for file in find_sources(module, frozenset(roots))})
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    for library in libraries:
        digest.update(f"{library} {_version(library)}".encode())
    return digest.hexdigest()


def read_file_state(value: str) -> list[object]:
    """Return the text, and size and modification time of the file it names; for a folder, also of the files in it."""
    path = Path(value)
    try:
        if not path.exists():
            path = Path(value.partition("?")[0])  # an address such as run.bag?topic=/pose
        inside = sorted(path.iterdir()) if path.is_dir() else []
        states = [(file.name, file.stat()) for file in (path, *inside)]
    except (OSError, ValueError):  # a text that is not the path of a file
        return [value]
    return [value, *([name, state.st_size, state.st_mtime_ns] for name, state in states)]


def hash_files(parameters: Mapping[str, object]) -> str:
    """Return a digest of size and modification time of the files that parameters name, "" where they name none."""
    named = [read_file_state(value) for value in parameters.values() if isinstance(value, str) and value]
    known = [state for state in named if len(state) > 1]
    return hashlib.sha256(json.dumps(known).encode()).hexdigest() if known else ""


@cache
def find_sources(module: str, roots: frozenset[str]) -> frozenset[Path]:
    """Return the source files of a module and of all its direct and indirect imports within the packages ``roots``.

    The data of a module, a TOML file of the same name beside it, belong to its sources. Imports for a type checker do
    not run; they only tell where a package finds what ``from package import name`` imports on first use (PEP 562).
    """
    found: dict[str, Path] = {}
    on_first_use: dict[str, str] = {}
    waiting = deque([module])
    while waiting:
        name = waiting.popleft()
        if name in found or name.partition(".")[0] not in roots:
            continue
        if name in on_first_use:
            waiting.append(on_first_use[name])
        elif name.endswith(".*"):
            waiting.extend(source for known, source in on_first_use.items() if known.startswith(name[:-1]))
        elif (file := _file(name, found)) is not None:
            found[name] = file
            imports = _list_imports(name, file)
            waiting.extend(imports.names)
            on_first_use |= imports.on_first_use
    return frozenset([*found.values(), *filter(Path.is_file, (file.with_suffix(".toml") for file in found.values()))])


def _file(name: str, found: Mapping[str, Path]) -> Path | None:
    parent = found.get(name.rpartition(".")[0])
    if parent is not None and parent.name != "__init__.py":  # a name in a module: not searched, which would import it
        return None
    try:
        spec = find_spec(name)
    except ModuleNotFoundError:  # "package.name" where name is an attribute, not a module
        return None
    return Path(spec.origin) if spec is not None and spec.origin and spec.origin != "built-in" else None


class _Imports(NamedTuple):
    """What a source file imports anywhere.

    ``names``: modules, each before its names: "package.name" for a name imported from a package, "package.*" for a
    whole package. ``on_first_use``: the modules that its names for a type checker come from.
    """

    names: tuple[str, ...] = ()
    on_first_use: Mapping[str, str] = {}


TYPE_CHECKER_BLOCK = re.compile(
    rb"^([ \t]*)if (?:typing\.)?TYPE_CHECKING:[^\n]*\n(?:\1[ \t]+[^\n]*\n|[ \t]*\n)*", re.MULTILINE
)
IMPORT = re.compile(
    rb"^[ \t]*(import[ \t][^\n]+|from[ \t]+[\w.]+[ \t]+import[ \t]*(?:\([^)]*\)|[^\n(]+))", re.MULTILINE
)
IMPORT_INSIDE_A_LINE = re.compile(rb"^[^#\n]*[:;][ \t]*(?:import[ \t]|from[ \t]+[\w.]+[ \t]+import\b)", re.MULTILINE)


@cache
def _list_imports(name: str, file: Path) -> _Imports:
    if file.suffix != ".py":
        return _Imports()
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    names: list[str] = []
    on_first_use: dict[str, str] = {}
    for node, runs in _find_imports(file.read_bytes()):
        if isinstance(node, ast.Import) and runs:
            names += [text for alias in node.names for text in (alias.name, f"{alias.name}.*")]
        elif isinstance(node, ast.ImportFrom):
            parent = ".".join(package.split(".")[: len(package.split(".")) - node.level + 1]) if node.level else ""
            base = ".".join(part for part in (parent, node.module) if part)
            if runs:
                names += [base, *(f"{base}.{alias.name}" for alias in node.names)]
            else:
                on_first_use |= {f"{name}.{alias.asname or alias.name}": base for alias in node.names}
    return _Imports(tuple(names), on_first_use)


def _find_imports(source: bytes) -> list[tuple[ast.AST, bool]]:
    """Return the import statements of a source, with whether they run.

    Only the lines of imports are parsed, a tenth of the time of a whole source; the whole source where imports stand in
    unusual places. Lines of a text that look like an import are taken for one: more sources, never fewer.
    """
    if not IMPORT_INSIDE_A_LINE.search(source):
        blocks = b"".join(match[0] for match in TYPE_CHECKER_BLOCK.finditer(source))
        parts = (TYPE_CHECKER_BLOCK.sub(b"", source), True), (blocks, False)
        try:
            return [(node, runs) for part, runs in parts for node in ast.parse(b"\n".join(IMPORT.findall(part))).body]
        except SyntaxError:
            pass
    return list(_statements(ast.parse(source).body, True))


def _statements(nodes: Iterable[ast.AST], runs: bool) -> Iterator[tuple[ast.AST, bool]]:
    """Yield all statements, those inside others too, and whether they run: not those for a type checker."""
    for node in nodes:
        yield node, runs
        typing_only = isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        yield from _statements(getattr(node, "body", ()), runs and not typing_only)
        for part in ("orelse", "finalbody", "handlers", "cases"):
            yield from _statements(getattr(node, part, ()), runs)


@cache
def _version(distribution: str) -> str:
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415 - loads much, and a run needs no digest

    try:
        return version(distribution)
    except PackageNotFoundError:
        return "absent"
