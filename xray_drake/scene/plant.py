"""Puts the bin, the tote and objects into a MultibodyPlant."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    Convex,
    GeometryInstance,
    InMemoryMesh,
    MakePhongIllustrationProperties,
    Mesh,
    PerceptionProperties,
    ProximityProperties,
    RenderLabel,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    LoadModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import (
    BodyIndex,
    JointIndex,
    QuaternionFloatingJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import DiagramBuilder

from xray_drake.cell.bin import Bin, OpenBox, Tote
from xray_drake.cell.cell import Cell
from xray_drake.scene.contact import (
    ContactConfig,
    angular_damping,
    hydroelastic_modulus,
)
from xray_drake.scene.object_model import ObjectModel, TexturedMesh, shaded
from xray_drake.scene.parsing import configure_parser

BIN_COLOR = (0.75, 0.75, 0.75, 1.0)
TOTE_COLOR = (0.35, 0.5, 0.7, 1.0)

_INERTIA = SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1.0, 1.0)
"""Of no account: bin and tote are welded to the world."""

BIN_FRICTION = 0.5
"""Coulomb coefficient of bin and tote (PROTOCOL.md, "Scene")."""


@dataclass(frozen=True)
class PlantObject:
    """An object as it stands in a plant.

    ``RigidBody.Lock`` and ``GetFloatingBaseBodies`` do not know bodies on an
    explicit floating joint, so body and joint are kept together here.

    Attributes:
        model: the object.
        plant: in which it stands.
        body_index: of its body.
        joint_index: of the joint between the world and it.
    """

    # Python's bodies and joints keep their plant in a way that its collector
    # cannot see: a diagram whose systems had them would never be freed.
    model: ObjectModel
    plant: MultibodyPlant
    body_index: BodyIndex
    joint_index: JointIndex

    @property
    def body(self) -> RigidBody:
        """The object's body."""
        return self.plant.get_body(self.body_index)

    @property
    def joint(self) -> QuaternionFloatingJoint:
        """The joint between the world and the body."""
        return self.plant.get_joint(self.joint_index)

    @property
    def name(self) -> str:
        """The object's name, which is also its model instance's."""
        return self.model.name


def default_plant_config() -> MultibodyPlantConfig:
    """Returns the settings under which heaps come to rest.

    Hydroelastic contact, since one point per pair lets flat faces rock and
    the thin target sink; "lagged" at 5 ms, since "sap" throws the target and
    "similar" settles slowly; a tight stiction tolerance, since heaps creep at
    the default one.
    """
    return MultibodyPlantConfig(
        time_step=0.005,
        contact_model="hydroelastic_with_fallback",
        discrete_contact_approximation="lagged",
        stiction_tolerance=1e-4,
        contact_surface_representation="polygon",
    )


def add_plant(
    builder: DiagramBuilder, config: MultibodyPlantConfig
) -> tuple[MultibodyPlant, SceneGraph]:
    """Adds a plant and its scene graph to a diagram under construction."""
    plant, scene_graph = AddMultibodyPlant(config=config, builder=builder)
    plant.set_name("plant")
    scene_graph.set_name("scene_graph")
    return plant, scene_graph


def add_bin(plant: MultibodyPlant, bin_: Bin) -> RigidBody:
    """Adds a bin as a body ``bin`` welded to the world.

    It must not be geometry of the world body itself: up to Drake 1.51.1 locked
    joints that touch the world body's geometry end the process.

    Args:
        plant: not finalized, registered with a scene graph.
        bin_: the bin.
    """
    return _add_open_box(plant, "bin", bin_, np.zeros(3), BIN_COLOR)


def add_tote(plant: MultibodyPlant, tote: Tote) -> RigidBody:
    """Adds a tote at its place as a body ``tote`` welded to the world."""
    p_W = np.array(tote.position)
    return _add_open_box(plant, "tote", tote, p_W, TOTE_COLOR)


def add_cell(plant: MultibodyPlant, cell: Cell) -> None:
    """Adds bin, tote and what else stands in a cell, all but its gripper.

    Raises:
        RuntimeError: the cell's model directives cannot be carried out.
    """
    add_bin(plant, cell.bin)
    add_tote(plant, cell.placed_tote)
    if cell.directives:
        parser = Parser(plant)
        configure_parser(parser)
        ProcessModelDirectives(LoadModelDirectives(cell.directives), parser)


def _add_open_box(
    plant: MultibodyPlant,
    name: str,
    box: OpenBox,
    p_W: np.ndarray,
    color: Sequence[float],
) -> RigidBody:
    instance = plant.AddModelInstance(name)
    body = plant.AddRigidBody(name, instance, _INERTIA)
    properties = ProximityProperties()
    AddContactMaterial(
        friction=CoulombFriction(BIN_FRICTION, BIN_FRICTION),
        properties=properties,
    )
    AddRigidHydroelasticProperties(properties=properties)
    slabs = box.slabs()
    for slab in slabs:
        if slab.seen:
            X_BS, shape = RigidTransform(slab.X_BS), Box(*slab.size)
            plant.RegisterVisualGeometry(
                body, X_BS, shape, slab.name, np.array(color)
            )
    for slab in slabs:
        X_BS, shape = RigidTransform(slab.X_BS), Box(*slab.size)
        plant.RegisterCollisionGeometry(
            body, X_BS, shape, slab.name, properties
        )
    plant.WeldFrames(
        plant.world_frame(), body.body_frame(), RigidTransform(p_W)
    )
    return body


def in_memory_mesh(mesh: trimesh.Trimesh, label: str) -> InMemoryMesh:
    """Returns a mesh as Drake takes it, with the normals that VTK needs."""
    text = trimesh.exchange.obj.export_obj(shaded(mesh), include_normals=True)
    return InMemoryMesh(
        mesh_file=MemoryFile(
            contents=text, extension=".obj", filename_hint=label
        )
    )


def drake_mesh(textured: TexturedMesh, label: str) -> InMemoryMesh:
    """Returns an OBJ file with material and texture that Drake renders.

    Args:
        textured: the mesh.
        label: how Drake calls it in messages.
    """
    mesh = trimesh.Trimesh(textured.vertices, textured.faces, process=False)
    lines = ["mtllib material.mtl", "usemtl textured"]
    lines += [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in textured.vertices]
    lines += [f"vt {u:.6g} {v:.6g}" for u, v in textured.uv]
    lines += [f"vn {x:.4g} {y:.4g} {z:.4g}" for x, y, z in mesh.vertex_normals]
    lines += [
        f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in mesh.faces + 1
    ]
    pixels = cv2.cvtColor(textured.image, cv2.COLOR_RGB2BGR)
    encoded = cv2.imencode(".png", pixels)[1].tobytes()
    return InMemoryMesh(
        mesh_file=MemoryFile(
            contents="\n".join(lines) + "\n",
            extension=".obj",
            filename_hint=label,
        ),
        supporting_files={
            "material.mtl": MemoryFile(
                contents="newmtl textured\nKd 1 1 1\nmap_Kd texture.png\n",
                extension=".mtl",
                filename_hint=f"{label} material",
            ),
            "texture.png": MemoryFile(
                contents=encoded,
                extension=".png",
                filename_hint=f"{label} texture",
            ),
        },
    )


def add_object(
    plant: MultibodyPlant,
    model: ObjectModel,
    *,
    contact: ContactConfig | None = None,
    collides: bool = True,
    visible: bool = True,
    textured: bool = False,
) -> PlantObject:
    """Adds an object as a floating body in a model instance of its name.

    Args:
        plant: not finalized, registered with a scene graph.
        model: the object.
        contact: its material.
        collides: register the collision pieces; a scene that is only looked
            at does not need them.
        visible: register the visual mesh; a scene that nobody looks at does
            not need it.
        textured: register the textured mesh of an object that has one in place
            of the visual mesh.

    Raises:
        RuntimeError: the plant has an object of that name.
    """
    contact = contact or ContactConfig()
    instance = plant.AddModelInstance(model.name)
    unit_inertia_Com = model.inertia / model.mass
    inertia = SpatialInertia(
        mass=model.mass,
        p_PScm_E=model.p_OCom,
        G_SP_E=_unit_inertia_about_origin(unit_inertia_Com, model.p_OCom),
    )
    body = plant.AddRigidBody(model.name, instance, inertia)
    joint = plant.AddJoint(
        QuaternionFloatingJoint(
            name=f"{model.name}_joint",
            frame_on_parent=plant.world_frame(),
            frame_on_child=body.body_frame(),
            angular_damping=angular_damping(model, contact),
            translational_damping=0.0,
        )
    )
    if collides:
        _register_collision(plant, body, model, contact)
    if visible:
        _register_visual(plant, body, model, textured)
    return PlantObject(
        model=model,
        plant=plant,
        body_index=body.index(),
        joint_index=joint.index(),
    )


def add_objects(
    plant: MultibodyPlant,
    models: Iterable[ObjectModel],
    **options: Any,
) -> list[PlantObject]:
    """Adds several objects, with the options of :func:`add_object`."""
    return [add_object(plant, model, **options) for model in models]


def _register_collision(
    plant: MultibodyPlant,
    body: RigidBody,
    model: ObjectModel,
    contact: ContactConfig,
) -> None:
    friction = CoulombFriction(model.friction, model.friction)
    for index, vertices in enumerate(model.pieces):
        proximity = ProximityProperties()
        AddContactMaterial(
            dissipation=contact.dissipation,
            friction=friction,
            properties=proximity,
        )
        AddCompliantHydroelasticProperties(
            resolution_hint=0.05,
            hydroelastic_modulus=hydroelastic_modulus(vertices, contact),
            properties=proximity,
        )
        plant.RegisterCollisionGeometry(
            body,
            RigidTransform(),
            Convex(points=vertices.T, label=f"{model.name}_{index}"),
            f"piece_{index}",
            proximity,
        )


def _unit_inertia_about_origin(
    G_SCom: np.ndarray, p_OCom: np.ndarray
) -> UnitInertia:
    shift = np.dot(p_OCom, p_OCom) * np.eye(3) - np.outer(p_OCom, p_OCom)
    G = G_SCom + shift
    return UnitInertia(
        Ixx=G[0, 0], Iyy=G[1, 1], Izz=G[2, 2],
        Ixy=G[0, 1], Ixz=G[0, 2], Iyz=G[1, 2],
    )  # fmt: skip


def _register_visual(
    plant: MultibodyPlant, body: RigidBody, model: ObjectModel, textured: bool
) -> None:
    perception = PerceptionProperties()
    perception.AddProperty("label", "id", RenderLabel(int(body.index())))
    if textured and model.textured is not None:
        shape = Mesh(drake_mesh(model.textured, model.name))
    else:
        shape = Mesh(in_memory_mesh(model.visual, model.name))
        perception.AddProperty("phong", "diffuse", Rgba(*model.color))
    instance = GeometryInstance(RigidTransform(), shape, "visual")
    instance.set_illustration_properties(
        MakePhongIllustrationProperties(np.array(model.color))
    )
    instance.set_perception_properties(perception)
    plant.RegisterVisualGeometry(body, instance)
