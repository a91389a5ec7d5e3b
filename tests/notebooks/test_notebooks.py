import os
from collections.abc import Iterator
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode

import xray_drake

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

notebooks = pytest.mark.parametrize(
    "path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS]
)


def shown(notebook: NotebookNode) -> Iterator[tuple[str, str]]:
    """Yields what the cells display: MIME type and content."""
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            yield from output.get("data", {}).items()


@notebooks
def test_outputs_are_cleared(path: Path) -> None:
    notebook = nbformat.read(path, as_version=nbformat.NO_CONVERT)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None
    assert "widgets" not in notebook.metadata


def test_search_a_heap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XRAY_DRAKE_NOTEBOOK_TEST", "1")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    # What is tested is this checkout, installed or not.
    monkeypatch.setenv(
        "PYTHONPATH",
        str(Path(xray_drake.__file__).parents[1]),
        prepend=os.pathsep,
    )
    notebook = nbformat.read(FOLDER / "01_search_a_heap.ipynb", as_version=4)
    NotebookClient(
        notebook,
        timeout=600,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()

    outputs = list(shown(notebook))
    kinds = [kind for kind, _ in outputs]
    # The heap's images, the scores, two decisions.
    assert kinds.count("image/png") == 3
    (record,) = [text for kind, text in outputs if kind == "text/markdown"]
    assert "| 1 |" in record
    assert "of 2 actions" in record
    (page,) = [text for kind, text in outputs if kind == "text/html"]
    assert "srcdoc" in page
    (written,) = tmp_path.glob("*/search.html")
    assert written.stat().st_size > 1_000_000


@notebooks
def test_every_notebook_is_executed(path: Path) -> None:
    name = path.stem.split("_", 1)[1]
    assert f"test_{name}" in globals()
