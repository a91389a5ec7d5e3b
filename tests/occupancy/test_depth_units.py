"""All that are given a depth image tell readings from nonsense alike."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from tests.occupancy.brute_force import render
from tests.occupancy.inferences import inference_of, label_inference
from tests.occupancy.networks import Mirror, card
from tests.occupancy.scenes import lying, make_camera
from xray_drake.grasping.evidence.depth import DepthEvidence, SeenObject
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.occupancy.label.ground_truth import occupancy_label
from xray_drake.occupancy.learned.inference import LearnedInference
from xray_drake.perception.depth_segmenter import segment_depth
from xray_drake.policy.removal import Removal
from xray_drake.scene.targets import target_model

CAMERA = make_camera(focal_length=138, center=(63.5, 47.5), size=(128, 96))
TARGET = target_model("box_2to1")
HIDDEN = np.zeros(CAMERA.shape, bool)
BLOCK = lying(trimesh.creation.box([0.10, 0.07, 0.04]), 0.02, 0.01, 0.3)
DEPTH, LABEL = render(CAMERA, [BLOCK])

Asked = Callable[[np.ndarray], np.ndarray]


def geometric(depth: np.ndarray) -> np.ndarray:
    return inference_of("box_2to1").infer(depth, HIDDEN, CAMERA).data


def geometric_label(depth: np.ndarray) -> np.ndarray:
    return label_inference(TARGET).infer(depth, HIDDEN, CAMERA).data


def learned(depth: np.ndarray) -> np.ndarray:
    inference = LearnedInference(Mirror(), card(), TARGET.extents)
    return inference.infer(depth, HIDDEN, CAMERA).data


def segmenter(depth: np.ndarray) -> np.ndarray:
    return segment_depth(depth, CAMERA).labels


def grasps(depth: np.ndarray) -> np.ndarray:
    seen = SeenObject(LABEL == 0, depth, CAMERA)
    found = GraspPlanner(DepthEvidence()).find_grasps("block", seen)
    return np.array([grasp.X_WG for grasp in found])


def label(depth: np.ndarray) -> np.ndarray:
    target = np.where(LABEL == 0, CAMERA.plane_depth(0.005), 0.0)
    return occupancy_label(
        target.astype(np.float32), depth, CAMERA, np.array([0.02, 0.01, 0.0025])
    ).distribution


def removal(depth: np.ndarray) -> np.ndarray:
    return Removal(depth, CAMERA).without(LABEL == 0)[1]


@pytest.mark.parametrize(
    "ask",
    [geometric, geometric_label, learned, segmenter, grasps, label, removal],
)
def test_millimetres_are_refused_and_no_reading_is_told_alike(
    ask: Asked,
) -> None:
    for wrong in (
        np.round(1000 * DEPTH).astype(np.uint16),
        (1000 * DEPTH).astype(np.float32),
    ):
        with pytest.raises(ValueError, match="millimetres") as error:
            ask(wrong)
        assert "\n" not in str(error.value)
    answers = []
    for nothing in (0.0, np.inf, np.nan, 2.5):
        lost = DEPTH.copy()
        lost[30:60:7, 40:90:9] = nothing
        answers.append(ask(lost))
    for other in answers[1:]:
        np.testing.assert_array_equal(other, answers[0])
