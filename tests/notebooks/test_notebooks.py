import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import nbformat
import pytest
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient
from nbformat import NotebookNode

import xray_drake
from xray_drake.occupancy.learned.weights import read_card

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


def printed(notebook: NotebookNode) -> str:
    """Returns what the cells print."""
    return "".join(
        output["text"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output.output_type == "stream" and output.name == "stdout"
    )


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


@pytest.fixture(scope="module")
def kernel() -> Iterator[KernelManager]:
    """A kernel for all notebooks: its imports take longer than most of them."""
    # What is tested is this checkout, installed or not.
    paths = str(Path(xray_drake.__file__).parents[1]), os.getenv("PYTHONPATH")
    manager = KernelManager(kernel_name="python3")
    manager.start_kernel(
        env=os.environ
        | {
            "XRAY_DRAKE_NOTEBOOK_TEST": "1",
            "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        }
    )
    yield manager
    manager.shutdown_kernel(now=True)


_AFRESH = """
%reset -f
import os, tempfile
os.chdir({folder!r})
os.environ["TMPDIR"] = tempfile.tempdir = {folder!r}
%reset -f
"""
"""Nothing of the notebook before is left, but what was imported."""


@pytest.fixture
def execute(
    kernel: KernelManager, tmp_path: Path
) -> Callable[[str], NotebookNode]:
    """Executes a notebook, shortened, in a folder of its own."""

    def run(name: str) -> NotebookNode:
        afresh = nbformat.v4.new_code_cell(_AFRESH.format(folder=str(tmp_path)))
        notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
        notebook.cells.insert(0, afresh)
        NotebookClient(notebook, timeout=600, km=kernel).execute()
        del notebook.cells[0]
        return notebook

    return run


def test_search_a_heap(
    execute: Callable[[str], NotebookNode], tmp_path: Path
) -> None:
    outputs = list(shown(execute("01_search_a_heap")))
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


def test_inspect_heaps_and_objects(
    execute: Callable[[str], NotebookNode], tmp_path: Path
) -> None:
    notebook = execute("02_inspect_heaps_and_objects")
    kinds = [kind for kind, _ in shown(notebook)]
    assert kinds.count("image/png") == 1
    assert kinds.count("text/html") == 3
    pages = {path.name: path.stat().st_size for path in tmp_path.glob("*/*")}
    for name in ("object.html", "heap.html", "x_ray.html"):
        assert pages[name] > 1_000_000
    assert "most of the distribution is under" in printed(notebook)


def test_occupancy_distributions(
    execute: Callable[[str], NotebookNode],
) -> None:
    notebook = execute("03_occupancy_distributions")
    kinds = [kind for kind, _ in shown(notebook)]
    assert kinds.count("image/png") == 4
    (poses,) = re.findall(r"(\d+) poses are possible", printed(notebook))
    assert int(poses) > 0


def test_replace_one_system(execute: Callable[[str], NotebookNode]) -> None:
    notebook = execute("04_replace_one_system")
    assert "action 1 takes 'near'" in printed(notebook)
    (table,) = [t for kind, t in shown(notebook) if kind == "text/markdown"]
    assert table.startswith("| step | highest first | X-Ray |")
    assert table.count("**") == 4


def test_generate_train_evaluate(
    execute: Callable[[str], NotebookNode], tmp_path: Path
) -> None:
    notebook = execute("05_generate_train_evaluate")
    outputs = list(shown(notebook))
    # Samples, their statistics, the curve, predictions.
    assert [kind for kind, _ in outputs].count("image/png") == 4
    text = printed(notebook)
    assert "train: 18 images of 3 heaps" in text
    assert "it is sound" in text
    table, search = [t for kind, t in outputs if kind == "text/markdown"]
    iou = {}
    for line in table.splitlines()[2:]:
        images, predictor, _, cell, *_ = line.strip("| ").split(" | ")
        if images.startswith("all, "):
            iou[predictor] = float(cell.split()[0])
    assert set(iou) == {"ours", "shipped", "geometric"}
    # A few steps of training make no network.
    assert iou["ours"] < min(iou["shipped"], iou["geometric"])
    (weights,) = tmp_path.glob("*/run/weights.safetensors")
    card = read_card(weights)
    assert card.data["images used"] == 18
    assert "of 2 actions" in search


def test_compare_policies(
    execute: Callable[[str], NotebookNode], tmp_path: Path
) -> None:
    notebook = execute("06_compare_policies")
    outputs = list(shown(notebook))
    # Rates, Figure 6, success within k actions, differences.
    assert [kind for kind, _ in outputs].count("image/png") == 4
    text = printed(notebook)
    # Resumed: every variant searched each heap once.
    assert "4 rollouts were there, 4 are new" in text
    for seed in (0, 1):
        for policy in ("random", "largest", "xray", "oracle"):
            assert text.count(f"heap {seed}, {policy}: ") == 1
    (lines,) = tmp_path.glob("*/rollouts.jsonl")
    assert len(lines.read_text(encoding="utf-8").splitlines()) == 8
    heaps, table, more = [t for kind, t in outputs if kind == "text/markdown"]
    assert heaps.startswith("| seed | random | largest | xray (learned) |")
    (row,) = [r for r in table.splitlines() if r.startswith("| xray")]
    rate, _, rollouts, _ = row.strip("| ").split(" | ")[1:]
    assert rollouts == "2"
    # Its figures are of another number of objects and actions.
    assert "paper" not in table
    # The rate is that of the table heap by heap.
    cells = [r.split(" | ")[3] for r in heaps.splitlines()[2:]]
    successes = sum(cell != "–" for cell in cells)
    assert rate == f"{100 * successes / len(cells):.1f} %"
    assert text.count("on 2 heaps") == 4
    assert "## Time" in more


def test_contact_execution(
    execute: Callable[[str], NotebookNode], tmp_path: Path
) -> None:
    notebook = execute("07_contact_execution")
    outputs = list(shown(notebook))
    # The decision, the gauges, the gauges of the grasp that fails.
    assert [kind for kind, _ in outputs].count("image/png") == 3
    (record,) = [text for kind, text in outputs if kind == "text/markdown"]
    (row,) = record.splitlines()[2:]
    # The book, as the tiny heap's search lifts it, lies in the tote.
    _, name, _, outcome, tote, seconds = row.strip("| ").split(" | ")
    assert outcome.strip() == "lifted"
    assert tote.strip() == name
    assert 5 < float(seconds) < 20
    (page,) = [text for kind, text in outputs if kind == "text/html"]
    assert "srcdoc" in page
    (written,) = tmp_path.glob("*/contact.html")
    assert written.stat().st_size > 1_000_000
    assert f"{name}: failed, the cup does not seal" in printed(notebook)


def test_bring_your_own_objects(
    execute: Callable[[str], NotebookNode],
) -> None:
    notebook = execute("08_bring_your_own_objects")
    outputs = list(shown(notebook))
    assert [kind for kind, _ in outputs].count("image/png") == 2
    (table,) = [text for kind, text in outputs if kind == "text/markdown"]
    for name in ("ball", "beaker", "bracket", "ring", "slab", "stick"):
        assert f"meshes/{name} |" in table
    text = printed(notebook)
    assert "not used: broken.stl: it has no faces" in text
    assert text.strip().splitlines()[-1] in (
        "success",
        "horizon",
        "nothing_graspable",
    )


@notebooks
def test_every_notebook_is_executed(path: Path) -> None:
    name = path.stem.split("_", 1)[1]
    assert f"test_{name}" in globals()
