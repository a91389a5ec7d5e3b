from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F

from xray_drake.messages import (
    InstanceMasks,
    OccupancyDistribution,
    SearchAction,
    TargetMask,
)
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import (
    SearchDiagram,
    SearchParts,
    build_search_diagram,
)
from xray_drake.station.scenario import Scenario


@pytest.fixture
def build(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> Callable[..., SearchDiagram]:
    """Builds the tiny heap's search with other boxes."""

    def built(replace: dict[str, Any], **options: bool) -> SearchDiagram:
        return build_search_diagram(
            tiny_scenario, heap=tiny_heap, replace=replace, **options
        )

    return built


class Everywhere(LeafSystem):
    """Says that the target may be under anything that stands out."""

    def __init__(self, parts: SearchParts) -> None:
        super().__init__()
        self.DeclareAbstractInputPort(
            "depth_image", Value(ImageDepth32F(512, 384))
        )
        self.DeclareAbstractOutputPort(
            "occupancy",
            alloc=lambda: Value(OccupancyDistribution()),
            calc=self._calc,
        )

    def _calc(self, context: Context, output: Value) -> None:
        depth = self.GetInputPort("depth_image").Eval(context).data[:, :, 0]
        output.set_value(
            OccupancyDistribution((depth < 0.79).astype(np.float32))
        )


class Idle(LeafSystem):
    """Looks at the objects and never decides."""

    def __init__(self, parts: SearchParts) -> None:
        super().__init__()
        self.DeclareAbstractInputPort("instances", Value(InstanceMasks()))
        self.DeclareAbstractOutputPort(
            "action",
            alloc=lambda: Value(SearchAction(number=77)),
            calc=lambda context, output: None,
        )


def test_another_inference_and_another_policy(
    build: Callable[..., SearchDiagram],
) -> None:
    """A whole policy of one's own is in notebook 04."""
    diagram = build({"occupancy_inference": Everywhere, "search_policy": Idle})
    context = diagram.CreateDefaultContext()
    rho = diagram.GetOutputPort("occupancy_inference.occupancy").Eval(context)
    depth = diagram.GetOutputPort("overhead.depth_image").Eval(context).data
    np.testing.assert_array_equal(rho.support(), depth[:, :, 0] < 0.79)
    action = diagram.GetOutputPort("search_policy.action").Eval(context)
    assert action.number == 77
    policy = diagram.GetSubsystemByName("search_policy")
    seen = policy.GetInputPort("instances")
    assert "book" in seen.Eval(policy.GetMyContextFromRoot(context)).names


def test_a_detector_and_what_follows_it(
    build: Callable[..., SearchDiagram],
) -> None:
    class Blind(LeafSystem):
        def __init__(self, parts: SearchParts) -> None:
            super().__init__()
            self.DeclareAbstractOutputPort(
                "target_mask",
                alloc=lambda: Value(TargetMask(np.zeros((384, 512), bool))),
                calc=lambda context, output: None,
            )

    seeing, blind = (
        diagram.GetOutputPort("occupancy_inference.occupancy")
        .Eval(diagram.CreateDefaultContext())
        .support_size()
        for diagram in (build({}), build({"target_detector": Blind}))
    )
    assert blind > 2 * seeing > 0


class Mute(LeafSystem):
    def __init__(self, parts: SearchParts) -> None:
        super().__init__()
        self.DeclareVectorOutputPort("answer", 1, lambda context, out: None)


class Wishful(Everywhere):
    def __init__(self, parts: SearchParts) -> None:
        super().__init__(parts)
        self.DeclareVectorInputPort("wind", 1)


class Blurred(LeafSystem):
    def __init__(self, parts: SearchParts) -> None:
        super().__init__()
        self.DeclareVectorInputPort("depth_image", 4)
        self.DeclareVectorOutputPort("occupancy", 1, lambda context, out: None)


POLICY, INFERENCE = "search_policy", "occupancy_inference"


@pytest.mark.parametrize(
    ("name", "system", "said"),
    [
        ("heap_station", Mute, r"heap_station cannot be replaced.*search_pol"),
        (POLICY, Mute, r"search_policy needs an output 'action'; it has answ"),
        (INFERENCE, Wishful, r"_inference has an input 'wind'.*depth_image"),
        (INFERENCE, Blurred, r"'depth_image' of .*_inference must be abstract"),
        (POLICY, lambda parts: 1, r"search_policy.*returns 1"),
        (POLICY, 1, r"search_policy.*must be a function.*is 1"),
    ],
)
def test_what_does_not_fit(
    build: Callable[..., SearchDiagram], name: str, system: Any, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        build({name: system})


def test_an_agent_needs_the_policy(build: Callable[..., SearchDiagram]) -> None:
    with pytest.raises(ValueError, match="agent"):
        build({"search_policy": Idle}, agent=True)
