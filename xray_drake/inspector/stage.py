"""Shows the objects of a heap in Meshcat, at whatever poses."""

from dataclasses import replace

from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from xray_drake.drawing.meshcat_layers import set_opacity
from xray_drake.inspector.snapshot import Poses
from xray_drake.scene.heap import Heap
from xray_drake.station.heap_station import build_heap_station
from xray_drake.station.scenario import Scenario

VISUALIZER = "visualizer"
"""Where Drake's MeshcatVisualizer draws the station."""


class HeapStage:
    """Bin, tote and objects in Meshcat, without a simulation.

    A station of its own: what is shown does not disturb what is simulated.
    """

    def __init__(
        self, scenario: Scenario, heap: Heap, meshcat: Meshcat
    ) -> None:
        """Draws the heap; replaces what another stage drew.

        Args:
            scenario: of the station.
            heap: what lies in the bin.
            meshcat: where.
        """
        self._meshcat = meshcat
        meshcat.Delete(VISUALIZER)
        # No gripper is to be seen, so none need be in the plant.
        gripper = replace(scenario.gripper, execution="quasi_static")
        self._station, self._parts = build_heap_station(
            replace(scenario, gripper=gripper), heap, meshcat=meshcat
        )
        self._context = self._station.CreateDefaultContext()
        position = self._station.GetInputPort("gripper.position")
        drawn = [0.0] * position.size()
        drawn[0] = 1.0  # of the quaternion
        position.FixValue(self._context, drawn)
        self._station.ForcedPublish(self._context)
        meshcat.SetProperty(f"{VISUALIZER}/drawn", "visible", False)
        self._occluders = [model.name for model in heap.objects]

    def show(self, poses: Poses, *, time: float = 0.0) -> None:
        """Puts the objects where they were.

        Args:
            poses: of all objects.
            time: in a recording, s.
        """
        plant = self._parts.plant
        context = plant.GetMyMutableContextFromRoot(self._context)
        for name, X_WO in poses.items():
            joint = self._parts.objects[name].joint
            joint.SetPose(context, RigidTransform(X_WO))
        self._context.SetTime(time)
        self._station.ForcedPublish(self._context)

    def set_opacity(self, opacity: float) -> None:
        """Makes all but the target translucent: an x-ray view.

        Args:
            opacity: in [0, 1].
        """
        for name in self._occluders:
            set_opacity(self._meshcat, name, opacity)
