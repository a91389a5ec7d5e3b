from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from tests.ports import ports
from xray_drake.scene.heap import Heap
from xray_drake.station.heap_station import StationParts, build_heap_station
from xray_drake.station.scenario import Scenario
from xray_drake.station.start import look_at_heap, target_view

HOME = np.array([0.0, 1.0, 0, 0, 0.0, 0.32, 0.34, 0, 0])
IN_VIEW = np.array([0.0, 1.0, 0, 0, 0.0, 0.0, 0.3, 0, 0])
IN_THE_HEAP = np.array([0.0, 1.0, 0, 0, 0.05, 0.09, 0.1, 0, 0])
"""Quaternion and position of the gripper's base, two finger joints."""


class Station:
    def __init__(self, heap: Heap) -> None:
        self.diagram: Diagram
        self.parts: StationParts
        self.diagram, self.parts = build_heap_station(Scenario(), heap)

    def context(self, gripper: np.ndarray = HOME) -> Context:
        context = self.diagram.CreateDefaultContext()
        self.diagram.GetInputPort("gripper.position").FixValue(context, gripper)
        return context

    def output(self, name: str, context: Context) -> Any:
        return self.diagram.GetOutputPort(name).Eval(context)

    def images(self, context: Context) -> list[np.ndarray]:
        """Returns depth, label and colour."""
        return [
            np.array(self.output(f"overhead.{name}_image", context).data)
            for name in ("depth", "label", "color")
        ]

    def stays(self, heap: Heap, gripper: np.ndarray, duration: float) -> None:
        """Checks that nothing moves."""
        simulator = Simulator(self.diagram, self.context(gripper))
        simulator.AdvanceTo(duration)
        poses = self.output("cheat.body_poses", simulator.get_context())
        for name, X_WO in heap.poses.items():
            now = poses[self.parts.labels[name]].translation()
            np.testing.assert_allclose(now, X_WO[:3, 3], atol=3e-4)


@pytest.fixture(scope="module")
def station(tiny_heap: Heap) -> Station:
    return Station(tiny_heap)


def test_ports_are_named(station: Station) -> None:
    inputs, outputs = ports(station.diagram)
    assert station.diagram.get_name() == "heap_station"
    assert set(inputs) == {"applied_spatial_force", "gripper.position"}
    assert set(outputs) == {
        *(f"overhead.{kind}_image" for kind in ("color", "depth", "label")),
        *("overhead.camera", "query_object", "contact_results"),
        *("cheat.body_poses", "cheat.body_spatial_velocities"),
    }


def test_the_default_context_has_the_heap_at_rest(
    station: Station, tiny_heap: Heap
) -> None:
    context = station.context()
    poses = station.output("cheat.body_poses", context)
    velocities = station.output("cheat.body_spatial_velocities", context)
    for name, X_WO in tiny_heap.poses.items():
        index = int(station.parts.objects[name].body.index())
        np.testing.assert_allclose(
            poses[index].GetAsMatrix4(), X_WO, atol=1e-12
        )
        assert not velocities[index].get_coeffs().any()
    station.stays(tiny_heap, HOME, 0.3)


def test_images(
    station: Station, tiny_heap: Heap, recorded_observation: Any
) -> None:
    context = station.context()
    depth, label, color = station.images(context)
    assert (depth.shape, depth.dtype) == ((384, 512, 1), np.float32)
    assert (label.shape, label.dtype) == ((384, 512, 1), np.int16)
    assert (color.shape, color.dtype) == ((384, 512, 4), np.uint8)
    np.testing.assert_array_equal(depth[..., 0], recorded_observation.depth)
    np.testing.assert_array_equal(label[..., 0], recorded_observation.labels)
    camera = station.output("overhead.camera", context)
    assert camera.shape == (384, 512)
    book = label[..., 0] == station.parts.labels["book"]
    u, v, z = camera.project(tiny_heap.poses["book"][:3, 3] + [0, 0, 0.01])
    assert book[round(v), round(u)]
    assert depth[round(v), round(u), 0] == pytest.approx(z, abs=1e-3)


@pytest.mark.parametrize("gripper", [IN_VIEW, IN_THE_HEAP])
def test_the_drawn_gripper_is_not_seen(
    station: Station, gripper: np.ndarray
) -> None:
    away, here = (station.images(station.context(g)) for g in (HOME, gripper))
    for one, other in zip(away, here, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_drawn_gripper_is_drawn_and_touches_nothing(
    station: Station, tiny_heap: Heap
) -> None:
    inspector = station.parts.scene_graph.model_inspector()
    gripper = [
        geometry
        for geometry in inspector.GetAllGeometryIds()
        if "gripper" in inspector.GetName(inspector.GetFrameId(geometry))
        or "finger" in inspector.GetName(inspector.GetFrameId(geometry))
    ]
    drawn = [g for g in gripper if inspector.GetIllustrationProperties(g)]
    assert len(drawn) >= 6
    for geometry in gripper:
        assert inspector.GetProximityProperties(geometry) is None
        assert inspector.GetPerceptionProperties(geometry) is None
    assert inspector.NumGeometriesWithRole(Role.kProximity) == 10 + 5 + 6
    station.stays(tiny_heap, IN_THE_HEAP, 0.1)


def test_a_camera_on_a_body(tiny_heap: Heap) -> None:
    scenario = Scenario()
    scenario.camera.X_PB.base_frame = "book"
    with pytest.raises(ValueError, match="'book'"):
        build_heap_station(scenario, tiny_heap)


TARGET = "box_2to1"
LABELS = {TARGET: 1, "fork": 2, "book": 3, "cup": 4, "bin": 9}
AMODAL = np.zeros((60, 80), bool)
AMODAL[10:20, 10:30] = True
"""A target of 20 × 10 pixels."""


@pytest.mark.parametrize(
    ("painted", "visible", "cover_pixels", "covered", "covers"),
    [
        pytest.param({"book": np.s_[40:50, 40:60]}, 1, 0, 0, 0, id="in view"),
        pytest.param({"cup": np.s_[10:20, 10:30]}, 0, 200, 1, 1, id="hidden"),
        pytest.param(
            # Over 5 of its 10 rows, then over 3 of its 20 columns: the whole
            # modal mask of the first counts, but for what the other hides.
            {"book": np.s_[15:50, 5:40], "fork": np.s_[5:60, 12:15]},
            *(5 * 17 / 200, 35 * 35 - 35 * 3, 5 * 17 / 200, 2),
            id="what covers most of it is the cover",
        ),
        pytest.param(
            {"book": np.s_[19:50, 10:11]},
            *(199 / 200, 0, 0, 0),
            id="a touch of the edge is no cover",
        ),
        pytest.param({"bin": np.s_[10:15]}, 0.5, 0, 0, 0, id="nor is the bin"),
    ],
)
def test_what_is_seen_of_the_target_and_of_what_covers_it(
    painted: dict[str, tuple[slice, ...]],
    visible: float,
    cover_pixels: int,
    covered: float,
    covers: int,
) -> None:
    labels = AMODAL.astype(int)
    for name, place in painted.items():
        labels[place] = LABELS[name]
    objects = {name: LABELS[name] for name in LABELS if name != "bin"}
    view = target_view(labels, AMODAL, objects, TARGET)
    expected = (200, visible, cover_pixels, covered, covers)
    assert astuple(view) == pytest.approx(expected)


def test_a_heap_is_looked_at(tiny_scenario: Scenario, tiny_heap: Heap) -> None:
    view = look_at_heap(tiny_scenario, tiny_heap)
    assert view.target_visible_fraction == pytest.approx(0.16, abs=0.03)
    assert view.num_covers == 1
    # 9 cm², 0.5 cm high, seen from 0.8 m.
    assert view.target_pixels == pytest.approx(
        9e-4 * (552.5 / 0.795) ** 2, rel=0.03
    )
    bare = replace(
        tiny_heap,
        objects=tuple(o for o in tiny_heap.objects if o.name != "book"),
    )
    view = look_at_heap(tiny_scenario, bare)
    assert view.target_visible_fraction > 0.97
    tiny_scenario.gripper.execution = "contact"
    assert look_at_heap(tiny_scenario, bare) == view
