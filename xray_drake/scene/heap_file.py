"""Heaps in files: which object lies where, and how it comes to lie there.

A heap file is YAML::

    workspace: [0.448, 0.448]   # m, at least so large must the bin be
    release: in_turn            # or as_is, or at_rest
    target: softball            # the name of one of the objects
    objects:
    - name: softball
      mesh: meshes/softball.obj # relative to the file; or object: NAME
      scale: 1.0                # metres per unit of the mesh
      mass: 0.1                 # kg
      X_WO: {translation: [0, 0, 0.2], rotation: !Rpy {deg: [0, 0, 90]}}

``X_WO`` is the pose of the mesh's own frame; an object of the library, or a
target by its name or size, has its body frame there. ``in_turn`` releases each
object at its pose when those before it rest; ``as_is`` puts all of them there
and lets them settle. ``at_rest`` is how :func:`save_heap` writes a heap: poses
are those of the body frames, 4×4, and nothing is simulated.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.schema import Transform

from xray_drake.cell.bin import Bin
from xray_drake.cell.drake_rules import DRAKE_RULES
from xray_drake.choices import MESH_TIME_LIMIT
from xray_drake.configuration import (
    build_struct,
    check,
    check_tree,
    choice,
    configured,
    number,
    number_list,
    path_field,
)
from xray_drake.files import write_whole_file
from xray_drake.scene.heap import RELEASES, Heap
from xray_drake.scene.library import make_object
from xray_drake.scene.meshes.importer import import_mesh
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import (
    TARGET_COLOR,
    laid,
    make_target,
    target_complaint,
)
from xray_drake.trees import (
    ConfigurationError,
    read_text,
    read_tree,
    write_tree,
)

AT_REST = "at_rest"

RESERVED = ("bin", "tote")
"""Names that no object may have."""


@dataclass
class _Item:
    """An object of a heap file."""

    name: str = ""
    mesh: str = path_field()
    object: str = ""
    scale: float = number(1.0, "(0, 1000000]")
    mass: float = number(0.0, "[0, 1000]")
    color: list[float] = number_list((), "[0, 1]", (0, 3))
    X_WO: dict[str, Any] = field(default_factory=dict)
    X_WB: list[list[float]] = field(default_factory=list)

    def complaints(self) -> Any:
        """Yields what is wrong between its fields."""
        if not self.name:
            yield "name is missing"
        if not self.name.isprintable() or "::" in self.name:
            yield f"name is {self.name!r}: Drake takes no such name"
        if self.name in RESERVED:
            yield f"name is {self.name!r}, which is a part of the cell"
        if bool(self.mesh) == bool(self.object):
            yield "mesh: give either a mesh file or the name of an object"
        if bool(self.X_WO) == bool(self.X_WB):
            yield "X_WO is missing"


@dataclass
class _File:
    """A heap file."""

    workspace: list[float] = number_list((), "(0, 10]", (0, 2))
    release: str = choice("as_is", (*RELEASES, AT_REST))
    target: str = ""
    objects: list[_Item] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class HeapFile:
    """What a heap file says.

    Attributes:
        target: the object that is searched for.
        objects: the others, in their order.
        poses: name to 4×4 pose of the body frame, m.
        order: names of all in the order of the file.
        release: one of ``RELEASES``, or ``AT_REST``.
        workspace: (2,) m, or (0,) where none is given.
    """

    target: ObjectModel
    objects: tuple[ObjectModel, ...]
    poses: dict[str, np.ndarray]
    order: tuple[str, ...]
    release: str
    workspace: np.ndarray

    def check_fits(self, bin_: Bin) -> None:
        """Checks that a bin is as large as the workspace.

        Raises:
            ConfigurationError: it is smaller.
        """
        room = np.array([bin_.length, bin_.width])
        if len(self.workspace) and (self.workspace > room + 1e-9).any():
            sides = " × ".join(f"{side:g}" for side in self.workspace)
            raise ConfigurationError(
                f"the heap's workspace is {sides} m, and the bin "
                f"{bin_.length:g} × {bin_.width:g} m: give a larger one in the "
                "cell (cell: {bin: {length: …, width: …}})"
            )
        for name, X_WB in self.poses.items():
            if self.release == AT_REST and not bin_.is_over(X_WB[:3, 3]):
                raise ConfigurationError(
                    f"{name} of the heap lies outside the bin, at "
                    f"{X_WB[:3, 3].round(3).tolist()} m"
                )

    def heap(self) -> Heap:
        """Returns a heap whose objects lie as the file has them."""
        return Heap(
            target=self.target,
            objects=self.objects,
            poses=self.poses,
            seed=0,
            num_dropped=len(self.objects),
            attempts=1,
            settle_time=0.0,
        )


def load_heap_file(
    path: Path, *, time_limit: float = MESH_TIME_LIMIT
) -> HeapFile:
    """Reads a heap file and its meshes.

    Args:
        path: of the file.
        time_limit: s that preparing one of the meshes may take.

    Raises:
        ConfigurationError: it cannot be read, a key does not exist or has a
            value that cannot be, an object has no mesh that can be used, or
            the target is none of them; one line that says where.
    """
    source = str(path)
    tree = read_tree(read_text(path), source)
    file = configured(_File, tree, source, folder=path.parent)
    check(file, source)
    models: dict[str, ObjectModel] = {}
    poses: dict[str, np.ndarray] = {}
    for index, item in enumerate(file.objects):
        where = f"{source}: objects[{index}]"
        if item.name in models:
            raise ConfigurationError(f"{where}: a second {item.name!r}")
        try:
            model = _model(item, time_limit)
        except ValueError as error:
            raise ConfigurationError(f"{where}: {error}") from error
        X_WB = _pose(item, model, f"{where}.X_WO")
        if item.name == file.target and item.mesh:
            flat = laid(model)
            if not item.color:
                flat = replace(flat, color=TARGET_COLOR)
            flat = replace(flat, textured=None)
            if not item.X_WB:
                X_BO = np.linalg.inv(model.origin.X_FO) @ flat.origin.X_FO
                X_WB = X_WB @ X_BO
            model = flat
        models[item.name], poses[item.name] = model, X_WB
    if file.target not in models:
        raise ConfigurationError(
            f"{source}: the target is {file.target!r}, which is none of the "
            f"{len(models)} objects"
        )
    if len(models) < 2:
        raise ConfigurationError(
            f"{source}: a heap needs at least one object beside the target"
        )
    return HeapFile(
        target=models[file.target],
        objects=tuple(m for n, m in models.items() if n != file.target),
        poses=poses,
        order=tuple(models),
        release=file.release,
        workspace=np.array(file.workspace),
    )


def _model(item: _Item, time_limit: float) -> ObjectModel:
    if item.mesh:
        model = import_mesh(
            Path(item.mesh),
            item.name,
            scale=item.scale,
            mass=item.mass or None,
            time_limit=time_limit,
        )
    elif not target_complaint(item.object):
        model = make_target(item.object, mass=item.mass)
    else:
        model = make_object(item.object)
    if item.mass and not item.mesh:
        factor = item.mass / model.mass
        model = replace(model, mass=item.mass, inertia=factor * model.inertia)
    if item.color:
        red, green, blue, *_ = item.color
        model = replace(model, color=(red, green, blue, 1.0))
    return replace(model, name=item.name)


def _pose(item: _Item, model: ObjectModel, where: str) -> np.ndarray:
    """Returns the 4×4 pose of the body frame in the world, m."""
    if item.X_WB:
        try:
            X_WB = np.array(item.X_WB, dtype=float)
            R = X_WB[:3, :3]
            if X_WB.shape != (4, 4) or not np.isfinite(X_WB).all():
                raise ValueError("not 4×4 finite numbers")
            if not np.allclose(X_WB[3], [0, 0, 0, 1]):
                raise ValueError("its last row is not 0 0 0 1")
            if not np.allclose(R @ R.T, np.eye(3)) or np.linalg.det(R) < 0:
                raise ValueError("its rotation is none")
        except (ValueError, IndexError) as error:
            raise ConfigurationError(
                f"{where}: X_WB is no pose: {error}"
            ) from error
        return X_WB
    check_tree(item.X_WO, Transform, where, DRAKE_RULES)
    pose = build_struct(Transform, item.X_WO, where)
    if pose.base_frame not in (None, "", "world"):
        raise ConfigurationError(
            f"{where}.base_frame is {pose.base_frame!r}: poses are in the world"
        )
    if not pose.IsDeterministic():
        raise ConfigurationError(f"{where} is drawn at random: give one pose")
    X_WF = pose.GetDeterministicValue().GetAsMatrix4()
    return X_WF @ model.origin.X_FO


def save_heap(heap: Heap, path: Path, bin_: Bin) -> None:
    """Writes a heap at rest so that :func:`load_heap_file` gives it back.

    Args:
        heap: of objects of the library, of imported meshes, and a target that
            has a name, a size or a mesh.
        path: of the file; meshes are named by absolute paths.
        bin_: in which it lies.

    Raises:
        ValueError: an object was made otherwise.
        OSError: it cannot be written.
    """
    objects = []
    for model in heap.models:
        source = model.origin.source
        if not source:
            raise ValueError(
                f"{model.name} comes neither from the library nor from a file: "
                "a heap file cannot name it"
            )
        kind = "mesh" if Path(source).is_absolute() else "object"
        entry: dict[str, Any] = {"name": model.name, kind: source}
        if kind == "mesh":
            entry["scale"] = model.origin.scale
        entry["mass"], entry["color"] = model.mass, list(model.color[:3])
        entry["X_WB"] = heap.poses[model.name].tolist()
        objects.append(entry)
    tree = {
        "workspace": [bin_.length, bin_.width],
        "release": AT_REST,
        "target": heap.target.name,
        "objects": objects,
    }
    write_whole_file(path, write_tree(tree).encode())
