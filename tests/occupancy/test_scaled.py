import numpy as np
import pytest

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.inference import make_inference
from xray_drake.occupancy.scaled import usual_scale
from xray_drake.scene.targets import target_model

X_WC = np.diag([1.0, -1.0, -1.0, 1.0])
X_WC[2, 3] = 0.8


def camera(width: int, height: int) -> PinholeCamera:
    f = 552.5 * width / 512
    K = [[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]]
    return PinholeCamera(width, height, np.array(K), X_WC)


def covered(seen: PinholeCamera) -> np.ndarray:
    """A plate 50 mm up over a part of the floor; else the floor."""
    depth = seen.plane_depth(0.0).astype(np.float32)
    xy = seen.unproject(seen.plane_depth(0.05))[..., :2]
    plate = (np.abs(xy - [0.05, -0.02]) < [0.08, 0.06]).all(axis=-1)
    depth[plate] = 0.75
    return depth


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


@pytest.mark.parametrize("seen", [False, True])
def test_a_large_image_has_the_answer_of_a_small_one(seen: bool) -> None:
    large, small = camera(1024, 768), camera(512, 384)
    target = target_model("box_2to1")
    answers: list[OccupancyDistribution] = []
    for view, scale in ((large, 0.5), (small, 1.0)):
        mask = np.zeros(view.shape, bool)
        if seen:
            u, v, _ = view.project(np.array([-0.03, -0.02, 0.005]))
            reach = int(0.008 * view.floor_scale)
            mask[int(v) - reach : int(v) + reach, int(u) - reach : int(u)] = 1
        model = make_inference("geometric", target, scale=scale)
        answers.append(model.infer(covered(view), mask, view))
    one, other = (answer.support() for answer in answers)
    assert one.shape == (768, 1024)
    assert iou(one[::2, ::2], other) > 0.9


def test_a_target_that_is_seen_stays_so() -> None:
    """Of a sliver of one pixel none might be among those that are kept."""
    view = camera(1024, 768)
    mask = np.zeros(view.shape, bool)
    mask[401, 501] = True
    model = make_inference("geometric", target_model("box_2to1"), scale=0.25)
    hidden = model.infer(covered(view), np.zeros_like(mask), view)
    found = model.infer(covered(view), mask, view)
    assert 0 < found.support_size() != hidden.support_size()


def test_large_images_are_reduced() -> None:
    assert [usual_scale(w) for w in (512, 640, 1280)] == [1.0, 1.0, 0.5]


@pytest.mark.parametrize("size", [(500, 380), (516, 386)])
def test_a_network_takes_images_of_any_size(size: tuple[int, int]) -> None:
    """Those of whole steps are answered as ever, others nearly as those."""
    target = target_model("box_2to1")
    network = make_inference("learned", target)
    whole = camera(544, 416)
    part = PinholeCamera(*size, whole.intrinsics, X_WC)
    depth = covered(whole)
    cut = np.ascontiguousarray(depth[: size[1], : size[0]])
    blank = np.zeros(part.shape, bool)
    answer = network.infer(cut, blank, part)
    assert answer.data.shape == part.shape
    reference = network.infer(depth, np.zeros(whole.shape, bool), whole)
    part_of = np.s_[: size[1], : size[0]]
    away = np.abs(answer.data - reference.data[part_of])
    assert np.median(away) < 0.02
    assert iou(answer.support(), reference.support()[part_of]) > 0.7
