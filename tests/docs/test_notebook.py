"""The notebook runs from the first cell to the last in an empty folder, and shows what it says."""

import os
import sys
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: pip install 'evalkit[test]'")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: pip install 'evalkit[test]'")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install 'evalkit[test]'")

NOTEBOOK = Path(__file__).parents[2] / "docs" / "notebook.ipynb"


@pytest.mark.checkout
@pytest.mark.slow
@pytest.mark.thorough
def test_the_notebook_runs_and_shows_tables_figures_and_the_refusal_of_a_class_in_a_cell(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # which a command run in this process sets
    notebook = nbformat.read(NOTEBOOK, 4)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # none are stored: this test makes them
    nbclient.NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    data = [out["data"] for out in shown if "data" in out]
    assert sum("image/png" in one for one in data) == 3
    assert any("report" in one.get("text/html", "") for one in data)
    printed = "".join(out.get("text", "") for out in shown)
    assert "InACell" in printed
    assert "move it to a file, say my_icp.py" in printed
    assert any("my_icp:KeepGuess" in one.get("text/plain", "") for one in data)
