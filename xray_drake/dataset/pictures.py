"""Takes the pictures that labels are made from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig

from xray_drake.cell.bin import Bin
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.instances import instance_image
from xray_drake.scene.cameras import add_camera, pinhole_camera
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import (
    add_bin,
    add_objects,
    add_plant,
    default_plant_config,
)

_FAR_AWAY = RigidTransform([0.0, 0.0, -100.0])
"""Where a body is that is not to be seen: beyond every camera's range."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What one camera sees of a heap, and the truth behind it.

    Attributes:
        depth: (H, W) float32 z-depth, m; 0 or inf is no reading.
        depth_without_target: the same of the scene without the target.
        instances: (H, W) uint8; 0 background, 1 target, i + 2 the object
            ``names[i]``.
        names: of the distractors.
        camera: of all images.
        color: (H, W, 3) uint8 RGB, or None.
    """

    depth: np.ndarray
    depth_without_target: np.ndarray
    instances: np.ndarray
    names: tuple[str, ...]
    camera: PinholeCamera
    color: np.ndarray | None = None


class _Scene:
    """Objects in the bin under a camera; nothing collides."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        camera: CameraConfig,
        *,
        bin_: Bin | None,
        textured: bool,
    ) -> None:
        builder = DiagramBuilder()
        plant, scene_graph = add_plant(builder, default_plant_config())
        if bin_ is not None:
            add_bin(plant, bin_)
        items = add_objects(plant, models, collides=False, textured=textured)
        plant.Finalize()
        self._items = {item.name: item for item in items}
        self._sensor, _ = add_camera(builder, scene_graph, camera)
        diagram = builder.Build()
        self._root = diagram.CreateDefaultContext()
        self._plant_context = plant.GetMyMutableContextFromRoot(self._root)
        self._context = self._sensor.GetMyMutableContextFromRoot(self._root)

    def label(self, name: str) -> int:
        """Returns an object's value in the label image."""
        return int(self._items[name].body.index())

    def place(self, name: str, X_WO: np.ndarray | None) -> None:
        """Puts an object somewhere, or out of sight."""
        X = _FAR_AWAY if X_WO is None else RigidTransform(X_WO)
        self._items[name].joint.SetPose(self._plant_context, X)

    def look_from(self, config: CameraConfig) -> None:
        color, depth = config.MakeCameras()
        X_WB = RigidTransform(config.X_PB.GetDeterministicValue())
        self._sensor.SetX_PB(self._context, X_WB)
        # The label image follows the colour camera.
        self._sensor.SetColorRenderCamera(self._context, color)
        self._sensor.SetDepthRenderCamera(self._context, depth)

    def image(self, kind: str) -> np.ndarray:
        """Returns the (H, W, n) image of a port of Drake's sensor."""
        port = self._sensor.GetOutputPort(kind)
        return np.array(port.Eval(self._context).data)


class Photographer:
    """Renders a set of objects in the bin, in any poses, from any camera.

    Building one takes 0.1 s; a picture of depth, depth without the target, and
    instances some 15 ms on one core without a GPU.
    """

    def __init__(
        self,
        target: ObjectModel,
        objects: Sequence[ObjectModel],
        camera: CameraConfig,
        bin_: Bin | None,
        *,
        color: bool = False,
    ) -> None:
        """Builds the scene.

        Args:
            target: what is searched for.
            objects: the distractors.
            camera: the nominal camera: gives the size of the images and the
                renderer.
            bin_: in which they lie; None for objects alone.
            color: pictures have colour, with the textures of imported meshes.
        """
        models = [target, *objects]
        self._names = [model.name for model in models]
        self._scene = _Scene(models, camera, bin_=bin_, textured=False)
        self._scenes = [self._scene]
        if color:
            # Textured meshes have all the triangles of a scan: too slow for
            # depth and labels.
            self._scenes.append(
                _Scene(models, camera, bin_=bin_, textured=True)
            )
        self._heap: Heap | None = None
        self._camera = pinhole_camera(camera)

    def place(self, heap: Heap) -> None:
        """Puts the objects where a heap has them; others are out of sight.

        Raises:
            KeyError: the heap holds an object that the scene does not.
        """
        strange = set(heap.poses) - set(self._names)
        if strange:
            raise KeyError(f"not in this scene: {', '.join(sorted(strange))}")
        for scene in self._scenes:
            for name in self._names:
                scene.place(name, heap.poses.get(name))
        self._heap = heap

    def look_from(self, config: CameraConfig) -> None:
        """Moves the camera; the size of its images stays."""
        for scene in self._scenes:
            scene.look_from(config)
        self._camera = pinhole_camera(config)

    def depth(self) -> np.ndarray:
        """Returns the (H, W) float32 depth image of what is placed, m."""
        return self._scene.image("depth_image_32f")[..., 0]

    def take(self) -> Picture:
        """Takes a picture of what is placed.

        Raises:
            RuntimeError: nothing is placed.
        """
        heap, scene = self._heap, self._scene
        if heap is None:
            raise RuntimeError("place a heap before taking a picture")
        target = heap.target.name
        names = tuple(model.name for model in heap.objects)
        depth = self.depth()
        instances = instance_image(
            scene.image("label_image")[..., 0],
            scene.label(target),
            [scene.label(name) for name in names],
        )
        color = None
        for textured in self._scenes[1:]:
            color = textured.image("color_image")[..., :3]
        scene.place(target, None)
        without_target = self.depth()
        scene.place(target, heap.poses[target])
        return Picture(
            depth, without_target, instances, names, self._camera, color
        )
