"""The notebook runs from top to bottom, shows its pictures, and is stored without outputs."""

import itertools
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

FEWER = {"step=2": "step=40", "step=6": "step=60", '("scale", "keep", "drop")': '("keep",)'}
"""Replacements that reduce the number of frames and clips, to save time; each key is in the notebook."""
NOTEBOOK = Path(__file__).parents[2] / "examples" / "mimesh.ipynb"


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the kernel's own warnings are not ours
def test_the_notebook_runs_with_fewer_frames(tmp_path):
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert all(any(original in cell["source"] for cell in notebook.cells) for original in FEWER)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
    for cell, (original, reduced) in itertools.product(notebook.cells, FEWER.items()):
        cell["source"] = cell["source"].replace(original, reduced)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert sum("image/png" in output.get("data", {}) for output in shown) == 6
    assert not any(output.get("name") == "stderr" for output in shown)
    written = {path.name for path in (tmp_path / "mimesh-notebook").iterdir()}
    assert written > {"pose.glb", "jump.glb", "jump-skinned.glb", "jump.pc2", "jump.webp"}
