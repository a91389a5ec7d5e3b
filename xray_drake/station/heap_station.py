"""The bin station: a heap at rest under an overhead camera."""

from dataclasses import dataclass
from pathlib import Path

from pydrake.geometry import (
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from xray_drake.gripper.grip_surfaces import add_grip_surfaces
from xray_drake.gripper.mounted import MountedGripper, add_gripper
from xray_drake.scene.cameras import add_camera
from xray_drake.scene.heap import Heap
from xray_drake.scene.parsing import configure_parser
from xray_drake.scene.plant import (
    PlantObject,
    add_cell,
    add_objects,
    add_plant,
)
from xray_drake.station.scenario import Scenario


@dataclass(frozen=True, eq=False)
class StationParts:
    """The inside of a station, for those who wire it up or watch it.

    Attributes:
        plant: the plant of bin, tote and objects.
        scene_graph: with all geometry.
        objects: name to object, the target first.
        labels: name to the pixel value of the object in the label image.
        gripper: in the plant, where grasps are executed by contact.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    objects: dict[str, PlantObject]
    labels: dict[str, int]
    gripper: MountedGripper | None = None


def build_heap_station(
    scenario: Scenario, heap: Heap, *, meshcat: Meshcat | None = None
) -> tuple[Diagram, StationParts]:
    """Builds the station around a heap.

    The default context has the heap at rest. Input ports:

    - ``applied_spatial_force``: list of ExternallyAppliedSpatialForce;
    - ``gripper.position``: where the gripper is drawn, see
      :class:`xray_drake.gripper.actuation.ideal.QuasiStaticGripper`; or, where
      the gripper is a body of the plant since execution is by contact,
      ``carrier.desired_state`` (2 n, of n joints) and
      ``fingers.desired_state`` (4), see
      :class:`xray_drake.gripper.controller.GripperController`.

    Output ports, rendered or computed only when looked at:

    - ``overhead.color_image``, ``overhead.depth_image`` (ImageDepth32F, m),
      ``overhead.label_image`` (ImageLabel16I, body indices);
    - ``overhead.camera``: PinholeCamera; and the same four of each other
      camera of the cell, by its name;
    - ``query_object``, ``contact_results``;
    - ``carrier.state`` (2 n), ``fingers.state`` (4), by contact;
    - ``cheat.body_poses``, ``cheat.body_spatial_velocities``: ground truth,
      which a real robot does not have.

    Args:
        scenario: its cell, physics, execution and publishing period are used.
        heap: what lies in the bin.
        meshcat: shows the station, if given. Drake's
            ``ApplyVisualizationConfig`` is not used: it also sends to LCM.

    Raises:
        ValueError: a camera that is not fixed to the world.
    """
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, scenario.plant_config)
    add_cell(plant, scenario.cell)
    items = add_objects(plant, heap.models, contact=scenario.scene.contact)
    for item in items:
        item.joint.SetDefaultPose(RigidTransform(heap.poses[item.name]))
    gripper = None
    if scenario.gripper.execution == "contact":
        gripper = add_gripper(
            plant, carrier=scenario.gripper.carrier, cell=scenario.cell
        )
        add_grip_surfaces(plant, scene_graph, gripper, items)
    plant.Finalize()
    if gripper is None:
        file = scenario.cell.gripper.spec.file
        _add_drawn_gripper(builder, scene_graph, file)
    if meshcat is not None:
        period = scenario.visualization.publish_period
        MeshcatVisualizer.AddToBuilder(
            builder,
            scene_graph,
            meshcat,
            MeshcatVisualizerParams(publish_period=period),
        )
    _export_plant(builder, plant, gripper)
    query = scene_graph.get_query_output_port()
    builder.ExportOutput(query, "query_object")
    for config in (scenario.camera, *scenario.cell.cameras.values()):
        sensor, camera = add_camera(builder, scene_graph, config)
        for image in ("color_image", "depth_image", "label_image"):
            port = sensor.GetOutputPort(
                image.replace("depth_image", "depth_image_32f")
            )
            builder.ExportOutput(port, f"{config.name}.{image}")
        builder.ExportOutput(camera.get_output_port(), f"{config.name}.camera")
    station = builder.Build()
    station.set_name("heap_station")
    parts = StationParts(
        plant=plant,
        scene_graph=scene_graph,
        objects={item.name: item for item in items},
        labels={item.name: int(item.body.index()) for item in items},
        gripper=gripper,
    )
    return station, parts


def _export_plant(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    gripper: MountedGripper | None,
) -> None:
    builder.ExportInput(
        plant.get_applied_spatial_force_input_port(), "applied_spatial_force"
    )
    for port in ("body_poses", "body_spatial_velocities"):
        builder.ExportOutput(plant.GetOutputPort(port), f"cheat.{port}")
    builder.ExportOutput(
        plant.get_contact_results_output_port(), "contact_results"
    )
    if gripper is None:
        return
    for name, instance in (
        ("carrier", gripper.carrier_instance),
        ("fingers", gripper.finger_instance),
    ):
        builder.ExportInput(
            plant.get_desired_state_input_port(instance),
            f"{name}.desired_state",
        )
        builder.ExportOutput(
            plant.get_state_output_port(instance), f"{name}.state"
        )


def _add_drawn_gripper(
    builder: DiagramBuilder, scene_graph: SceneGraph, file: Path
) -> None:
    """Adds a gripper that is seen in Meshcat and nowhere else.

    The ideal gripper of the quasi-static execution acts by forces; its body
    neither collides nor stands in the camera's view.
    """
    gripper = MultibodyPlant(time_step=0.0)
    gripper.set_name("drawn_gripper")
    gripper.RegisterAsSourceForSceneGraph(scene_graph)
    parser = Parser(gripper, "drawn")
    configure_parser(parser)
    parser.AddModels(file)
    gripper.Finalize()
    source = gripper.get_source_id()
    inspector = scene_graph.model_inspector()
    for frame in list(inspector.FramesForSource(source)):
        for role in (Role.kProximity, Role.kPerception):
            scene_graph.RemoveRole(source, frame, role)
    to_pose = builder.AddSystem(MultibodyPositionToGeometryPose(gripper))
    to_pose.set_name("gripper_pose")
    builder.Connect(
        to_pose.get_output_port(), scene_graph.get_source_pose_port(source)
    )
    builder.ExportInput(to_pose.get_input_port(), "gripper.position")
