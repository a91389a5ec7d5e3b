"""Heights of a mesh's columns: from the planes of a convex one, and by rays."""

import numpy as np
import pytest
import trimesh

from xray_drake.geometry.silhouette import facing_triangles, fill_convex
from xray_drake.occupancy.geometric.columns import Columns, measure_columns

_PITCH = 0.0005
_SIDE = 201

turn = trimesh.transformations.rotation_matrix
box, cylinder = trimesh.creation.box, trimesh.creation.cylinder
_CONVEX = {
    "box": box([0.06, 0.03, 0.005]),
    "disc": cylinder(radius=0.03, height=0.008, sections=24),
    "rod": cylinder(0.01, 0.07, sections=24, transform=turn(1.5708, [0, 1, 0])),
    "ball": trimesh.creation.icosphere(subdivisions=2, radius=0.03),
    "leaning": box([0.03, 0.03, 0.03], turn(0.7, [1, 2, 0])),
}


def measure(mesh: trimesh.Trimesh) -> Columns:
    """Measures its columns as it lies, within its silhouette from above."""
    mesh = mesh.copy().apply_translation([0, 0, -mesh.bounds[0, 2]])
    canvas = np.zeros((_SIDE, _SIDE), np.uint8)
    flat = mesh.vertices[:, :2] / _PITCH + _SIDE // 2
    fill_convex(canvas, facing_triangles(flat, mesh.faces[:, ::-1]))
    return measure_columns(mesh, canvas, _PITCH, np.full(2, _SIDE // 2))


@pytest.mark.parametrize("kind", _CONVEX)
def test_planes_and_rays_agree(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fast = measure(_CONVEX[kind])
    assert _CONVEX[kind].is_convex
    monkeypatch.setattr(trimesh.Trimesh, "is_convex", False)
    slow = measure(_CONVEX[kind])
    assert fast.top == pytest.approx(slow.top, abs=1e-7)
    assert len(fast.groups) == len(slow.groups)
    for ours, theirs in zip(fast.groups, slow.groups, strict=True):
        assert ours.low == pytest.approx(theirs.low, abs=1e-7)
        assert ours.high == pytest.approx(theirs.high, abs=1e-7)
        assert ours.top == pytest.approx(theirs.top, abs=1e-7)
    # Where a column is between two levels, rounding decides.
    assert np.mean(fast.labels != slow.labels) < 1e-3


def test_a_box_is_one_group_and_a_rod_has_flanks() -> None:
    (group,) = measure(_CONVEX["box"]).groups
    assert (group.low, group.high, group.top) == pytest.approx(
        (0, 0.005, 0.005)
    )
    # The outline of a rod is halfway up, a strip in its middle at the top.
    heights = [group.high for group in measure(_CONVEX["rod"]).groups]
    assert max(heights) > 0.018 > 0.016 > min(heights)


def test_a_mesh_that_is_not_convex_is_measured_by_rays() -> None:
    """A bridge, of which the opening shows from below."""
    parts = [
        box(bounds=[[-0.03, -0.01, 0.02], [0.03, 0.01, 0.025]]),
        box(bounds=[[-0.03, -0.01, 0], [-0.02, 0.01, 0.02]]),
        box(bounds=[[0.02, -0.01, 0], [0.03, 0.01, 0.02]]),
    ]
    groups = measure(trimesh.boolean.union(parts, engine="manifold")).groups
    assert min(group.low for group in groups) == pytest.approx(0, abs=1e-6)
    assert max(group.low for group in groups) == pytest.approx(0.02, abs=1e-6)
    assert {round(group.top, 6) for group in groups} == {0.025}
