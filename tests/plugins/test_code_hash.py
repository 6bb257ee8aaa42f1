"""The code hash changes with the code that determines a result, and with nothing else."""

import ast
import importlib
import sys
from pathlib import Path

import pytest

import evalkit
from evalkit.plugins import code_hash as module
from evalkit.plugins.code_hash import find_sources, hash_code, hash_files


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Write a third-party package: plug-in -> step -> deep, a relative import in a function, and an unused module."""
    home = tmp_path / "stranger_plugin"
    home.mkdir()
    files = {
        "__init__": "",
        "plugin": "from stranger_plugin.step import walk\nimport json\n",
        "step": "def walk():\n    from . import deep\n    from .deeper import far\n",
        "deep": "import stranger_plugin.plugin\n",  # a circular import
        "deeper": "far = 1\n",
        "bystander": "",
    }
    for name, text in files.items():
        (home / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    clear_caches()
    yield home
    clear_caches()
    for name in [name for name in sys.modules if name.startswith("stranger_plugin")]:
        del sys.modules[name]


def clear_caches():
    find_sources.cache_clear()
    module._list_imports.cache_clear()


def digest():
    clear_caches()
    return hash_code(("stranger_plugin.plugin",), ())


def test_all_modules_imported_within_the_package_are_hashed(package):
    files = find_sources("stranger_plugin.plugin", frozenset({"stranger_plugin"}))
    assert {"plugin.py", "step.py", "deep.py", "deeper.py"} <= {file.name for file in files}
    assert "bystander.py" not in {file.name for file in files}
    assert all(file.is_relative_to(package) for file in files)


@pytest.mark.parametrize("name", ["plugin", "step", "deep", "deeper"])
def test_a_change_of_imported_code_changes_the_hash(package, name):
    before = digest()
    assert digest() == before
    with (package / f"{name}.py").open("a") as file:
        file.write("# changed\n")
    assert digest() != before


@pytest.mark.parametrize(
    "statement",
    [
        "try: from stranger_plugin import bystander\nexcept ImportError: pass",
        "x = 1; import stranger_plugin.bystander",
        "from stranger_plugin import (  # both (needed)\n    deep,\n    bystander,\n)",
        "from stranger_plugin import deep, \\\n    bystander",
        "if True:\n\timport stranger_plugin.bystander as other",
    ],
)
def test_imports_are_found_however_they_are_written(package, statement):
    (package / "deeper.py").write_text(f"{statement}\n")
    assert "bystander.py" in {
        file.name for file in find_sources("stranger_plugin.plugin", frozenset({"stranger_plugin"}))
    }


def test_the_imports_of_every_module_are_those_that_the_parser_of_python_finds():
    found = (ast.Import, ast.ImportFrom)
    for file in Path(evalkit.__file__).parent.rglob("*.py"):
        source = file.read_bytes()
        parsed = {
            (ast.dump(node), runs)
            for node, runs in module._statements(ast.parse(source).body, True)
            if isinstance(node, found)
        }
        read = {(ast.dump(node), runs) for node, runs in module._find_imports(source) if isinstance(node, found)}
        assert read >= parsed, file
        assert read == parsed or file.name == "testing.py", file  # whose docstring shows how to import it


def test_a_change_of_other_code_does_not_change_the_hash(package):
    before = digest()
    (package / "bystander.py").write_text("x = 1\n")
    assert digest() == before


def test_library_versions_are_part_of_the_hash(monkeypatch):
    found = {"numpy": "1.0"}
    monkeypatch.setattr(module, "_version", lambda name: found.get(name, "absent"))
    before = hash_code(("evalkit.core.se2",), ("numpy", "open3d"))
    found["open3d"] = "0.19"
    assert hash_code(("evalkit.core.se2",), ("numpy", "open3d")) != before


def test_harness_code_used_by_the_worker_is_part_of_the_hash():
    reached = {file.name for file in find_sources("evalkit.execution.one_run", frozenset({"evalkit"}))}
    assert {"one_run.py", "frontend.py", "local_map.py", "scan.py", "se2.py", "timing.py"} <= reached
    assert not {"cli.py", "progress.py", "charts.py", "report_page.py", "plots.py", "functions.py"} & reached


@pytest.mark.parametrize("statement", ["from stranger_plugin import far", "import stranger_plugin"])
def test_a_name_that_a_package_imports_on_first_use_is_followed_and_only_where_it_is_used(package, statement):
    (package / "__init__.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from stranger_plugin.deeper import far\n"
        "else:\n    import stranger_plugin.deep\n"
    )
    (package / "plugin.py").write_text("from stranger_plugin import __name__\n")
    reached = find_sources("stranger_plugin.plugin", frozenset({"stranger_plugin"}))
    assert {file.name for file in reached} == {"plugin.py", "__init__.py", "deep.py"}
    (package / "bystander.py").write_text(f"try:\n    {statement}\nexcept ImportError:\n    raise\n")
    reached = find_sources("stranger_plugin.bystander", frozenset({"stranger_plugin"}))
    assert {file.name for file in reached} >= {"bystander.py", "__init__.py", "deeper.py"}


def test_hashing_imports_no_module_whose_names_are_imported(package):
    (package / "step.py").write_text("raise AssertionError('imported')\nfrom stranger_plugin.deep import deep\n")
    assert {"plugin.py", "step.py", "deep.py"} <= {
        file.name for file in find_sources("stranger_plugin.plugin", frozenset({"stranger_plugin"}))
    }


def test_a_recording_replaced_under_its_name_changes_the_hash(tmp_path):
    log, bag = tmp_path / "run.log", tmp_path / "bag"
    log.write_text("FLASER")
    bag.mkdir()
    (bag / "bag.db3").write_bytes(b"1")
    before = [hash_files({"path": str(path), "every": 2}) for path in (log, bag)]
    log.write_text("FLASER 1")
    (bag / "bag.db3").write_bytes(b"12")
    after = [hash_files({"path": str(path), "every": 2}) for path in (log, bag)]
    assert len({*before, *after}) == 4
    assert hash_files({"world": "room", "path": "", "every": 2}) == ""
