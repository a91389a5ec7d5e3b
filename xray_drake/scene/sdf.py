"""Writes objects as SDFormat files that Drake reads.

``python -m xray_drake.scene.sdf`` rewrites the targets in ``models/targets``.
"""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh

from xray_drake.choices import TARGET_NAMES
from xray_drake.resources import models_dir
from xray_drake.scene.contact import (
    ContactConfig,
    hydroelastic_modulus,
)
from xray_drake.scene.object_model import ObjectModel, shaded
from xray_drake.scene.shapes import box_of
from xray_drake.scene.targets import target_model

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
    _add_inertial(link, model)

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

    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode", xml_declaration=False)
    path = folder / f"{stem}.sdf"
    path.write_text(f'<?xml version="1.0"?>\n{text}\n', encoding="utf-8")
    return path


def write_targets(folder: Path) -> list[Path]:
    """Writes every target into a folder; returns the SDFormat files."""
    return [write_sdf(target_model(name), folder) for name in TARGET_NAMES]


def _add_inertial(link: Element, model: ObjectModel) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "pose").text = _numbers([*model.p_OCom, 0, 0, 0])
    SubElement(inertial, "mass").text = _numbers([model.mass])
    inertia = SubElement(inertial, "inertia")
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        entry = SubElement(inertia, f"i{'xyz'[i]}{'xyz'[j]}")
        largest = np.abs(model.inertia).max()
        value = model.inertia[i, j]
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
    """Rewrites ``models/targets``."""
    folder = models_dir() / "targets"
    for old in (*folder.glob("*.sdf"), *folder.glob("*.obj")):
        old.unlink()
    for path in write_targets(folder):
        print(path)


if __name__ == "__main__":
    main()
