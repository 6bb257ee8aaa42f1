"""The steps of baselines/README.md and datasets/README.md give working plug-ins."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def blocks(readme, language):
    """Return the code blocks of a README in one language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", readme.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def install(folder, kind, package, readme):
    """Install the README's file as a package with its entry points; returns the environment."""
    (source,) = blocks(readme, "python")
    lines = tomllib.loads(blocks(readme, "toml")[0])["project"]["entry-points"][f"evalkit.{kind}"]
    ((name, value),) = lines.items()
    assert value.startswith(f"{package}.")
    own = f"stranger.{value.rpartition('.')[2]}"
    module = own.partition(":")[0].removeprefix("stranger.")
    (folder / "stranger").mkdir(parents=True)
    (folder / "stranger" / "__init__.py").touch()
    (folder / "stranger" / f"{module}.py").write_text(source, encoding="utf-8")
    (folder / "stranger-1.0.dist-info").mkdir()
    (folder / "stranger-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (folder / "stranger-1.0.dist-info" / "entry_points.txt").write_text(f"[evalkit.{kind}]\n{name} = {own}\n")
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")]))
    return name, {**os.environ, "PYTHONPATH": path}


def evalkit(environment, *words):
    command = [sys.executable, "-c", "from evalkit.cli import main; main()", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def runs(environment, folder, experiment):
    file = folder / "experiment.toml"
    file.write_text(experiment, encoding="utf-8")
    answer = evalkit(environment, "compare", "--no-page", file, "--out", folder / "out", "--json")
    assert answer.returncode == 0, answer.stderr
    return json.loads(answer.stdout)["runs"]


def test_the_back_end_of_the_readme_is_listed_runs_and_beats_the_wheels(tmp_path):
    readme = ROOT / "baselines" / "README.md"
    name, environment = install(tmp_path / "site", "backends", "evalkit_baselines", readme)
    assert name in evalkit(environment, "list", "backends").stdout
    tree, wheels = runs(
        environment,
        tmp_path,
        blocks(readme, "toml")[1]  # the README's own method, with its parameter
        + '[[method]]\nuse = "wheel-odometry"\n'
        + '[[sequence]]\nuse = "room"\nlaps = 0.05\nodometry_scale = 0.1\n',
    )
    assert (tree["method"], tree["status"]) == ("tree-icp", "complete")
    assert tree["scores"]["ate_rmse_m"] < min(0.05, wheels["scores"]["ate_rmse_m"])
    request = json.loads((tmp_path / "out" / "runs" / tree["key"] / "request.json").read_text())
    assert request["backend_parameters"]["max_iterations"] == 20


@pytest.mark.thorough
def test_the_data_set_of_the_readme_is_listed_and_its_error_free_wheels_are_exact(tmp_path):
    readme = ROOT / "datasets" / "README.md"
    name, environment = install(tmp_path / "site", "datasets", "evalkit_datasets", readme)
    assert name in evalkit(environment, "list", "datasets").stdout
    wheels, paper = runs(
        environment,
        tmp_path,
        f'[[method]]\nuse = "wheel-odometry"\n[[method]]\nuse = "paper"\n[[sequence]]\nuse = "{name}"\n',
    )
    assert wheels["scores"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert paper["scores"]["ate_rmse_m"] < 0.05


@pytest.mark.parametrize(("folder", "kind"), [("baselines", "backends"), ("datasets", "datasets")])
def test_the_readme_lists_every_shipped_plug_in(folder, kind):
    named = set(re.findall(r"`([\w-]+)`", (ROOT / folder / "README.md").read_text(encoding="utf-8")))
    content = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert not set(content["project"]["entry-points"][f"evalkit.{kind}"]) - named
