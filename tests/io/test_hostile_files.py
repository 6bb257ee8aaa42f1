"""Any input is read within limits of time and memory, with a result or a short error. The same targets are fuzzed."""

import ast
import importlib.util
import sys
import warnings
from functools import cache
from pathlib import Path

import pytest

from evalkit.io import map_server, untrusted_io

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
FUZZ = Path(__file__).parents[1] / "fuzz"
TARGETS = sorted(path.stem for path in (FUZZ / "targets").glob("[a-z]*.py"))
NEEDS = {
    "bag_file": "rosbags",
    "bag_messages": "rosbags",
    "bag_sweeps": "rosbags",
    "map_image": "PIL",
    "map_settings": "ruamel.yaml",
}
COUNT = {"bag_file": 12, "bag_messages": 12, "bag_sweeps": 12, "study": 5, "tuning": 5, "experiment": 10}
"""Damaged inputs a target gets here; 50 where nothing is said."""


@pytest.fixture(scope="module")
def load():
    """Return a function ``load(name)`` that imports the module of a fuzz target."""
    spec = importlib.util.spec_from_file_location("fuzz_run", FUZZ / "run.py")
    run = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(run)
    before = list(sys.path)
    yield run.load
    sys.path[:] = before


@pytest.fixture
def restore_caps(monkeypatch):
    """Restore the product's caps after the test, because some targets lower them."""
    monkeypatch.setattr(map_server, "MAX_PIXELS", map_server.MAX_PIXELS)
    monkeypatch.setattr(untrusted_io, "MAX_BYTES", untrusted_io.MAX_BYTES)


@pytest.mark.usefixtures("restore_caps")
@pytest.mark.parametrize("name", TARGETS)
def test_any_input_is_read_within_limits_with_a_result_or_a_short_error(load, name):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a damaged number overflows; only the result matters
        target = load(name)
        from mutation import mutants  # in the folder of the targets

        for data in (*target.seeds(), *target.swollen(), b"", *mutants(target.seeds(), COUNT.get(name, 50), seed=7)):
            try:
                target.read_input(data)
            except BaseException as error:
                error.add_note(f"{name}.read_input({data[:2000]!r}), {len(data)} bytes")
                raise


# --- code that executes or unpickles its input

FORBIDDEN = {
    "eval", "exec", "__import__", "pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "joblib",
    "tarfile", "zipfile", "shutil.unpack_archive", "os.system", "os.popen", "yaml", "np.load", "numpy.load",
    "np.fromregex", "extractall", "allow_pickle", "shell", "read_pickle", "xml", "full_load", "unsafe_load",
}  # fmt: skip
"""Modules, functions, methods and keywords by which data can become commands, or files outside their folder."""

ALLOWED = {
    ("evalkit/commands/export/evo.py", "zipfile"): "written only",
    (
        "evalkit/execution/sandbox.py",
        "pickle",
    ): "a request that this process wrote into a folder of its own (mode 0700), read before foreign code is loaded",
    (
        "evalkit/execution/run_archive.py",
        "zipfile",
    ): "results of its own workers; of a member's name only the last part counts",
    (
        "datasets/evalkit_datasets/recordings/building/builders.py",
        "tarfile",
    ): "one named member of an archive that was verified by its hash, read in blocks and never unpacked into a folder",
    (
        "evalkit/commands/validate/acceptance.py",
        "xml",
    ): "writes a report of tests as XML and reads none",
    (
        "evalkit/io/untrusted_io.py",
        "zipfile",
    ): "reads arrays member by member, bounded, into memory and never into files",
}


def find_forbidden_names(tree):
    """Return the forbidden names in a module: imports, calls by (dotted) name, keywords of calls that are not False."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").partition(".")[0]
        elif isinstance(node, ast.Call):
            yield _dotted_name(node.func)
            yield node.func.attr if isinstance(node.func, ast.Attribute) else ""
            yield from (word.arg for word in node.keywords if getattr(word.value, "value", None) is not False)


def _dotted_name(node):
    """Return the name "a.b.c" of an expression, "" of one that is no name."""
    if isinstance(node, ast.Attribute):
        owner = _dotted_name(node.value)
        return f"{owner}.{node.attr}" if owner else ""
    return node.id if isinstance(node, ast.Name) else ""


@cache
def sources():
    """Return every shipped Python source by its path, except the examples of external programs."""
    return {
        path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for folder in ("evalkit", "baselines", "datasets")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if "examples" not in path.parts
    }


@pytest.mark.checkout
def test_no_source_executes_or_unpickles_its_input():
    used = {
        (place, name) for place, tree in sources().items() for name in find_forbidden_names(tree) if name in FORBIDDEN
    }
    assert sources()
    assert used <= set(ALLOWED)


@pytest.mark.parametrize(
    "text",
    ["import pickle", "from tarfile import open", "eval('1')", "np.load(f)", "run(c, shell=True)", "a.extractall(p)"],
)
def test_the_search_finds_forbidden_names(text):
    assert FORBIDDEN & set(find_forbidden_names(ast.parse(text)))


@pytest.mark.checkout
def test_yaml_is_read_without_constructing_objects():
    calls = [
        ast.unparse(node)
        for tree in sources().values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("YAML")
    ]
    assert calls
    assert all("typ='safe'" in call and "pure=True" in call for call in calls)
