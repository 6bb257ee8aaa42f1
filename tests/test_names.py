"""Names in the product's code."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = ("evalkit", "baselines/evalkit_baselines", "datasets/evalkit_datasets", "reports/evalkit_paper")


def test_a_class_name_has_one_meaning():
    places = defaultdict(list)
    for file in (file for source in SOURCES for file in (ROOT / source).rglob("*.py") if "examples" not in file.parts):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(str(file.relative_to(ROOT)))
    assert "RunResult" in places
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
