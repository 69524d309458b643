"""The notebooks run from top to bottom."""

import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
QUICKEST = next(path for path in NOTEBOOKS if path.stem == "02_from_paper_to_code")


def code_of(path):
    """Return the code cells of a notebook."""
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]


# ipykernel and its event loop warn about themselves at start-up and shut-down; the notebook's own warnings
# stay in the kernel, where its first cell turns them into errors.
@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path):
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(path.parent)}}).execute()
    assert any(cell.get("outputs") for cell in notebook.cells if cell.cell_type == "code")


def test_the_quickest_notebook_runs_without_a_kernel(monkeypatch, capsys):
    """It calls what the others call; a kernel would take three times as long to start as its cells to run."""
    monkeypatch.chdir(QUICKEST.parent)
    monkeypatch.setattr(sys, "path", [*sys.path])
    names = {}
    for cell in code_of(QUICKEST):
        source = "\n".join(line for line in cell.source.splitlines() if not line.startswith("%matplotlib"))
        exec(compile(source, QUICKEST.name, "exec"), names)  # the notebook's own text
    assert capsys.readouterr().out


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_with_its_outputs_and_in_order(path):
    cells = code_of(path)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert not any(output.output_type == "error" for cell in cells for output in cell.outputs)
