import numpy as np
import pytest
from pydrake.math import RigidTransform

from tests.alone import Alone
from xray_drake.gripper.rest_sensor import RestSensor
from xray_drake.scene.targets import target_model

NAME = "box_2to1"


class Watched(Alone):
    """A sensor of one object whose pose is set from outside."""

    def __init__(self):
        objects = [target_model(NAME)]
        super().__init__(
            RestSensor(objects=objects, bodies={NAME: 1}, round_time=0.3)
        )
        self.put(0.0, 0.0, 0.01)

    def put(self, *p_WO):
        self.fix(body_poses=[RigidTransform(), RigidTransform(p_WO)])

    def after(self, duration):
        return bool(self.advance_to(self.context.get_time() + duration)[0])


@pytest.mark.parametrize(("step", "rests"), [(0.002, False), (0.0005, True)])
def test_it_takes_a_whole_round_to_be_sure(step, rests):
    watched = Watched()
    assert not watched.system.HasAnyDirectFeedthrough()
    assert not watched.after(0.25)
    assert watched.after(0.1)
    watched.put(step, 0.0, 0.01)
    assert watched.after(0.3) is rests
    assert watched.after(0.3)


def test_what_fell_out_of_the_cell_does_not_count():
    watched = Watched()
    for z in np.linspace(-0.1, -3.0, 10):
        watched.put(0.5, 0.5, z)
        still = watched.after(0.2)
    assert still
