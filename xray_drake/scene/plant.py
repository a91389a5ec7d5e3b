"""Puts the bin, the tote and objects into a MultibodyPlant."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
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
from pydrake.multibody.parsing import Parser
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

from xray_drake.configuration import BIN_FLOOR
from xray_drake.resources import PACKAGE_NAME
from xray_drake.scene.contact import (
    ContactConfig,
    angular_damping,
    hydroelastic_modulus,
)
from xray_drake.scene.meshes.textures import drake_mesh
from xray_drake.scene.object_model import ObjectModel, shaded
from xray_drake.scene.parsing import configure_parser

BIN_FLOOR_X, BIN_FLOOR_Y = BIN_FLOOR[:2], BIN_FLOOR[2:]
BIN_WALL_HEIGHT = 0.12
"""Inside of the bin, m (PROTOCOL.md); the floor's top is z = 0."""

TOTE_POSITION = (0.62, 0.0, 0.0)
"""Centre of the tote's inside floor in the world, m: beside the bin and out
of the overhead camera's view."""

TOTE_SIZE = (0.36, 0.36, 0.12)
"""Inside of the tote, m: along x and y, and the height of its walls."""


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


def add_bin(plant: MultibodyPlant, *, with_tote: bool = False) -> None:
    """Adds the bin, and the tote beside it, as bodies welded to the world.

    They must not be geometry of the world body itself: up to Drake 1.51.1
    locked joints that touch the world body's geometry end the process.
    """
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModelsFromUrl(f"package://{PACKAGE_NAME}/bin/bin.sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("bin"))
    if with_tote:
        parser.AddModelsFromUrl(f"package://{PACKAGE_NAME}/tote/tote.sdf")
        plant.WeldFrames(
            plant.world_frame(),
            plant.GetFrameByName("tote"),
            RigidTransform(TOTE_POSITION),
        )


def inside_bin(p_W: np.ndarray) -> bool:
    """Says whether a body whose origin is at ``p_W`` (3,) is in the bin."""
    return bool(
        BIN_FLOOR_X[0] < p_W[0] < BIN_FLOOR_X[1]
        and BIN_FLOOR_Y[0] < p_W[1] < BIN_FLOOR_Y[1]
        and p_W[2] > -0.01
    )


def over_tote(p_W: np.ndarray) -> bool:
    """Says whether a body whose origin is at ``p_W`` (3,) is in the tote.

    Or above it, on whatever lies there.
    """
    from_centre = np.abs(np.asarray(p_W) - TOTE_POSITION)
    half = np.array(TOTE_SIZE[:2]) / 2
    return bool((from_centre[:2] < half).all() and p_W[2] > -0.01)


def inside_tote(p_W: np.ndarray) -> bool:
    """Says whether a body whose origin is at ``p_W`` (3,) is in the tote."""
    return over_tote(p_W) and bool(p_W[2] < TOTE_SIZE[2])


def in_memory_mesh(mesh: trimesh.Trimesh, label: str) -> InMemoryMesh:
    """Returns a mesh as Drake takes it, with the normals that VTK needs."""
    text = trimesh.exchange.obj.export_obj(shaded(mesh), include_normals=True)
    return InMemoryMesh(
        mesh_file=MemoryFile(
            contents=text, extension=".obj", filename_hint=label
        )
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
