import numpy as np
import pytest

from xray_drake.messages import Grasp, GraspKind
from xray_drake.policy.beyond.chance import chance


def test_better_grasps_have_better_chances_between_what_was_counted() -> None:
    grasps = [
        Grasp(GraspKind.SUCTION, "cup", quality=quality)
        for quality in np.linspace(0.01, 1.0, 100)
    ]
    chances = [chance(grasp) for grasp in grasps]
    assert chances == sorted(chances)
    assert chances[:20] == [0.5] * 20
    assert chances[-30:] == pytest.approx([0.94] * 30)
    assert len(set(chances)) > 40
    assert chance(Grasp()) == 0.0
