"""The page on results documents exactly the existing keys, compared with the schema and with a small run."""

import contextlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.core.run_result import STEP
from evalkit.metrics import fit_calibration, validated
from evalkit.plugins.specs import Published
from evalkit.report import results_json
from evalkit.report.analysis.analysis import analyse
from evalkit.results.results_schema import load_schema

site = pytest.importorskip("evalkit_docs.site", reason="the documentation is not part of a wheel")
PAGE = (site.PAGES / "results.md").read_text(encoding="utf-8")
WRITES, READS = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
SCHEMA = json.loads(load_schema())


def documented(heading):
    """Return the keys of the first table below a heading, and the optional ones."""
    section = re.split(r"^#+ ", PAGE.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    rows = [line.strip("| ").split(" | ", 1) for line in section.splitlines() if line.startswith("| `")]
    return {key.strip("`") for key, _ in rows}, {
        key.strip("`") for key, what in rows if what.startswith("may be absent")
    }


def keys(value, free=("",), path=""):
    """Return the paths of all values that are not objects; names within the paths in ``free`` are "<...>"."""
    if isinstance(value, dict):
        for name, part in value.items():
            step = "<...>" if path in free else name
            yield from keys(part, free, f"{path}.{step}" if path else step)
    elif isinstance(value, list):
        yield f"{path}[]"
        for part in value:
            if isinstance(part, dict):
                yield from keys(part, free, f"{path}[]")
    else:
        yield path


def leaves(found):
    """Merge the keys of the elements of lists of objects."""
    return {path for path in found if not any(other.startswith(f"{path}.") for other in found)}


def schema_paths(node, path=""):
    """Return the same paths of a JSON Schema."""
    node = SCHEMA["$defs"][node["$ref"].split("/")[-1]] | node if "$ref" in node else node
    if isinstance(node.get("additionalProperties"), dict):
        yield from schema_paths(node["additionalProperties"], f"{path}.<...>")
    elif "properties" in node:
        for name, part in node["properties"].items():
            yield from schema_paths(part, f"{path}.{name}" if path else name)
    elif node.get("type") == "array":
        yield from schema_paths(node["items"], f"{path}[]")
    else:
        yield path


def maps(node, path=""):
    """Return the paths where a JSON Schema allows any names."""
    node = SCHEMA["$defs"][node["$ref"].split("/")[-1]] | node if "$ref" in node else node
    if isinstance(node.get("additionalProperties"), dict):
        yield path
        yield from maps(node["additionalProperties"], f"{path}.<...>")
    for name, part in node.get("properties", {}).items():
        yield from maps(part, f"{path}.{name}" if path else name)
    if node.get("type") == "array":
        yield from maps(node["items"], f"{path}[]")


@pytest.fixture(scope="module")
def small(tmp_path_factory, scoring_in_threads):
    """Return the results of the example of the page."""
    folder = tmp_path_factory.mktemp("results")
    with contextlib.chdir(folder):
        run(WRITES)
    result = CliRunner().invoke(app, ["compare", str(folder / "small.toml"), "--out", str(folder / "small")])
    assert result.exit_code == 0, result.output
    return folder / "small"


def run(program):
    exec(compile(program, "results.md", "exec"), {})


ONLY_SOME = {
    f"intervals[].{key}"
    for key in ("detectable", "needed", "reference", "runs", "verdict", "within_high", "within_low")
}
"""The schema has one form for intervals and differences; these are of differences."""


def test_page_schema_and_a_full_report_have_the_same_keys(demo, small):
    label = demo.sequence_labels[0]
    figure = Published("theirs", 0.1, 0.2, "a paper", "ate_rmse_m", "ate_rmse_m")
    card = replace(demo.sequences[label], published=(figure,), defects=("one",))
    everything = replace(demo, sequences={**demo.sequences, label: card})
    told = results_json.build_results(analyse(everything))
    free = set(maps(SCHEMA))
    real = leaves(set(keys(json.loads(json.dumps(told)), free)))
    real |= leaves(set(keys(json.loads((small / "results.json").read_text(encoding="utf-8")), free)))
    page, _ = documented("`results.json`")
    assert page == set(schema_paths(SCHEMA)) - ONLY_SOME
    assert leaves(page | real) == page


@pytest.mark.parametrize(
    ("name", "free"),
    [
        ("request.json", {"backend_parameters", "dataset_parameters"}), ("started.json", ()),
        ("outcome.json", {"notes", "conditions"}),
        ("result.json", {"notes", "provenance.versions", "files", "dataset_parameters"}),
        ("scores.json", {"scores", "files"}),
    ],
)  # fmt: skip
def test_page_and_files_of_a_run_have_the_same_keys(small, name, free):
    real = set()
    for path in small.glob(f"runs/*/{name}"):
        real |= set(keys(json.loads(path.read_text(encoding="utf-8")), free))
    page, absent = documented(f"`{name}`")
    assert page - absent <= real <= page


def test_the_page_lists_the_fields_of_a_step():
    page, _ = documented("Binary files")
    assert page == set(STEP.names)
    kinds = {"i8": "int64", "f8": "float64", "i4": "int32", "i1": "int8"}
    for name in STEP.names:
        assert f"| `{name}` | {kinds[STEP[name].str[1:]]}" in PAGE


def test_the_page_lists_the_columns_of_the_tables(small):
    section = PAGE.split("## Tables")[1].split("## A run's")[0]
    named = [
        name
        for line in section.splitlines()
        if line.startswith("| `")
        for name in re.findall(r"`(\w+)`", line.split(" | ")[0])
    ]
    assert sorted(named) == sorted(pd.read_csv(small / "summary.csv").columns)


def test_the_program_of_the_page_reads_the_results_of_its_experiment(small, monkeypatch, capsys):
    monkeypatch.chdir(small.parent)
    run(READS)
    assert "paper" in capsys.readouterr().out


def test_every_file_in_the_folder_is_on_the_page(small):
    named = re.findall(r"`([\w./]+)`", PAGE)
    for path in small.rglob("*"):
        told = path.name if path.parent in (small, *small.glob("runs/*")) else f"{path.parent.name}/KEY{path.suffix}"
        assert path.is_dir() or told in named, told


def test_map_and_errors_have_the_documented_form(small):
    path = next(iter(small.glob("runs/*/grid.npz")))
    with np.load(path) as grid:
        assert (grid["log_odds"].dtype, grid["observed"].dtype) == (np.float32, bool)
        assert grid["log_odds"].shape == grid["observed"].shape
        assert grid["frame"].shape == (3,)
    assert np.load(path.with_name("errors.npy")).shape == (len(np.fromfile(path.with_name("steps.bin"), STEP)),)


def test_the_shipped_measurements_have_the_keys_of_the_page():
    for file in (validated.FILE, fit_calibration.FILE):
        content = json.loads((Path(validated.__file__).parent / file).read_text(encoding="utf-8"))
        line = next(line for line in PAGE.splitlines() if line.startswith(f"| `{file}`"))
        assert set(re.findall(r"`(\w+)`", line.split(" | ")[2])) == set(content)
    acceptance = json.loads(
        (Path(validated.__file__).parents[1] / "commands/validate/acceptance.schema.json").read_bytes()
    )
    line = next(line for line in PAGE.splitlines() if line.startswith("| `acceptance.json`"))
    assert set(re.findall(r"`(\w+)`", line.split(" | ")[2])) == set(acceptance["properties"])
