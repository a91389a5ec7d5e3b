"""The OccupancyInference system alone: fix its inputs, read its output."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageDepth32F

from tests.ports import inputs_of
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import OccupancyDistribution, TargetMask
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.occupancy.system import OccupancyInference
from xray_drake.scene.targets import target_model

WIDTH, HEIGHT = 128, 96
SHAPE = (HEIGHT, WIDTH)


@pytest.fixture(scope="module")
def system() -> OccupancyInference:
    inference = GeometricInference(target_model("box_2to1"))
    return OccupancyInference(inference=inference, width=WIDTH, height=HEIGHT)


def overhead_camera() -> PinholeCamera:
    K = np.array([[138.0, 0, 63.5], [0, 138.0, 47.5], [0, 0, 1]])
    X_WC = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WC[2, 3] = 0.8
    return PinholeCamera(WIDTH, HEIGHT, K, X_WC)


def context_with(
    system: OccupancyInference, depth: np.ndarray, mask: np.ndarray
) -> Context:
    context = system.CreateDefaultContext()
    fix_depth(system, context, depth)
    system.GetInputPort("target_mask").FixValue(
        context, AbstractValue.Make(TargetMask(mask))
    )
    system.GetInputPort("camera").FixValue(
        context, AbstractValue.Make(overhead_camera())
    )
    return context


def fix_depth(
    system: OccupancyInference, context: Context, depth: np.ndarray
) -> None:
    image = ImageDepth32F(depth.shape[1], depth.shape[0])
    image.mutable_data[:, :, 0] = depth
    system.GetInputPort("depth_image").FixValue(
        context, AbstractValue.Make(image)
    )


def evaluate(
    system: OccupancyInference, context: Context
) -> OccupancyDistribution:
    return system.GetOutputPort("occupancy").Eval(context)


def cluttered_depth() -> np.ndarray:
    depth = np.full(SHAPE, 0.8, np.float32)
    depth[30:60, 40:80] = 0.75
    return depth


def test_ports_are_named(system: OccupancyInference) -> None:
    inputs = inputs_of(system)
    assert inputs == ["depth_image", "target_mask", "camera"]
    assert system.num_output_ports() == 1
    assert system.get_output_port().get_name() == "occupancy"


def test_output_is_what_the_inference_says(system: OccupancyInference) -> None:
    depth, mask = cluttered_depth(), np.zeros(SHAPE, bool)
    output = evaluate(system, context_with(system, depth, mask))
    expected = GeometricInference(target_model("box_2to1")).infer(
        depth, mask, overhead_camera()
    )
    np.testing.assert_array_equal(output.data, expected.data)
    assert output.method == "geometric"
    assert output.support_size() > 100


def test_output_is_cached_until_an_input_changes() -> None:
    calls = []

    class Counting:
        def infer(
            self,
            depth: np.ndarray,
            target_mask: np.ndarray,
            camera: PinholeCamera,
        ) -> OccupancyDistribution:
            calls.append(depth.copy())
            return OccupancyDistribution(target_mask.astype(np.float32))

    system = OccupancyInference(
        inference=Counting(), width=WIDTH, height=HEIGHT
    )
    depth, mask = cluttered_depth(), np.zeros(SHAPE, bool)
    context = context_with(system, depth, mask)
    evaluate(system, context)
    context.SetTime(1.0)
    evaluate(system, context)
    assert len(calls) == 1
    fix_depth(system, context, depth - 0.1)
    evaluate(system, context)
    assert len(calls) == 2
    np.testing.assert_array_equal(calls[1], depth - np.float32(0.1))
    fix_depth(system, context, depth - 0.1)  # rendered again
    evaluate(system, context)
    assert len(calls) == 2
    one = mask.copy()
    one[30, 40] = True
    system.GetInputPort("target_mask").FixValue(
        context, AbstractValue.Make(TargetMask(one))
    )
    assert evaluate(system, context).data[30, 40] == 1.0
    moved = overhead_camera()
    X_WC = np.array(moved.X_WC)
    X_WC[2, 3] += 0.01
    system.GetInputPort("camera").FixValue(
        context,
        AbstractValue.Make(
            PinholeCamera(WIDTH, HEIGHT, moved.intrinsics, X_WC)
        ),
    )
    evaluate(system, context)
    assert len(calls) == 4


def attributes(system: OccupancyInference) -> dict[str, object]:
    """Without the bindings' own."""
    return {
        name: value
        for name, value in vars(system).items()
        if not name.startswith("_pydrake")
    }


def test_what_was_seen_last_belongs_to_the_context() -> None:
    calls = []

    class Counting:
        def infer(
            self,
            depth: np.ndarray,
            target_mask: np.ndarray,
            camera: PinholeCamera,
        ) -> OccupancyDistribution:
            calls.append(depth)
            return OccupancyDistribution(depth)

    system = OccupancyInference(
        inference=Counting(), width=WIDTH, height=HEIGHT
    )
    before = attributes(system)
    depth, mask = cluttered_depth(), np.zeros(SHAPE, bool)
    one = context_with(system, depth, mask)
    other = context_with(system, depth / 2, mask)
    for context, image in ((one, depth), (other, depth / 2)) * 2:
        fix_depth(system, context, image)  # rendered again
        np.testing.assert_array_equal(evaluate(system, context).data, image)
    assert len(calls) == 2
    assert attributes(system) == before


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf])
def test_depth_without_any_reading(
    system: OccupancyInference, nothing: float
) -> None:
    depth = np.full(SHAPE, nothing, np.float32)
    context = context_with(system, depth, np.zeros(SHAPE, bool))
    with pytest.raises(ValueError, match="no reading at all") as error:
        evaluate(system, context)
    assert "\n" not in str(error.value)


def test_mask_of_another_shape(system: OccupancyInference) -> None:
    context = context_with(system, cluttered_depth(), np.zeros((2, 3), bool))
    with pytest.raises(ValueError, match=r"mask is \(2, 3\)") as error:
        evaluate(system, context)
    assert "\n" not in str(error.value)


def test_camera_of_another_shape(system: OccupancyInference) -> None:
    context = context_with(system, cluttered_depth(), np.zeros(SHAPE, bool))
    camera = overhead_camera()
    other = PinholeCamera(64, 48, camera.intrinsics, camera.X_WC)
    system.GetInputPort("camera").FixValue(context, AbstractValue.Make(other))
    with pytest.raises(ValueError, match=r"built for \(96, 128\)"):
        evaluate(system, context)
