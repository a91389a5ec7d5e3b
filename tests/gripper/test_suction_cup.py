"""The cup as a system: with fixed inputs, then on a plant."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity

from tests.alone import Alone
from tests.gripper.cells import STEP, DrivenCell, block
from tests.ports import ports
from tests.poses import at, downwards
from xray_drake.gripper.suction_cup import SuctionCup
from xray_drake.scene.object_model import object_from_pieces

GRIPPER, PLATE, OTHER = 1, 2, 3
HERE, AWAY = at(), at(9.0)


def plate(mass=0.1, size=(0.08, 0.06, 0.02)):
    return block(size, mass, "plate")


def lying_cylinder(radius):
    mesh = trimesh.creation.cylinder(
        radius, 0.1, sections=64, transform=at(pitch=np.pi / 2)
    )
    return object_from_pieces("plate", [mesh], density=500.0)


class Cup(Alone):
    """The cup with fixed inputs; its lip is the gripper's own frame."""

    def __init__(self, X_WC, *, model=None, X_WO=HERE, X_other=AWAY, X_BC=HERE):
        self.X_WO, self.X_other, self.X_BC = X_WO, X_other, X_BC
        self.velocity = np.zeros((2, 6))
        other = block((0.02, 0.02, 0.02), 0.004, "other")
        super().__init__(
            SuctionCup(
                objects=[model or plate(), other],
                bodies={"plate": PLATE, "other": OTHER},
                gripper=GRIPPER,
                X_BC=X_BC,
            ),
            suction=np.ones(1),
        )
        self.put(X_WC)

    def put(self, X_WC):
        self.X_WC = X_WC
        X_WB = X_WC @ np.linalg.inv(self.X_BC)
        poses = [np.eye(4), X_WB, self.X_WO, self.X_other]
        still = SpatialVelocity.Zero()
        moving = [SpatialVelocity(w=v[:3], v=v[3:]) for v in self.velocity]
        self.fix(body_poses=[RigidTransform(X) for X in poses])
        self.fix(body_spatial_velocities=[still, *moving, still])

    def advance(self, steps=1):
        return self.advance_to(self.context.get_time() + STEP * steps)

    @property
    def forces(self):
        return self.output("applied_spatial_force")


def over_plate(height, x=0.0, tilt=0.0):
    """The lip so far over the plate's top, at its centre's height."""
    return at(x, 0.0, 0.01 + height, pitch=tilt) @ downwards(0, 0, 0)


def test_ports_are_named():
    system = Cup(over_plate(0.1)).system
    assert ports(system) == (
        ["suction", "body_poses", "body_spatial_velocities"],
        ["state", "applied_spatial_force"],
    )
    assert system.get_name() == "suction_cup"


def test_it_seals_on_command_and_lets_go():
    cup = Cup(over_plate(0.0))
    cup.fix(suction=np.zeros(1))
    assert cup.advance(8).object == ""
    assert cup.forces == []
    cup.fix(suction=np.ones(1))
    state = cup.advance(5)
    assert state.object == "plate"
    assert state.drawing
    np.testing.assert_allclose(state.X_OC, over_plate(0.0), atol=1e-12)
    assert cup.advance(40).vacuum > 0.95
    cup.fix(suction=np.zeros(1))
    state = cup.advance(2)
    assert (state.object, state.vacuum, state.drawing) == ("", 0.0, False)
    assert cup.forces == []


TILTS = [(tilt, 0.015 * np.sin(tilt)) for tilt in (0.0, 0.1, 0.2, 0.35, 0.5)]
"""The far side of a tilted lip is r sin(tilt) away, and so deep is the near."""


@pytest.mark.parametrize(
    ("X_WC", "seals"),
    [
        (over_plate(0.3), False),  # nothing is there
        (over_plate(0.0015), False),  # farther than the vacuum draws the lip
        (over_plate(0.0005), True),
        (over_plate(-0.007), True),  # the bellows gives way
        (over_plate(-0.009), False),
        *((over_plate(0.002, tilt=tilt), False) for tilt, _ in TILTS),
        *(
            (over_plate(-far, tilt=tilt), 2 * far / np.cos(tilt) < 0.008)
            for tilt, far in TILTS
        ),
        # The plate ends at 40 mm, the lip reaches 15 mm.
        (over_plate(-0.001, x=0.020), True),
        (over_plate(-0.001, x=0.024), True),
        (over_plate(-0.001, x=0.0265), False),
    ],
)
def test_it_seals_where_all_of_its_lip_touches(X_WC, seals):
    state = Cup(X_WC).advance(5)
    assert bool(state.object) == seals
    assert seals or state.flow == 1.0


@pytest.mark.parametrize(("radius", "seals"), [(0.03, True), (0.018, False)])
def test_it_does_not_seal_where_the_surface_curves(radius, seals):
    model = lying_cylinder(radius)
    cups = [
        Cup(downwards(0, 0, radius - press), model=model)
        for press in np.linspace(-0.001, 0.009, 11)
    ]
    assert any(cup.advance(5).object for cup in cups) == seals


def test_it_does_not_seal_over_something_else():
    beside = at(0.027, 0.0, 0.011)
    assert Cup(over_plate(0.0), X_other=beside).advance(5).object == "plate"
    under = at(0.020, 0.0, 0.011)
    assert not Cup(over_plate(0.0), X_other=under).advance(5).object


def about_the_origin(applied, X_WB):
    p = X_WB[:3, :3] @ applied.p_BoBq_B + X_WB[:3, 3]
    f = applied.F_Bq_W.translational()
    return np.concatenate([applied.F_Bq_W.rotational() + np.cross(p, f), f])


@settings(max_examples=10)
@given(st.integers(0, 2**31))
def test_what_it_gives_to_the_object_it_takes_from_the_gripper(seed):
    """The sum of the pair is no wrench: neither force nor torque."""
    rng = np.random.default_rng(seed)
    X_BC = at(0.15, 0.0, 0.02, pitch=1.3)
    X_WO = at(0.3, -0.2, 0.4, *rng.normal(size=3))
    cup = Cup(X_WO @ over_plate(0.0), X_WO=X_WO, X_BC=X_BC)
    cup.advance(20)
    cup.velocity = 0.02 * rng.normal(size=(2, 6))
    scale = np.repeat([0.001, 0.02], 3)
    cup.put(cup.X_WC @ at(*(scale * rng.normal(size=6))))
    assert cup.advance().object == "plate"
    on_object, on_gripper = cup.forces
    assert int(on_object.body_index) == PLATE
    assert int(on_gripper.body_index) == GRIPPER
    a = about_the_origin(on_object, cup.X_WO)
    b = about_the_origin(on_gripper, cup.X_WC @ np.linalg.inv(X_BC))
    assert np.linalg.norm(a[3:]) > 0.01
    np.testing.assert_allclose(a + b, 0, atol=1e-9)


class Cell(DrivenCell):
    """The cup on its gripper, sealed on a plate that lies in the bin."""

    def __init__(self, model, **config):
        super().__init__(model, cup=True, **config)
        self.mass = model.mass
        gripper, shut = self.gripper, self.gripper.finger_travel
        self.at(downwards(0.05, 0.02, model.extents[2]), gripper.X_BC)
        self.fix(fingers=np.array([shut, shut, 0, 0]))
        self.fix(suction=np.ones(1))
        self.advance(0.25)
        assert self.state.object == "plate"

    @property
    def state(self):
        context = self.cup.GetMyContextFromRoot(self.context)
        return self.cup.GetOutputPort("state").Eval(context)

    def rise(self):
        """The plate's speed upwards, m/s."""
        body = self.items["plate"].body
        V = body.EvalSpatialVelocityInWorld(self.plant_context)
        return float(V.translational()[2])

    def weigh(self):
        """Advances by a step.

        Returns:
            What the cup says that it pulls up with, N, and what the plate's
            motion says, which nothing else touches.
        """
        before = self.rise()
        self.advance(STEP)
        gained = (self.rise() - before) / STEP
        return self.state.wrench[5], self.mass * (gained + 9.81)


UP = np.array([0, 0, 0.1, 0, 0, 0])


@pytest.mark.parametrize("mass", [0.003, 0.6])
def test_it_lifts_what_the_vacuum_can_hold(mass):
    cell = Cell(plate(mass))
    start = cell.height("plate")
    cell.move(UP, 0.8)
    assert cell.state.object == "plate"
    sag = 9.81 * mass / 1750.0
    assert cell.height("plate") - start == pytest.approx(0.1 - sag, abs=5e-4)
    assert cell.plant.CalcKineticEnergy(cell.plant_context) < 1e-5


@pytest.mark.parametrize("sampled_ports", [True, False])
def test_the_force_that_acts_is_the_one_that_it_says(sampled_ports):
    """Whether the plant steps before the cup's event is done, or after."""
    cell = Cell(plate(0.05), use_sampled_output_ports=sampled_ports)
    cell.move(0.5 * UP, 0.3)
    cell.want(cell.q + 0.03 * UP)
    said, acted = np.transpose([cell.weigh() for _ in range(8)])
    assert np.ptp(said) > 0.3
    np.testing.assert_allclose(acted, said, atol=1e-4)


@pytest.mark.parametrize(("mass", "holds"), [(0.5, True), (0.9, False)])
def test_it_breaks_away_where_friction_cannot_hold(mass, holds):
    """Turned by 90° it goes through √5 m g, which 0.64 kg bring to V."""
    size = (0.04, 0.04, 0.001)  # its centre of mass near the lip
    cell = Cell(plate(mass, size))
    cell.move(UP, 0.6)
    assert cell.state.object == "plate"
    cell.move(np.array([0, 0, 0.1, 0, -np.pi / 2, 0]), 1.0)
    assert (cell.state.object == "plate") == holds
    assert bool(cell.state.lost) != holds
