"""The label against brute force, on synthetic and on rendered scenes.

Twelve samples by default; for more, and a line of figures for each:

    XRAY_LABEL_SAMPLES=200 pytest tests/occupancy/test_label_brute_force.py -s
"""

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.schema import Rotation
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig

from tests.occupancy.brute_force_label import brute_force_label
from tests.occupancy.label_scenes import draw_sample
from xray_drake.occupancy.label.ground_truth import LabelConfig, occupancy_label
from xray_drake.scene.cameras import add_camera, nominal_camera, pinhole_camera
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import (
    add_bin,
    add_object,
    add_plant,
    default_plant_config,
)

SAMPLES = int(os.environ.get("XRAY_LABEL_SAMPLES", "12"))


def support_iou(a: np.ndarray, b: np.ndarray) -> float:
    either = np.count_nonzero((a > 0) | (b > 0))
    return np.count_nonzero((a > 0) & (b > 0)) / max(either, 1)


@pytest.mark.parametrize("seed", range(SAMPLES))
def test_agrees_with_brute_force(seed: int) -> None:
    sample = draw_sample(seed)
    label = occupancy_label(*sample.inputs, observed=sample.observed)
    expected, modal, count = brute_force_label(
        *sample.inputs, observed=sample.observed
    )
    overlap = support_iou(label.distribution, expected)
    difference = np.abs(label.distribution - expected)
    seen = np.count_nonzero(modal) / np.count_nonzero(label.amodal)
    print(
        f"\n{seed:4d} {sample.name:10} tilt {np.rad2deg(sample.tilt):4.0f}° "
        f"seen {seen:5.1%} accepted {count:6d} IoU {overlap:.4f} "
        f"mean |d| {difference.mean():.2e} identical {not difference.any()}",
        end="",
    )
    np.testing.assert_array_equal(label.modal, modal)
    np.testing.assert_array_equal(label.amodal, sample.amodal)
    assert overlap >= 0.98
    assert difference.mean() <= 0.01
    assert label.accepted.sum() == pytest.approx(count, rel=0.01)


@pytest.mark.parametrize("seed", [1, 7])
def test_agrees_where_much_is_accepted(seed: int) -> None:
    """A finer grid and a lower IoU: hundreds of candidates are accepted."""
    config = LabelConfig(step=5, rotations=12, accept_iou=0.3)
    sample = draw_sample(seed)
    inputs = *sample.inputs, sample.observed
    label = occupancy_label(
        *sample.inputs, observed=sample.observed, config=config
    )
    expected, _, count = brute_force_label(*inputs, config)
    assert count > 20
    assert label.accepted.sum() == count
    np.testing.assert_array_equal(label.distribution, expected)


class VtkImages:
    """Depth and label images of objects at rest, rendered by Drake."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        heap: Heap,
        config: CameraConfig,
        *,
        with_bin: bool,
    ) -> None:
        builder = DiagramBuilder()
        plant, scene_graph = add_plant(builder, default_plant_config())
        if with_bin:
            add_bin(plant)
        self.labels = {}
        for model in models:
            item = add_object(plant, model)
            item.joint.SetDefaultPose(RigidTransform(heap.poses[model.name]))
            self.labels[model.name] = int(item.body.index())
        plant.Finalize()
        sensor, _ = add_camera(builder, scene_graph, config)
        diagram = builder.Build()
        context = sensor.GetMyContextFromRoot(diagram.CreateDefaultContext())
        self.depth, self.label = (
            np.array(port.Eval(context).data[:, :, 0])
            for port in (
                sensor.depth_image_32F_output_port(),
                sensor.label_image_output_port(),
            )
        )


def hidden_target(heap: Heap) -> Heap:
    """Moves the tiny heap's target to the middle of the book."""
    X_WT = heap.poses["book"].copy()
    X_WT[2, 3] = heap.poses[heap.target.name][2, 3]
    pad = np.eye(4)
    pad[:3, 3] = [-0.15, -0.1, 0.0025]
    return replace(
        heap, poses={**heap.poses, heap.target.name: X_WT, "pad": pad}
    )


@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("kind", ["hidden", "partly", "visible"])
def test_agrees_with_brute_force_on_rendered_scenes(
    tiny_heap: Heap, kind: str, tilted: bool
) -> None:
    heap = hidden_target(tiny_heap) if kind == "hidden" else tiny_heap
    config = nominal_camera()
    if tilted:
        config.X_PB.translation = [0.09, -0.07, 0.75]
        config.X_PB.rotation = Rotation(
            value=Rotation.Rpy(deg=[-174.0, 7.0, 6.0])
        )
    others = [block for block in heap.objects if kind != "visible"]
    target = heap.target
    alone = VtkImages([target], heap, config, with_bin=False)
    without = VtkImages(others, heap, config, with_bin=True)
    whole = VtkImages([target, *others], heap, config, with_bin=True)
    inputs = (
        alone.depth,
        without.depth,
        pinhole_camera(config),
        heap.poses[target.name][:3, 3],
    )
    label = occupancy_label(*inputs)
    expected, _, count = brute_force_label(*inputs)
    np.testing.assert_array_equal(label.distribution, expected)
    assert label.accepted.sum() == count
    assert (count > 4) == (kind == "hidden")
    # What is computed from depths is what the renderer shows.
    seen = whole.label == whole.labels[target.name]
    assert label.modal.any() == (kind != "hidden")
    assert np.count_nonzero(label.modal ^ seen) <= 0.02 * label.amodal.sum()
    if kind == "visible":
        assert support_iou(label.distribution, label.modal) >= 0.9
