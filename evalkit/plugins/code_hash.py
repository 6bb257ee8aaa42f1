"""Digests of the code and the files behind a result."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path


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

    The data of a module, a TOML file of the same name beside it, belong to its sources.
    """
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in found or name.partition(".")[0] not in roots:
            continue
        file = _file(name)
        if file is not None:
            found[name] = file
            waiting.extend(_imported(name, file))
    return frozenset([*found.values(), *filter(Path.is_file, (file.with_suffix(".toml") for file in found.values()))])


def _file(name: str) -> Path | None:
    try:
        spec = find_spec(name)
    except ModuleNotFoundError:  # "package.name" where name is an attribute, not a module
        return None
    return Path(spec.origin) if spec is not None and spec.origin and spec.origin != "built-in" else None


@cache
def _imported(name: str, file: Path) -> tuple[str, ...]:
    """Return the modules that a source file imports anywhere; "package.name" for every name imported from a package."""
    return tuple(_imports(name, file)) if file.suffix == ".py" else ()


def _imports(name: str, file: Path) -> Iterator[str]:
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parent = ".".join(package.split(".")[: len(package.split(".")) - node.level + 1]) if node.level else ""
            base = ".".join(part for part in (parent, node.module) if part)
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


@cache
def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "absent"
