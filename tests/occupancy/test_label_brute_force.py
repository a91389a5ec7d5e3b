"""The label against brute force, on synthetic and on rendered scenes.

Twelve samples by default; for more:

    XRAY_LABEL_SAMPLES=200 pytest tests/occupancy/test_label_brute_force.py
"""

import os
from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.schema import Rotation

from tests.masks import iou
from tests.nominal import BIN
from tests.occupancy.brute_force_label import brute_force_label
from tests.occupancy.label_scenes import (
    draw_sample,
    pose_target,
    render_target,
)
from tests.occupancy.scenes import CAMERAS, make_camera
from xray_drake.cell.cameras import nominal_camera
from xray_drake.dataset.pictures import Photographer
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.label.ground_truth import LabelConfig, occupancy_label
from xray_drake.scene.heap import Heap

SAMPLES = int(os.environ.get("XRAY_LABEL_SAMPLES", "12"))


@pytest.mark.parametrize("seed", range(SAMPLES))
def test_agrees_with_brute_force(seed: int) -> None:
    sample = draw_sample(seed)
    label = occupancy_label(*sample.inputs, observed=sample.observed)
    expected, modal, count = brute_force_label(
        *sample.inputs, observed=sample.observed
    )
    np.testing.assert_array_equal(label.modal, modal)
    np.testing.assert_array_equal(label.amodal, sample.amodal)
    # Here and there rounding decides.
    assert iou(label.distribution > 0, expected > 0) >= 0.98
    assert np.abs(label.distribution - expected).mean() <= 0.01
    assert label.accepted.sum() == pytest.approx(count, rel=0.01)


@pytest.mark.parametrize("seed", [1, 7])
def test_agrees_where_much_is_accepted(seed: int) -> None:
    """A finer grid and a lower IoU: hundreds of candidates are accepted."""
    config = LabelConfig(step=5, rotations=12, accept_iou=0.3)
    sample = draw_sample(seed)
    label = occupancy_label(
        *sample.inputs, observed=sample.observed, config=config
    )
    expected, _, count = brute_force_label(
        *sample.inputs, observed=sample.observed, config=config
    )
    assert count > 20
    assert label.accepted.sum() == count
    np.testing.assert_array_equal(label.distribution, expected)


@pytest.mark.parametrize(
    ("camera", "x", "kind"),
    [
        pytest.param(CAMERAS["tilted"], 0.03, "covered", id="within the bin"),
        pytest.param(
            make_camera(focal_length=1100), 0.03, "covered", id="and the image"
        ),
        pytest.param(CAMERAS["nominal"], 0.28, "covered", id="beside the bin"),
        pytest.param(CAMERAS["nominal"], 0.28, "open", id="and in full view"),
        (CAMERAS["nominal"], 0.03, "under its own cover"),
        (CAMERAS["nominal"], 0.03, "said to be half"),
        (CAMERAS["nominal"], 0.03, "without readings"),
    ],
)
def test_agrees_on_level_scenes(
    camera: PinholeCamera, x: float, kind: str
) -> None:
    mesh, p_WT = pose_target("box_2to1", np.array([x, 0.02]), 0.4, 0, 0)
    target = render_target(camera, mesh)
    there, observed = np.isfinite(target), None
    height = 0.05 if kind in ("covered", "without readings") else 0.0
    scene = camera.plane_depth(height).astype(np.float32)
    if kind == "under its own cover":
        scene[there] = target[there] - np.float32(0.001)
    if kind == "said to be half":
        observed = there.copy()
        observed[:, int(camera.project(p_WT)[0]) :] = False
    if kind == "without readings":
        scene[:, :100], scene[:, 100:200], scene[:100] = np.nan, np.inf, 0.0
    config = LabelConfig(step=16, rotations=8)
    inputs = target, scene, camera, p_WT
    label = occupancy_label(*inputs, observed=observed, config=config)
    expected, modal, count = brute_force_label(
        *inputs, observed=observed, config=config
    )
    np.testing.assert_array_equal(label.distribution, expected)
    np.testing.assert_array_equal(label.modal, modal)
    assert label.accepted.sum() == count
    # The true pose always counts.
    assert (label.distribution[there] > 0).all()
    assert (count > 20) == (height > 0)


def only(heap: Heap, *names: str) -> Heap:
    """Leaves of the tiny heap the target and a few others."""
    objects = tuple(block for block in heap.objects if block.name in names)
    kept = [heap.target.name, *names]
    return replace(
        heap, objects=objects, poses={name: heap.poses[name] for name in kept}
    )


def hidden_target(heap: Heap) -> Heap:
    """Moves the target to the middle of the book."""
    X_WT = heap.poses["book"].copy()
    X_WT[2, 3] = heap.poses[heap.target.name][2, 3]
    return replace(heap, poses={**heap.poses, heap.target.name: X_WT})


@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("kind", ["hidden", "partly", "visible"])
def test_agrees_with_brute_force_on_rendered_scenes(
    tiny_heap: Heap, kind: str, tilted: bool
) -> None:
    alone = only(tiny_heap)
    heap = alone if kind == "visible" else only(tiny_heap, "book", "plank")
    if kind == "hidden":
        heap = hidden_target(heap)
        alone = only(heap)
    config = nominal_camera()
    if tilted:
        config.X_PB.translation = [0.09, -0.07, 0.75]
        rpy = Rotation.Rpy(deg=[-174.0, 7.0, 6.0])
        config.X_PB.rotation = Rotation(value=rpy)
    pictures = []
    for scene, bin_ in ((alone, None), (heap, BIN)):
        photographer = Photographer(scene.target, scene.objects, config, bin_)
        photographer.place(scene)
        pictures.append(photographer.take())
    inputs = (
        pictures[0].depth,
        pictures[1].depth_without_target,
        pictures[1].camera,
        heap.poses[heap.target.name][:3, 3],
    )
    label = occupancy_label(*inputs)
    expected, _, count = brute_force_label(*inputs)
    np.testing.assert_array_equal(label.distribution, expected)
    assert label.accepted.sum() == count
    assert (count > 4) == (kind == "hidden")
    # What is computed from depths is what the renderer shows.
    seen = pictures[1].instances == 1
    assert label.modal.any() == (kind != "hidden")
    assert np.count_nonzero(label.modal ^ seen) <= 0.02 * label.amodal.sum()
    if kind == "visible":
        assert iou(label.distribution > 0, label.modal) >= 0.9
