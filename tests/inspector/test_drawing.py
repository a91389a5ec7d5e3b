from dataclasses import replace

import numpy as np
import pytest
import umsgpack
from pydrake.geometry import Meshcat

from xray_drake.drawing.meshcat_layers import set_opacity, start_meshcat
from xray_drake.inspector.drawing import SearchDrawing
from xray_drake.messages import Grasp, GraspKind, SearchAction
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.record import ActionRecord
from xray_drake.station.scenario import Scenario

LAYERS = ("occupancy", "outline", "grasp")


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return start_meshcat()


def layers(meshcat: Meshcat, step: int) -> set[str]:
    return {
        layer
        for layer in LAYERS
        if meshcat.HasPath(f"/search/step_{step:02d}/{layer}")
    }


def visible(meshcat: Meshcat, step: int) -> bool:
    packed = meshcat._GetPackedProperty(f"/search/step_{step:02d}", "visible")
    return umsgpack.unpackb(packed)["value"]


def action_on(name: str, number: int) -> SearchAction:
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    return SearchAction(number, Grasp(GraspKind.JAW, name, X_WG, width=0.02))


def test_each_decision_has_layers_of_its_own(
    meshcat: Meshcat, tiny_diagram: SearchDiagram
) -> None:
    context = tiny_diagram.CreateDefaultContext()
    drawing = SearchDrawing(meshcat)
    drawing.decided(tiny_diagram, context, action_on("book", 1))
    assert layers(meshcat, 1) == set(LAYERS)
    assert visible(meshcat, 1)

    drawing.decided(tiny_diagram, context, action_on("plank", 2))
    assert layers(meshcat, 1) == layers(meshcat, 2) == set(LAYERS)
    assert not visible(meshcat, 1)
    assert visible(meshcat, 2)

    record = ActionRecord(2, "plank", False, Grasp())
    drawing.ended(tiny_diagram, context, record)
    assert not visible(meshcat, 2)
    # The next search begins without them.
    SearchDrawing(meshcat)
    assert not meshcat.HasPath("/search")


def test_without_a_grasp_there_is_still_the_distribution(
    meshcat: Meshcat, tiny_diagram: SearchDiagram
) -> None:
    context = tiny_diagram.CreateDefaultContext()
    SearchDrawing(meshcat).decided(tiny_diagram, context, SearchAction(1))
    assert layers(meshcat, 1) == {"occupancy"}


def test_the_outline_is_that_of_the_object_chosen(
    meshcat: Meshcat, tiny_diagram: SearchDiagram
) -> None:
    context = tiny_diagram.CreateDefaultContext()
    action = action_on("book", 1)
    drawing = SearchDrawing(meshcat)
    drawing.decided(tiny_diagram, context, action)
    drawing.decided(tiny_diagram, context, replace(action, number=2))
    drawing.decided(tiny_diagram, context, action_on("plank", 3))

    def geometry(step: int) -> object:
        path = f"/search/step_{step:02d}/outline"
        packed = umsgpack.unpackb(meshcat._GetPackedObject(path))
        return packed["object"]["geometries"][0]["data"]

    assert geometry(1) == geometry(2)
    assert geometry(1) != geometry(3)


def test_an_object_becomes_translucent(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    meshcat = start_meshcat()
    diagram = build_search_diagram(
        tiny_scenario, heap=tiny_heap, meshcat=meshcat
    )
    with pytest.raises(ValueError, match=r"'book'.*ForcedPublish"):
        set_opacity(meshcat, "book", 0.25)
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    set_opacity(meshcat, "book", 0.25)
    packed = meshcat._GetPackedProperty(
        "visualizer/book/book/book/visual", "modulated_opacity"
    )
    assert umsgpack.unpackb(packed)["value"] == 0.25
