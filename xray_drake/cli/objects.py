"""``xray-drake objects``: list, show and export."""

import json as json_format
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.options import AsJson, one_of
from xray_drake.cli.progress import counting_bar
from xray_drake.splits import SPLITS

if TYPE_CHECKING:
    from xray_drake.scene.object_model import ObjectModel

GRID_PITCH = 0.2
"""m between objects on the Meshcat page."""

app = typer.Typer(
    help="The library of procedural objects: list, show or export it.",
    no_args_is_help=True,
)

_Names = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="NAMES",
        help="As in bottle_003, gear_* or bottle_003_packaged; by default all.",
    ),
]
_Split = Annotated[
    str | None,
    typer.Option(
        help=f"{one_of(SPLITS)}; by default train, or any where names or "
        "families are given."
    ),
]
_Family = Annotated[
    list[str] | None, typer.Option(help="Of this family; repeatable.")
]
_Packaged = Annotated[
    bool, typer.Option("--packaged", help="Also those on a backing card.")
]


@app.command("list")
@errors_as_lines()
def list_objects(
    names: _Names = None,
    split: _Split = None,
    family: _Family = None,
    packaged: _Packaged = False,
    json: AsJson = False,
) -> None:
    """Tell the name, split, size, mass and pieces of objects."""
    chosen = choose(names, split, family, packaged)
    rows = [_row(name) for name in chosen]
    if json:
        typer.echo(json_format.dumps(rows, indent=1))
        return
    table = Table("name", "family", "split", title=f"{len(rows)} objects")
    for title in ("size, mm", "mass, g", "pieces"):
        table.add_column(title, justify="right")
    for row in rows:
        table.add_row(
            row["name"],
            row["family"],
            row["split"],
            " × ".join(f"{1000 * side:.0f}" for side in row["size"]),
            f"{1000 * row['mass']:.1f}",
            str(row["pieces"]),
        )
    Console().print(table)


@app.command()
@errors_as_lines()
def show(
    names: _Names = None,
    split: _Split = None,
    family: _Family = None,
    packaged: _Packaged = False,
    per_family: Annotated[
        int | None,
        typer.Option(min=1, help="So many of each family, one family a row."),
    ] = None,
    size: Annotated[
        int,
        typer.Option(min=40, help="Of each object in the sheet, pixels."),
    ] = 160,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write the contact sheet here. By default objects.png, or "
            "nothing with --meshcat."
        ),
    ] = None,
    meshcat: Annotated[
        bool,
        typer.Option(
            "--meshcat",
            help="Show them on a page of this machine; Ctrl-C ends it.",
        ),
    ] = False,
) -> None:
    """Draw a contact sheet, or show objects in Meshcat.

    Without names, families and a number per family, six of each family.
    """
    if not names and not family and per_family is None:
        per_family = 6
    chosen = choose(names, split, family, packaged)
    shown: list[str | None] = list(chosen)
    columns = 8
    if per_family is not None:
        grouped: dict[str, list[str]] = {}
        for name in chosen:
            grouped.setdefault(_family_of(name), []).append(name)
        # Sorted: a packaged variant comes next to its object.
        rows = [sorted(group)[:per_family] for group in grouped.values()]
        columns = max(map(len, rows))
        shown = []
        for row in rows:
            shown += [*row, *[None] * (columns - len(row))]
    from xray_drake.scene.library import make_object

    models = [None if name is None else make_object(name) for name in shown]
    if out is not None or not meshcat:
        _write_sheet(models, out or Path("objects.png"), columns, size)
    if meshcat:
        _serve(models, columns)


@app.command()
@errors_as_lines()
def export(
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Folder to write into.")
    ],
    names: _Names = None,
    split: _Split = None,
    family: _Family = None,
    packaged: _Packaged = False,
    format: Annotated[
        str,
        typer.Option(
            help="sdf: SDFormat with convex collision pieces, mass and "
            "friction; obj: the surface alone."
        ),
    ] = "sdf",
    force: Annotated[
        bool,
        typer.Option("--force", help="Write into a folder that is not empty."),
    ] = False,
) -> None:
    """Write objects as SDFormat or OBJ files."""
    if format not in ("sdf", "obj"):
        raise ValueError(f"no format is called {format!r}: sdf or obj")
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is not a folder")
    if out.is_dir() and any(out.iterdir()) and not force:
        raise ValueError(f"{out} is not empty; --force writes into it")
    chosen = choose(names, split, family, packaged)
    out.mkdir(parents=True, exist_ok=True)
    from xray_drake.scene.library import make_object
    from xray_drake.scene.sdf import write_sdf

    with counting_bar(Console(stderr=True), "objects") as progress:
        for done, name in enumerate(chosen, 1):
            model = make_object(name)
            if format == "sdf":
                write_sdf(model, out)
            else:
                model.visual.export(out / f"{name}.obj")
            progress(done, len(chosen))
    typer.echo(f"{len(chosen)} objects in {out}")


def choose(
    names: Sequence[str] | None,
    split: str | None,
    families: Sequence[str] | None,
    packaged: bool,
) -> list[str]:
    """Chooses objects of the library.

    Args:
        names: names or patterns with ``*``, ``?`` and ``[...]``.
        split: a split; by default train, or any where names or families are
            given.
        families: families; all where none is given.
        packaged: put packaged variants after the objects.

    Raises:
        ValueError: something that does not exist, or nothing chosen.
    """
    from xray_drake.scene.library import object_names, split_of

    splits = SPLITS if split is None and (names or families) else (split,)
    pool = [
        name
        for one in splits
        for name in object_names(*families or (), split=one, packaged=packaged)
    ]
    if not names and not pool:
        raise ValueError(f"no object of the split {split} is in there")
    chosen: dict[str, None] = {}
    for pattern in names or pool:
        found = [pattern]
        if any(sign in pattern for sign in "*?["):
            found = [name for name in pool if fnmatchcase(name, pattern)]
            if not found:
                raise ValueError(f"no object is called like {pattern!r}")
        elif split not in (None, own := split_of(pattern)):
            raise ValueError(f"{pattern!r} is of the split {own}")
        chosen.update(dict.fromkeys(found))
    return list(chosen)


def _row(name: str) -> dict:
    from xray_drake.scene.library import make_object, split_of

    model = make_object(name)
    return {
        "name": name,
        "family": _family_of(name),
        "split": split_of(name),
        "size": [round(float(side), 6) for side in model.extents],
        "mass": round(model.mass, 6),
        "pieces": len(model.pieces),
    }


def _family_of(name: str) -> str:
    from xray_drake.scene.packaging import PACKAGED

    return name.removesuffix(PACKAGED).rpartition("_")[0]


def _write_sheet(
    models: Sequence["ObjectModel | None"],
    path: Path,
    columns: int,
    size: int,
) -> None:
    import cv2

    from xray_drake.drawing.contact_sheet import contact_sheet

    if path.suffix.lower() != ".png":
        raise ValueError(f"{path}: a contact sheet is a PNG file")
    with counting_bar(Console(stderr=True), "drawing") as progress:
        sheet = contact_sheet(
            models, columns=columns, size=size, progress=progress
        )
    _, data = cv2.imencode(".png", sheet[..., ::-1])
    path.write_bytes(data.tobytes())
    typer.echo(f"{len(models) - models.count(None)} objects in {path}")


def _serve(models: Sequence["ObjectModel | None"], columns: int) -> None:
    """Shows objects on a grid until Ctrl-C."""
    import numpy as np
    from pydrake.geometry import Rgba
    from pydrake.math import RigidTransform

    from xray_drake.drawing.meshcat_layers import start_meshcat
    from xray_drake.inspector.controls import Controls
    from xray_drake.scene.object_model import shaded

    meshcat = start_meshcat()
    for i, model in enumerate(models):
        if model is None:
            continue
        row, column = divmod(i, columns)
        mesh, rgba = shaded(model.visual), Rgba(*model.color)
        path, bottom = f"objects/{model.name}", model.visual.bounds[0, 2]
        meshcat.SetTriangleMesh(path, mesh.vertices.T, mesh.faces.T, rgba)
        place = [column * GRID_PITCH, -row * GRID_PITCH, -bottom]
        meshcat.SetTransform(path, RigidTransform(place))
    width = min(columns, len(models)) * GRID_PITCH
    middle = np.array([width / 2, -len(models) / columns * GRID_PITCH / 2, 0])
    meshcat.SetCameraPose(middle + (0, -width, 0.8 * width), middle)
    number = len(models) - models.count(None)
    typer.echo(f"{number} objects at {meshcat.web_url()}; Ctrl-C ends it")
    Controls(meshcat).serve(lambda: False)
