"""The guess of the label: against brute force, against labels, and its laws."""

from collections import defaultdict
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.masks import iou
from tests.occupancy.brute_force import render
from tests.occupancy.inferences import label_inference
from tests.occupancy.scenes import CAMERAS, cover, lying, occluders
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.geometric.config import (
    GeometricConfig,
    GeometricLabelConfig,
)
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.occupancy.geometric.label_answer import (
    label_of_poses,
)
from xray_drake.occupancy.geometric.label_mixture import LEVELS
from xray_drake.occupancy.geometric.pose_search import PoseSearch
from xray_drake.occupancy.label.ground_truth import occupancy_label
from xray_drake.occupancy.metrics import PixelCounts, pixel_counts
from xray_drake.scene.targets import target_model

NOTHING = np.zeros((384, 512), dtype=bool)


class Scene:
    """A flat target and what lies on it, or hides all of it."""

    def __init__(
        self, name: str, camera: PinholeCamera, seed: int, *, hidden: bool
    ) -> None:
        self.target, self.camera = target_model(name), camera
        rng = np.random.default_rng(seed)
        place = rng.uniform([-0.12, -0.08], [0.12, 0.08])
        angle = rng.uniform(0, 2 * np.pi)
        mesh = lying(self.target.visual, *place, angle)
        height = self.target.extents[2] + 0.002
        others = occluders(rng, 2, place, 0.025, height)
        if hidden:
            others.append(cover(self.target.visual, *place, angle))
        alone, label = render(camera, [mesh])
        without, _ = render(camera, others)
        self.depth, seen = render(camera, [mesh, *others])
        self.mask = seen == 0
        self.amodal = label == 0
        self.label = occupancy_label(
            np.where(self.amodal, alone, 0.0),
            without,
            camera,
            np.array([*place, self.target.extents[2] / 2]),
        ).distribution

    def counts(self, inference: GeometricInference) -> PixelCounts:
        answer = inference.infer(self.depth, self.mask, self.camera)
        return pixel_counts(self.label, answer.data)


def reference(
    search: PoseSearch,
    mask: np.ndarray,
    would_show: np.ndarray,
    turn: int,
    config: GeometricLabelConfig,
) -> list[tuple[np.ndarray, float]]:
    """Returns the labels that the image may have, pose by pose."""
    size, side = int(mask.sum()), search.silhouettes.shape[1]
    margin = side + 2
    canvas = np.pad(mask, margin)
    show = np.pad(would_show, margin, constant_values=True)
    differing = np.full(search.common.shape, np.inf)
    for pose in np.ndindex(*search.common.shape):
        if search.common[pose] <= 0:
            continue
        k, i, j = pose
        top = search.top + i - search.reach + margin
        left = search.left + j - search.reach + margin
        box = slice(top, top + side), slice(left, left + side)
        modal = np.zeros_like(canvas)
        modal[box] = (search.silhouettes[k] > 0) & show[box]
        differing[pose] = np.count_nonzero(modal ^ canvas)
    excess = differing - differing.min()
    alike = np.argwhere(excess <= config.tolerance * size + config.pixels)
    lattices = defaultdict(list)
    for k, i, j in alike:
        key = k % turn, (search.top + i) % 8, (search.left + j) % 8
        lattices[key].append((k, i, j))
    labels = []
    for poses in lattices.values():
        total, weight = np.zeros(canvas.shape), 0.0
        for k, i, j in poses:
            top = search.top + i - search.reach + margin
            left = search.left + j - search.reach + margin
            total[top : top + side, left : left + side] += search.silhouettes[k]
            weight += np.exp(
                -excess[k, i, j] / (config.spread * size + config.pixels)
            )
        inner = total[margin:-margin, margin:-margin]
        labels.append((inner / inner.max(), weight))
    return labels


@pytest.mark.parametrize(
    ("name", "view", "seed"), [("box_2to1", "nominal", 1), ("flute", "low", 4)]
)
def test_it_agrees_with_brute_force(name: str, view: str, seed: int) -> None:
    scene = Scene(name, CAMERAS[view], seed, hidden=False)
    assert 0 < scene.mask.sum() < 0.8 * scene.amodal.sum()
    inference = label_inference(
        scene.target, GeometricConfig(rotations=16, seen_step=0.02)
    )
    heights = np.where(scene.depth < 0.795, 1.0, 0.0)
    would_show = (heights < 0.5) | scene.mask
    poses = inference.poses
    search = poses.search(would_show, scene.mask, scene.camera)
    # Orientations that cover far too little are not looked at.
    config = replace(GeometricLabelConfig(), tolerance=0.15)
    turn = max(1, len(poses.seen_angles) // 8)
    answer = label_of_poses(search, turn, config)
    labels = reference(search, scene.mask, would_show, turn, config)
    assert len(labels) > 3
    total = sum(weight for _, weight in labels)
    # Elsewhere all labels are 0, and so is the answer.
    used = np.any([label > 0 for label, _ in labels], axis=0) | (answer > 0)
    box = np.ix_(used.any(axis=1), used.any(axis=0))
    labels = [(label[box], weight) for label, weight in labels]
    answer = answer[box]

    def score(answer: np.ndarray) -> np.ndarray:
        result = np.zeros(answer.shape)
        # Answers are off by so much.
        for error, chance in ((-0.01, 0.25), (0.0, 0.5), (0.01, 0.25)):
            given = answer + error
            for label, weight in labels:
                value = np.floor(LEVELS * label + 0.5) / LEVELS
                close = np.abs(value - given) < 0.2
                positive = value > 0.1
                gain = (positive & close) - config.cost * (
                    positive | (given > 0.1)
                )
                result += chance * weight / total * (gain + 1e-3 * close)
        return result

    best = np.max(
        [score(np.full(answer.shape, p / LEVELS)) for p in range(LEVELS + 1)],
        axis=0,
    )
    exact = np.rint(LEVELS * answer) / LEVELS
    # Labels of a ten-thousandth are left out, and errors are of three sizes.
    assert (score(exact) >= best - 2e-3).mean() > 0.995
    assert (score(exact) >= best - 0.1).all()
    assert answer.max() > 0.8


def test_it_is_nearer_to_the_label_than_a_count_of_all_poses() -> None:
    expected = counted = PixelCounts()
    for name in ("box_1to1", "box_5to1"):
        ours = label_inference(target_model(name))
        exact = GeometricInference(target_model(name))
        for seed, view in enumerate(("nominal", "tilted", "low") * 2):
            scene = Scene(name, CAMERAS[view], seed, hidden=False)
            if scene.mask.any():
                expected += scene.counts(ours)
                counted += scene.counts(exact)
    assert expected.iou > 0.8
    assert expected.iou > counted.iou + 0.1
    assert expected.balanced_accuracy > 0.93


@pytest.mark.parametrize("name", ["box_2to1", "lid"])
def test_it_is_near_the_label_of_a_hidden_target(name: str) -> None:
    total = PixelCounts()
    for seed in range(3):
        scene = Scene(name, CAMERAS["tilted"], seed, hidden=True)
        assert not scene.mask.any()
        total += scene.counts(label_inference(scene.target))
    assert total.iou > 0.85


@pytest.mark.parametrize("name", ["box_1to1", "box_10to1", "flute"])
def test_a_target_in_full_view_is_where_it_is_seen(name: str) -> None:
    target, camera = target_model(name), CAMERAS["low"]
    depth, label = render(camera, [lying(target.visual, 0.04, -0.03, 0.37)])
    answer = label_inference(target).infer(depth, label == 0, camera)
    assert answer.method == "geometric_label"
    assert iou(answer.data > 0.1, label == 0) >= 0.9


@pytest.mark.parametrize("name", ["box_1to1", "box_5to1", "flute"])
def test_what_a_camera_does_not_read_speaks_against_no_pose(name: str) -> None:
    """Holes cost little; were they empty floor, few poses would be left."""
    whole, holed = PixelCounts(), PixelCounts()
    inference = label_inference(target_model(name))
    for seed in range(4):
        scene = Scene(name, CAMERAS["tilted"], seed, hidden=False)
        if not scene.mask.any():
            continue
        whole += scene.counts(inference)
        # Two of five pixels of the target, and all about its edges.
        rng = np.random.default_rng(seed)
        lost = rng.random(scene.depth.shape) < 0.4
        lost[cv2.dilate(scene.mask.view(np.uint8), np.ones((9, 9))) == 0] = 0
        depth = np.where(lost, 0.0, scene.depth)
        answer = inference.infer(depth, scene.mask & ~lost, scene.camera)
        holed += pixel_counts(scene.label, answer.data)
    assert whole.positives > 0
    assert holed.iou > whole.iou - 0.1


def test_of_many_poses_some_lattices_stand_for_all() -> None:
    scene = Scene("box_5to1", CAMERAS["nominal"], 3, hidden=False)
    all_of_them = label_inference(scene.target)
    config = GeometricConfig(label=GeometricLabelConfig(most_poses=1))
    one = label_inference(scene.target, config)
    data = one.infer(scene.depth, scene.mask, scene.camera).data
    # That of a single lattice: it has one maximum, and that is 1.
    assert data.max() > 0.8
    assert scene.counts(one).iou > 0.3
    assert scene.counts(all_of_them).iou >= scene.counts(one).iou


@pytest.mark.parametrize("seen", [False, True])
def test_where_no_pose_meets_the_mask_that_is_the_answer(seen: bool) -> None:
    """In a corner of the bin, say, that nothing round reaches into."""
    camera = CAMERAS["nominal"]
    mask = NOTHING.copy()
    u, v, _ = camera.project(np.array([0.25, 0.2, 0.0])).astype(int)
    mask[v, u] = seen
    depth, _ = render(camera, [])
    answer = label_inference(target_model("lid")).infer(depth, mask, camera)
    np.testing.assert_array_equal(answer.data, mask)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pixels", 0.0),
        ("spread", 0.0),
        ("peak", -1.0),
        ("slack", 0.0),
        ("most_poses", 0),
        ("tolerance", -0.1),
    ],
)
def test_wrong_numbers_are_named(name: str, value: float) -> None:
    label = replace(GeometricLabelConfig(), **{name: value})
    with pytest.raises(ValueError, match=rf"label\.{name} is .*: it must be"):
        label_inference(target_model("box_1to1"), GeometricConfig(label=label))


def test_the_labels_orientations_must_be_among_those_searched() -> None:
    """The label's are 22.5° apart: steps of 15° do not add up to that."""
    config = GeometricConfig(rotations=24)
    with pytest.raises(ValueError, match=r"rotations is 24: .* 16 orient"):
        label_inference(target_model("box_1to1"), config)
