"""Names in the product's code."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = (
    "evalkit", "baselines/evalkit_baselines", "datasets/evalkit_datasets", "reports/evalkit_paper", "docs/evalkit_docs"
)  # fmt: skip
VARIABLES = ("TypeVar", "ParamSpec")


def iter_types(module: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Yield the names of the classes, and of the type aliases and variables at the top, with what defines them."""
    for node in ast.walk(module):
        if isinstance(node, ast.ClassDef):
            yield node.name, node
    for node in module.body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if isinstance(target, ast.Name) and target.id[:1].isupper() and not target.id.isupper():
            yield target.id, node


@pytest.mark.checkout
def test_a_type_name_has_one_meaning():
    places = defaultdict(set)
    for file in (file for source in SOURCES for file in (ROOT / source).rglob("*.py") if "examples" not in file.parts):
        for name, node in iter_types(ast.parse(file.read_bytes())):
            value = getattr(node, "value", None)
            variable = isinstance(value, ast.Call) and ast.unparse(value.func) in VARIABLES
            places[name].add("a variable" if variable else str(file.relative_to(ROOT)))
    assert {"RunResult", "BackendKind", "Spec"} <= places.keys()
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
