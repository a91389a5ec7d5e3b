import numpy as np

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
    labels = graph([[7, 7, 0], [7, 3, 3]]).labels()
    assert labels.tolist() == [[0, 0, -1], [0, 1, 1]]
    assert graph([[4, 4, 9]]).labels().tolist() == [[0, 0, 1]]
    assert graph([[7, 7, 3]]).labels(min_area=2).tolist() == [[0, 0, -1]]


def test_weak_borders_go() -> None:
    regions = [[1, 1, 2, 2, 3]]
    strength = [[0, 2.0, 1.0, 4.0, 0]]  # 2 between 1 and 2, 4 beyond

    def joined(threshold: float) -> list:
        g = graph(regions, strength)
        g.join_weak(threshold)
        return g.labels().tolist()

    assert joined(2.0) == graph(regions).labels().tolist()
    assert joined(2.1) == [[0, 0, 0, 0, 1]]
    assert joined(4.1) == [[0, 0, 0, 0, 0]]


def test_a_gap_in_a_border_does_not_join() -> None:
    regions = [[1, 2]] * 6
    strength = [[5.0, 0.0]] * 5 + [[0.0, 0.0]]
    g = graph(regions, strength)
    g.join_weak(4.0)
    assert len(np.unique(g.labels())) == 2
    g.join_weak(5 * 5 / 6 + 1e-6)
    assert len(np.unique(g.labels())) == 1


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
    assert g.labels().tolist() == [[0, -1, 1]] or g.labels().tolist() == [
        [1, -1, 0]
    ]


def test_small_ones_join_the_neighbour_least_parted_from_them() -> None:
    g = graph([[1, 1, 1, 2, 3, 3, 3, 3]], [[0, 0, 2.0, 0, 3.0, 0, 0, 0]])
    g.join_small(3)
    assert g.labels().tolist() == [[0, 0, 0, 0, 1, 1, 1, 1]] or (
        g.labels().tolist() == [[1, 1, 1, 1, 0, 0, 0, 0]]
    )


BOWL = [[1, 1, 1, 1], [1, 2, 2, 1], [1, 1, 1, 1]]


def test_the_inside_of_a_bowl_joins_its_rim() -> None:
    rim_up = [[1.0 if value == 1 else 0.0 for value in row] for row in BOWL]
    g = graph(BOWL, 9.0, rim_up)
    g.join_hollows(0.8)
    assert not g.labels().any()


def test_what_stands_on_a_plate_does_not() -> None:
    rim_down = [[-1.0 if value == 1 else 0.0 for value in row] for row in BOWL]
    for height in (rim_down, 0.0):
        g = graph(BOWL, 9.0, height)
        g.join_hollows(0.8)
        assert len(np.unique(g.labels())) == 2


def test_a_bowl_that_something_lies_in() -> None:
    regions = [[1, 1, 1, 1], [1, 2, 3, 1], [1, 1, 1, 1]]
    height = [[1.0, 1, 1, 1], [1, 0, 2, 1], [1, 1, 1, 1]]
    for enclosed, segments in ((0.7, 2), (0.8, 3)):
        g = graph(regions, 9.0, height)
        g.join_hollows(enclosed)
        assert len(np.unique(g.labels())) == segments
