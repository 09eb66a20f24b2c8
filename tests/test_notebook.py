"""The notebooks run from top to bottom, and what is stored of each is a run of its present cells.

After a change, ``jupyter execute --inplace examples/first_experiment.ipynb`` stores it again.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.long

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
# Notebook -> the files that it reads.
NOTEBOOKS: dict[str, tuple[str, ...]] = {"first_experiment.ipynb": (), "brief.ipynb": ("brief.json",)}
LARGEST_BYTES = 400_000


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def pictures(cell: Any) -> int:
    return sum("image/png" in output.get("data", {}) for output in cell.outputs)


def printed(cell: Any) -> str:
    return "".join(output.text for output in cell.outputs if output.output_type == "stream")


def read(name: str) -> Any:
    import nbformat

    return nbformat.read(EXAMPLES / name, as_version=4)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_what_is_stored(name: str):
    import nbformat

    stored = read(name)
    nbformat.validate(stored)
    assert (EXAMPLES / name).stat().st_size < LARGEST_BYTES
    cells = code_cells(stored)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    for cell in cells:
        assert pictures(cell) == cell.source.count("plt.figure(") + cell.source.count("plt.subplots(")
        for output in cell.outputs:
            assert output.get("name") != "stderr", output
            assert output.output_type != "error", output


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In a folder with its files alone, with pictures where they are stored, and the same printed lines."""
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    stored = read(name)
    fresh = nbformat.from_dict(stored)
    for cell in code_cells(fresh):
        cell.outputs = []
    folder = tmp_path / "empty"
    folder.mkdir()
    for file in NOTEBOOKS[name]:
        shutil.copy(EXAMPLES / file, folder)
    client = NotebookClient(fresh, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(folder)}})
    client.execute()
    for cell, before in zip(code_cells(fresh), code_cells(stored), strict=True):
        assert pictures(cell) == pictures(before), cell.source
        assert printed(cell) == printed(before), cell.source
    assert {file.name for file in folder.iterdir()} == set(NOTEBOOKS[name])
