"""Following baselines/README.md to the letter gives a back end that runs."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

README = Path(__file__).parent.parent / "baselines" / "README.md"


def blocks(language):
    """The README's code blocks in a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def installed(folder):
    """The environment in which the README's file stands in a package of its own, and its line in the entry points."""
    (source,) = blocks("python")
    line = tomllib.loads(blocks("toml")[0])["project"]["entry-points"]["evalkit.backends"]
    ((name, value),) = line.items()
    (folder / "stranger").mkdir(parents=True)
    (folder / "stranger" / "__init__.py").touch()
    (folder / "stranger" / "tree_icp.py").write_text(source, encoding="utf-8")
    (folder / "stranger-1.0.dist-info").mkdir()
    (folder / "stranger-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    own = value.replace("evalkit_baselines.", "stranger.")
    (folder / "stranger-1.0.dist-info" / "entry_points.txt").write_text(f"[evalkit.backends]\n{name} = {own}\n")
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, "PYTHONPATH": path}


def evalkit(environment, *words):
    command = [sys.executable, "-c", "from evalkit.cli import main; main()", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_readmes_back_end_is_listed_runs_and_beats_the_wheels(tmp_path):
    environment = installed(tmp_path / "site")
    assert "tree-icp" in evalkit(environment, "list", "backends").stdout
    experiment = tmp_path / "experiment.toml"
    experiment.write_text(
        blocks("toml")[1]  # the README's own contestant, with its setting
        + '[[contestant]]\nuse = "wheel-odometry"\n'
        + '[[sequence]]\nuse = "room"\nlaps = 0.1\nodometry_scale = 0.1\n'
    )
    answer = evalkit(environment, "run", experiment, "--out", tmp_path / "out", "--json")
    assert answer.returncode == 0, answer.stderr
    tree, wheels = json.loads(answer.stdout)["runs"]
    assert (tree["contestant"], tree["status"]) == ("tree-icp", "complete")
    assert tree["scores"]["ate_rmse_m"] < min(0.05, wheels["scores"]["ate_rmse_m"])
    request = json.loads((tmp_path / "out" / "runs" / tree["key"] / "request.json").read_text())
    assert request["backend_parameters"]["max_iterations"] == 20


def test_the_readme_names_every_shipped_back_end():
    named = set(re.findall(r"`([\w-]+)`", README.read_text(encoding="utf-8")))
    content = tomllib.loads((README.parent.parent / "pyproject.toml").read_text(encoding="utf-8"))
    shipped = content["project"]["entry-points"]["evalkit.backends"]
    assert not set(shipped) - named
