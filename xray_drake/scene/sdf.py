"""Writes objects as SDFormat files that Drake reads.

``python -m xray_drake.scene.sdf`` rewrites ``models/targets``,
``models/bin`` and ``models/tote``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh
from pydrake.math import RigidTransform, RollPitchYaw

from xray_drake.cell.bin import OpenBox
from xray_drake.cell.cell import Cell
from xray_drake.choices import TARGET_NAMES
from xray_drake.resources import models_dir
from xray_drake.scene.contact import (
    ContactConfig,
    hydroelastic_modulus,
)
from xray_drake.scene.object_model import ObjectModel, shaded
from xray_drake.scene.plant import BIN_COLOR, BIN_FRICTION, TOTE_COLOR
from xray_drake.scene.shapes import box_of
from xray_drake.scene.targets import target_model

_PLASTIC = 300.0
"""Density of bin and tote, hollow walls and all, kg/m³."""

DRAKE_NAMESPACE = "http://drake.mit.edu"


def write_sdf(model: ObjectModel, folder: Path) -> Path:
    """Writes ``NAME.sdf`` and, beside it, the OBJ files that it refers to.

    The visual and each collision piece are ``<box>`` where they are boxes
    along the axes, else OBJ files called ``NAME_visual.obj`` and
    ``NAME_piece_0.obj`` and so on; a ``/`` in the object's name becomes ``_``
    in the names of the files. Collisions are compliant hydroelastic.

    Args:
        model: the object.
        folder: where to write; made if it does not exist.

    Returns:
        The path of the SDFormat file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stem = model.name.replace("/", "_")
    ElementTree.register_namespace("drake", DRAKE_NAMESPACE)
    root = Element("sdf", version="1.9")
    link = SubElement(
        SubElement(root, "model", name=model.name), "link", name=model.name
    )
    _add_mass(link, model.p_OCom, model.mass, model.inertia)

    visual = SubElement(link, "visual", name="visual")
    if not _add_box(visual, np.asarray(model.visual.vertices)):
        path = folder / f"{stem}_visual.obj"
        _write_obj(shaded(model.visual), path)
        _add_mesh(visual, path.name)
    material = SubElement(visual, "material")
    SubElement(material, "diffuse").text = _numbers(model.color)

    for index, vertices in enumerate(model.pieces):
        collision = SubElement(link, "collision", name=f"piece_{index}")
        if not _add_box(collision, vertices):
            path = folder / f"{stem}_piece_{index}.obj"
            _write_obj(trimesh.Trimesh(vertices).convex_hull, path)
            mesh = _add_mesh(collision, path.name)
            SubElement(mesh, _drake("declare_convex"))
        _add_proximity(collision, vertices, model)

    return _write(root, folder / f"{stem}.sdf")


def write_open_box(
    name: str, box: OpenBox, color: Sequence[float], folder: Path
) -> Path:
    """Writes ``NAME.sdf`` of a bin or a tote, to be welded to the world.

    Args:
        name: of model and link.
        box: the bin or tote; its frame is the link's.
        color: (4,) red, green, blue, opacity, in [0, 1].
        folder: where to write; made if it does not exist.

    Returns:
        The path of the SDFormat file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ElementTree.register_namespace("drake", DRAKE_NAMESPACE)
    root = Element("sdf", version="1.9")
    link = SubElement(SubElement(root, "model", name=name), "link", name=name)
    whole: Any = trimesh.util.concatenate(
        [
            trimesh.creation.box(slab.size, slab.X_BS)
            for slab in box.slabs()
            if slab.seen
        ]
    )
    whole.density = _PLASTIC
    _add_mass(link, whole.center_mass, whole.mass, whole.moment_inertia)
    for kind in ("visual", "collision"):
        for slab in box.slabs():
            if kind == "visual" and not slab.seen:
                continue
            part = SubElement(link, kind, name=slab.name)
            X_BS = RigidTransform(slab.X_BS)
            SubElement(part, "pose").text = _numbers(
                [*X_BS.translation(), *RollPitchYaw(X_BS.rotation()).vector()]
            )
            size = SubElement(SubElement(part, "geometry"), "box")
            SubElement(size, "size").text = _numbers(slab.size)
            if kind == "visual":
                material = SubElement(part, "material")
                SubElement(material, "diffuse").text = _numbers(color)
                continue
            properties = SubElement(part, _drake("proximity_properties"))
            SubElement(properties, _drake("rigid_hydroelastic"))
            for mu in ("mu_dynamic", "mu_static"):
                SubElement(properties, _drake(mu)).text = _numbers(
                    [BIN_FRICTION]
                )
    return _write(root, folder / f"{name}.sdf")


def write_cell(cell: Cell, folder: Path) -> list[Path]:
    """Writes ``bin/bin.sdf`` and ``tote/tote.sdf`` into a folder."""
    return [
        write_open_box("bin", cell.bin, BIN_COLOR, folder / "bin"),
        write_open_box("tote", cell.tote, TOTE_COLOR, folder / "tote"),
    ]


def write_targets(folder: Path) -> list[Path]:
    """Writes every target into a folder; returns the SDFormat files."""
    return [write_sdf(target_model(name), folder) for name in TARGET_NAMES]


def _write(root: Element, path: Path) -> Path:
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode", xml_declaration=False)
    path.write_text(f'<?xml version="1.0"?>\n{text}\n', encoding="utf-8")
    return path


def _add_mass(
    link: Element, p_BCom: np.ndarray, mass: float, moments: np.ndarray
) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "pose").text = _numbers([*p_BCom, 0, 0, 0])
    SubElement(inertial, "mass").text = _numbers([mass])
    inertia = SubElement(inertial, "inertia")
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        entry = SubElement(inertia, f"i{'xyz'[i]}{'xyz'[j]}")
        largest = np.abs(moments).max()
        value = moments[i, j]
        entry.text = _numbers([value if abs(value) > 1e-6 * largest else 0])


def _add_box(parent: Element, vertices: np.ndarray) -> bool:
    """Adds pose and geometry where the vertices are a box's; says whether."""
    found = box_of(vertices)
    if found is None:
        return False
    size, center = found
    SubElement(parent, "pose").text = _numbers([*center, 0, 0, 0])
    box = SubElement(SubElement(parent, "geometry"), "box")
    SubElement(box, "size").text = _numbers(size)
    return True


def _add_mesh(parent: Element, uri: str) -> Element:
    mesh = SubElement(SubElement(parent, "geometry"), "mesh")
    SubElement(mesh, "uri").text = uri
    return mesh


def _add_proximity(
    collision: Element, vertices: np.ndarray, model: ObjectModel
) -> None:
    contact = ContactConfig()
    properties = SubElement(collision, _drake("proximity_properties"))
    SubElement(properties, _drake("compliant_hydroelastic"))
    for name, value in (
        ("hydroelastic_modulus", hydroelastic_modulus(vertices, contact)),
        ("hunt_crossley_dissipation", contact.dissipation),
        ("mu_dynamic", model.friction),
        ("mu_static", model.friction),
    ):
        SubElement(properties, _drake(name)).text = _numbers([value])


def _write_obj(mesh: trimesh.Trimesh, path: Path) -> None:
    text = trimesh.exchange.obj.export_obj(
        mesh, include_normals=True, include_texture=False, header=path.stem
    )
    path.write_text(text + "\n", encoding="utf-8")


def _drake(name: str) -> str:
    return f"{{{DRAKE_NAMESPACE}}}{name}"


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    """Six significant digits each; less than 1e-12 counts as zero."""
    return " ".join(
        f"{0 if abs(value) < 1e-12 else value:.6g}" for value in values
    )


def main() -> None:
    """Rewrites ``models/targets``, ``models/bin`` and ``models/tote``."""
    folder = models_dir() / "targets"
    for old in (*folder.glob("*.sdf"), *folder.glob("*.obj")):
        old.unlink()
    for path in (*write_targets(folder), *write_cell(Cell(), models_dir())):
        print(path)


if __name__ == "__main__":
    main()
