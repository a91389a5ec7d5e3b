import numpy as np
import pytest

from xray_drake.messages import Grasp, GraspKind
from xray_drake.policy.beyond.chance import chance


def grasp(quality: float) -> Grasp:
    return Grasp(GraspKind.SUCTION, "cup", quality=quality)


def test_no_grasp_has_no_chance() -> None:
    assert chance(Grasp()) == 0.0


@pytest.mark.parametrize(
    ("quality", "share"), [(0.05, 0.5), (0.2, 0.5), (0.7, 0.94), (1.0, 0.94)]
)
def test_what_was_counted(quality: float, share: float) -> None:
    assert chance(grasp(quality)) == pytest.approx(share)


def test_better_grasps_have_better_chances() -> None:
    chances = [chance(grasp(q)) for q in np.linspace(0.01, 1.0, 50)]
    assert chances == sorted(chances)
    assert len(set(chances)) > 20
