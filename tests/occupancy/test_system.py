"""The OccupancyInference system alone: fix its inputs, read its output."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.framework import Context

from tests.occupancy.scenes import make_camera
from tests.ports import context_with, fix_inputs, ports
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import OccupancyDistribution, TargetMask
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.occupancy.system import OccupancyInference
from xray_drake.scene.targets import target_model

CAMERA = make_camera(focal_length=138, center=(63.5, 47.5), size=(128, 96))
BLANK = np.zeros(CAMERA.shape, bool)
DEPTH = np.full(CAMERA.shape, 0.8, np.float32)
DEPTH[30:60, 40:80] = 0.75


def inputs(
    depth: np.ndarray = DEPTH,
    mask: np.ndarray = BLANK,
    camera: PinholeCamera = CAMERA,
) -> dict[str, object]:
    target_mask = TargetMask(mask)
    return {"depth_image": depth, "target_mask": target_mask, "camera": camera}


def evaluate(
    system: OccupancyInference, context: Context
) -> OccupancyDistribution:
    return system.GetOutputPort("occupancy").Eval(context)


def make_system(inference: object) -> OccupancyInference:
    return OccupancyInference(inference=inference, width=128, height=96)


def test_output_is_what_the_inference_says() -> None:
    inference = GeometricInference(target_model("box_2to1"))
    system = make_system(inference)
    assert ports(system) == (
        ["depth_image", "target_mask", "camera"],
        ["occupancy"],
    )
    output = evaluate(system, context_with(system, **inputs()))
    expected = inference.infer(DEPTH, BLANK, CAMERA)
    np.testing.assert_array_equal(output.data, expected.data)
    assert output.method == "geometric"
    assert output.support_size() > 100


class Counting:
    """Answers with the depth image, and counts."""

    def __init__(self) -> None:
        self.calls = 0

    def infer(
        self, depth: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> OccupancyDistribution:
        self.calls += 1
        return OccupancyDistribution(np.array(depth))


def test_output_is_cached_until_an_input_changes() -> None:
    inference = Counting()
    system = make_system(inference)
    context = context_with(system, **inputs())
    evaluate(system, context)
    context.SetTime(1.0)
    evaluate(system, context)
    assert inference.calls == 1
    seen = BLANK.copy()
    seen[30, 40] = True
    raised = np.array(CAMERA.X_WC)
    raised[2, 3] += 0.01
    longer = np.diag([139.0, 138.0, 1.0])
    for calls, changed in enumerate(
        (
            inputs(DEPTH - 0.1),
            inputs(mask=seen),
            inputs(camera=replace(CAMERA, X_WC=raised)),
            inputs(camera=replace(CAMERA, intrinsics=longer)),
        ),
        start=2,
    ):
        for _ in range(2):  # rendered again
            fix_inputs(system, context, **changed)
            output = evaluate(system, context)
            assert inference.calls == calls
            np.testing.assert_array_equal(output.data, changed["depth_image"])


def test_what_was_seen_last_belongs_to_the_context() -> None:
    inference = Counting()
    system = make_system(inference)
    images = DEPTH, DEPTH / 2
    contexts = [context_with(system, **inputs(image)) for image in images]
    for context, image in list(zip(contexts, images, strict=True)) * 2:
        fix_inputs(system, context, depth_image=image)  # rendered again
        np.testing.assert_array_equal(evaluate(system, context).data, image)
    assert inference.calls == 2


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (inputs(0 * DEPTH), "no reading at all"),
        (inputs(mask=np.zeros((2, 3), bool)), r"mask is \(2, 3\)"),
        (inputs(camera=make_camera(size=(64, 48))), r"built for \(96, 128\)"),
    ],
)
def test_wrong_input_is_one_line(
    wrong: dict[str, object], message: str
) -> None:
    system = make_system(GeometricInference(target_model("box_2to1")))
    with pytest.raises(ValueError, match=message) as error:
        evaluate(system, context_with(system, **wrong))
    assert "\n" not in str(error.value)
