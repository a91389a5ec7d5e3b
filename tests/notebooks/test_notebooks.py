import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
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


@dataclass
class Shown:
    """What the cells of a notebook have displayed and printed."""

    images: int
    pages: list[str]
    texts: list[str]
    printed: str


def shown(notebook: NotebookNode) -> Shown:
    found: dict[str, list[str]] = defaultdict(list)
    printed = ""
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            for kind, content in output.get("data", {}).items():
                found[kind].append(content)
            if output.output_type == "stream" and output.name == "stdout":
                printed += output["text"]
    pages, texts = found["text/html"], found["text/markdown"]
    return Shown(len(found["image/png"]), pages, texts, printed)


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


Execute = Callable[[str], Shown]


@pytest.fixture
def execute(kernel: KernelManager, tmp_path: Path) -> Execute:
    """Executes a notebook, shortened, in a folder of its own."""

    def run(name: str) -> Shown:
        afresh = nbformat.v4.new_code_cell(_AFRESH.format(folder=str(tmp_path)))
        notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
        notebook.cells.insert(0, afresh)
        NotebookClient(notebook, timeout=600, km=kernel).execute()
        del notebook.cells[0]
        return shown(notebook)

    return run


def check_pages(folder: Path, *names: str) -> None:
    """Checks that pages with a whole scene in them are written."""
    for name in names:
        (page,) = folder.glob(f"*/{name}.html")
        assert page.stat().st_size > 1_000_000


def test_search_a_heap(execute: Execute, tmp_path: Path) -> None:
    """The heap's images, the scores, two decisions."""
    found = execute("01_search_a_heap")
    assert found.images == 3
    (record,) = found.texts
    assert "| 1 |" in record
    assert "of 2 actions" in record
    (page,) = found.pages
    assert "srcdoc" in page
    check_pages(tmp_path, "search")


def test_inspect_heaps_and_objects(execute: Execute, tmp_path: Path) -> None:
    found = execute("02_inspect_heaps_and_objects")
    assert (found.images, len(found.pages)) == (1, 3)
    check_pages(tmp_path, "object", "heap", "x_ray")
    assert "most of the distribution is under" in found.printed


def test_occupancy_distributions(execute: Execute) -> None:
    found = execute("03_occupancy_distributions")
    assert found.images == 4
    (poses,) = re.findall(r"(\d+) poses are possible", found.printed)
    assert int(poses) > 0


def test_replace_one_system(execute: Execute) -> None:
    found = execute("04_replace_one_system")
    assert "action 1 takes 'near'" in found.printed
    (table,) = found.texts
    assert table.startswith("| step | highest first | X-Ray |")
    assert table.count("**") == 4


def test_generate_train_evaluate(execute: Execute, tmp_path: Path) -> None:
    """Samples, their statistics, the curve, predictions."""
    found = execute("05_generate_train_evaluate")
    assert found.images == 4
    assert "train: 18 images of 3 heaps" in found.printed
    assert "it is sound" in found.printed
    table, search = found.texts
    iou = {}
    for line in table.splitlines()[2:]:
        images, predictor, _, cell, *_ = line.strip("| ").split(" | ")
        if images.startswith("all, "):
            iou[predictor] = float(cell.split()[0])
    assert set(iou) == {"ours", "shipped", "geometric"}
    # A few steps of training make no network.
    assert iou["ours"] < min(iou["shipped"], iou["geometric"])
    (weights,) = tmp_path.glob("*/run/weights.safetensors")
    assert read_card(weights).data["images used"] == 18
    assert "of 2 actions" in search


def test_compare_policies(execute: Execute, tmp_path: Path) -> None:
    """Rates, Figure 6, success within k actions, differences."""
    found = execute("06_compare_policies")
    assert found.images == 4
    # Resumed: every variant searched each heap once.
    assert "4 rollouts were there, 4 are new" in found.printed
    assert len(re.findall(r"heap [01], \w+: ", found.printed)) == 8
    (lines,) = tmp_path.glob("*/rollouts.jsonl")
    assert len(lines.read_text(encoding="utf-8").splitlines()) == 8
    heaps, table, more = found.texts
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
    assert "## Time" in more


def test_contact_execution(execute: Execute, tmp_path: Path) -> None:
    """The decision, the gauges, the gauges of the grasp that fails."""
    found = execute("07_contact_execution")
    assert found.images == 3
    (record,) = found.texts
    (row,) = record.splitlines()[2:]
    # The book, as the tiny heap's search lifts it, lies in the tote.
    _, name, _, outcome, tote, seconds = map(str.strip, row[1:-1].split("|"))
    assert (outcome, tote) == ("lifted", name)
    assert 5 < float(seconds) < 20
    (page,) = found.pages
    assert "srcdoc" in page
    check_pages(tmp_path, "contact")
    assert f"{name}: failed, the cup does not seal" in found.printed


def test_bring_your_own_objects(execute: Execute) -> None:
    found = execute("08_bring_your_own_objects")
    assert found.images == 2
    (table,) = found.texts
    for name in ("ball", "beaker", "bracket", "ring", "slab", "stick"):
        assert f"meshes/{name} |" in table
    assert "not used: broken.stl: it has no faces" in found.printed
    *_, end = found.printed.strip().splitlines()
    assert end in ("success", "horizon", "nothing_graspable")


@notebooks
def test_every_notebook_is_executed(path: Path) -> None:
    name = path.stem.split("_", 1)[1]
    assert f"test_{name}" in globals()
