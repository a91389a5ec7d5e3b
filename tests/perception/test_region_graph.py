import numpy as np
import pytest

from xray_drake.perception.region_graph import RegionGraph


def graph(
    regions: list[list[int]],
    strength: list[list[float]] | float = 0.0,
    height: list[list[float]] | float = 0.0,
) -> RegionGraph:
    image = np.array(regions)
    return RegionGraph(
        image,
        np.broadcast_to(np.array(strength, float), image.shape),
        np.broadcast_to(np.array(height, float), image.shape),
    )


def test_as_they_are() -> None:
    """From the largest on; the background and what is small are −1."""
    labels = graph([[7, 7, 0], [7, 3, 3]]).labels()
    assert labels.tolist() == [[0, 0, -1], [0, 1, 1]]
    assert graph([[4, 4, 9]]).labels().tolist() == [[0, 0, 1]]
    assert graph([[7, 7, 3]]).labels(min_area=2).tolist() == [[0, 0, -1]]


GAP = [[5.0, 0.0]] * 5 + [[0.0, 0.0]]


@pytest.mark.parametrize(
    ("regions", "strength", "threshold", "labels"),
    [
        # 2 between 1 and 2, 4 beyond.
        ([[1, 1, 2, 2, 3]], [[0, 2.0, 1, 4, 0]], 2.0, [[1, 1, 0, 0, 2]]),
        ([[1, 1, 2, 2, 3]], [[0, 2.0, 1, 4, 0]], 2.1, [[0, 0, 0, 0, 1]]),
        ([[1, 1, 2, 2, 3]], [[0, 2.0, 1, 4, 0]], 4.1, [[0, 0, 0, 0, 0]]),
        # The mean over a border counts: a gap in it does not join.
        ([[1, 2]] * 6, GAP, 4.0, [[1, 0]] * 6),
        ([[1, 2]] * 6, GAP, 5 * 5 / 6 + 1e-6, [[0, 0]] * 6),
    ],
)
def test_weak_borders_go(
    regions: list[list[int]],
    strength: list[list[float]],
    threshold: float,
    labels: list[list[int]],
) -> None:
    found = graph(regions, strength)
    found.join_weak(threshold)
    assert found.labels().tolist() == labels


def test_borders_are_added_up_as_regions_join() -> None:
    # 1 to 2 is 1, 2 to 3 is 3; but 1 to 3 is 6 in three places.
    regions = [[1, 1, 1, 1], [2, 3, 3, 3]]
    strength = [[0, 6.0, 6, 6], [1, 3, 0, 0]]
    for threshold, segments in ((1.0, 3), (5.2, 2), (5.3, 1)):
        g = graph(regions, strength)
        g.join_weak(threshold)
        assert len(np.unique(g.labels())) == segments


def test_the_background_joins_nothing() -> None:
    g = graph([[1, 0, 2]])
    g.join_weak(1.0)
    g.join_small(5)
    g.join_hollows(0.1)
    assert sorted(g.labels()[0].tolist()) == [-1, 0, 1]


def test_small_ones_join_the_neighbour_least_parted_from_them() -> None:
    g = graph([[1, 1, 1, 2, 3, 3, 3, 3]], [[0, 0, 2.0, 0, 3.0, 0, 0, 0]])
    g.join_small(3)
    labels = g.labels()[0]
    assert (labels[:4] == labels[0]).all()
    assert (labels[4:] == 1 - labels[0]).all()


BOWL = [[1, 1, 1, 1], [1, 2, 2, 1], [1, 1, 1, 1]]
FILLED = [[1, 1, 1, 1], [1, 2, 3, 1], [1, 1, 1, 1]]


@pytest.mark.parametrize(
    ("regions", "inside", "enclosed", "segments"),
    [
        pytest.param(BOWL, [-1.0, -1], 0.8, 1, id="the inside of a bowl"),
        pytest.param(BOWL, [1.0, 1], 0.8, 2, id="what stands on a plate"),
        pytest.param(BOWL, [0.0, 0], 0.8, 2, id="flush"),
        pytest.param(FILLED, [-1.0, 1], 0.7, 2, id="a bowl with something in"),
        pytest.param(FILLED, [-1.0, 1], 0.8, 3, id="too little of a rim"),
    ],
)
def test_hollows_join_the_rim_about_them(
    regions: list[list[int]],
    inside: list[float],
    enclosed: float,
    segments: int,
) -> None:
    height = np.zeros((3, 4))
    height[1, 1:3] = inside
    g = graph(regions, 9.0, height.tolist())
    g.join_hollows(enclosed)
    assert len(np.unique(g.labels())) == segments
