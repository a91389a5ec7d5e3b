"""Adds the gripper that a scenario chooses to a search."""

from collections.abc import Mapping

from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, System

from xray_drake.grasping.gripper_geometry import gripper_geometry
from xray_drake.gripper.actuation.ideal import (
    Judge,
    QuasiStaticGripper,
)
from xray_drake.gripper.controller import GripperController
from xray_drake.gripper.mounted import MountedGripper
from xray_drake.gripper.rest_sensor import RestSensor
from xray_drake.gripper.seal_light import SealLight
from xray_drake.gripper.suction import Cup
from xray_drake.gripper.suction_cup import SuctionCup
from xray_drake.scene.heap import Heap
from xray_drake.station.heap_station import StationParts
from xray_drake.station.scenario import Scenario

_Wire = tuple[System, str, System, str]


def add_execution(
    builder: DiagramBuilder,
    scenario: Scenario,
    station: System,
    parts: StationParts,
    heap: Heap,
    judge: Judge,
    *,
    meshcat: Meshcat | None = None,
) -> list[System]:
    """Adds ``gripper_controller``, by contact with all that it feels with.

    By contact there is ``rest_sensor`` as well; if the gripper has one,
    ``suction_cup``; and with a Meshcat its ``seal_light``. Whatever the
    execution, the rest of the diagram sees ``action`` and ``status`` alone.

    Args:
        builder: holds the station already.
        scenario: says which.
        station: of the scenario.
        parts: its inside.
        heap: what lies in the bin.
        judge: says whether a grasp of the ideal gripper holds.
        meshcat: shows, by contact, whether the suction cup has sealed.

    Returns:
        All that was added, the controller first.
    """
    bodies = parts.labels
    if parts.gripper is None:
        added, wires = _quasi_static(
            builder, scenario, station, heap, bodies, judge
        )
    else:
        added, wires = _contact(
            builder, scenario, station, heap, bodies, parts.gripper, meshcat
        )
    for source, output, drain, port in wires:
        builder.Connect(source.GetOutputPort(output), drain.GetInputPort(port))
    return added


def _quasi_static(
    builder: DiagramBuilder,
    scenario: Scenario,
    station: System,
    heap: Heap,
    bodies: Mapping[str, int],
    judge: Judge,
) -> tuple[list[System], list[_Wire]]:
    controller = builder.AddSystem(
        QuasiStaticGripper(
            judge=judge,
            objects=heap.models,
            bodies=bodies,
            geometry=gripper_geometry(scenario.cell.gripper.spec),
            cell=scenario.cell,
            config=scenario.gripper.quasi_static,
            seed=scenario.seed,
            time_step=scenario.plant_config.time_step,
        )
    )
    velocities = "body_spatial_velocities"
    return [controller], [
        (station, "cheat.body_poses", controller, "body_poses"),
        (station, f"cheat.{velocities}", controller, velocities),
        (controller, "applied_spatial_force", station, "applied_spatial_force"),
        (controller, "position", station, "gripper.position"),
    ]


def _contact(
    builder: DiagramBuilder,
    scenario: Scenario,
    station: System,
    heap: Heap,
    bodies: Mapping[str, int],
    gripper: MountedGripper,
    meshcat: Meshcat | None,
) -> tuple[list[System], list[_Wire]]:
    config, spec = scenario.gripper, scenario.cell.gripper.spec
    time_step = scenario.plant_config.time_step
    controller = builder.AddSystem(
        GripperController(
            gripper=gripper,
            tote=scenario.cell.placed_tote,
            config=config.contact,
            force=spec.force,
            time_step=time_step,
        )
    )
    added: list[System] = [controller]
    wires: list[_Wire] = [
        (station, "carrier.state", controller, "carrier_state"),
        (station, "fingers.state", controller, "finger_state"),
        (controller, "carrier_desired_state", station, "carrier.desired_state"),
        (controller, "finger_desired_state", station, "fingers.desired_state"),
    ]
    if gripper.X_BC is not None:
        cup = builder.AddSystem(
            SuctionCup(
                objects=heap.models,
                bodies=bodies,
                gripper=int(gripper.base.index()),
                X_BC=gripper.X_BC,
                cup=Cup(spec, config.suction),
                time_step=time_step,
            )
        )
        added.append(cup)
        velocities = "body_spatial_velocities"
        wires += [
            (cup, "state", controller, "cup_state"),
            (controller, "suction", cup, "suction"),
            (station, "cheat.body_poses", cup, "body_poses"),
            (station, f"cheat.{velocities}", cup, velocities),
            (cup, "applied_spatial_force", station, "applied_spatial_force"),
        ]
    rest = builder.AddSystem(RestSensor(objects=heap.models, bodies=bodies))
    wires += [
        (rest, "at_rest", controller, "at_rest"),
        (station, "cheat.body_poses", rest, "body_poses"),
    ]
    if meshcat is not None and gripper.X_BC is not None:
        light = builder.AddSystem(
            SealLight(
                meshcat,
                gripper.X_BC,
                path=gripper.meshcat_path,
                radius=spec.cup_radius,
                sealed=config.contact.sealed,
            )
        )
        wires.append((cup, "state", light, "cup_state"))
    return [*added, rest], wires
