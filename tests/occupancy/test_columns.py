"""Heights of a mesh's columns: from the planes of a convex one, and by rays."""

import numpy as np
import pytest
import trimesh

from xray_drake.geometry.silhouette import facing_triangles, fill_convex
from xray_drake.occupancy.geometric import columns

_PITCH = 0.0005
_SIDE = 201


def _lying(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    return mesh


def _disc() -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=0.03, height=0.008, sections=24)


def _rod() -> trimesh.Trimesh:
    mesh = trimesh.creation.cylinder(radius=0.01, height=0.07, sections=24)
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
    return mesh.apply_transform(turn)


_CONVEX = {
    "box": lambda: trimesh.creation.box([0.06, 0.03, 0.005]),
    "disc": _disc,
    "rod": _rod,
    "ball": lambda: trimesh.creation.icosphere(subdivisions=2, radius=0.03),
    "leaning": lambda: trimesh.creation.box([0.03, 0.03, 0.03]).apply_transform(
        trimesh.transformations.rotation_matrix(0.7, [1, 2, 0])
    ),
}


def _canvas(mesh: trimesh.Trimesh) -> np.ndarray:
    """Draws its silhouette from above."""
    canvas = np.zeros((_SIDE, _SIDE), np.uint8)
    flat = mesh.vertices[:, :2] / _PITCH + _SIDE // 2
    fill_convex(canvas, facing_triangles(flat, mesh.faces[:, ::-1]))
    return canvas


@pytest.mark.parametrize("kind", _CONVEX)
def test_planes_and_rays_agree(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = _lying(_CONVEX[kind]())
    assert mesh.is_convex
    canvas, origin = _canvas(mesh), np.full(2, _SIDE // 2)
    fast = columns.measure_columns(mesh, canvas, _PITCH, origin)

    cast = []

    def heights(up: bool, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cast.append(up)
        start = -1.0 if up else 1.0
        found = np.zeros(len(xy), bool)
        met = np.zeros(len(xy))
        hits, rays, _ = mesh.ray.intersects_location(
            np.column_stack([xy, np.full(len(xy), start)]),
            np.tile([0, 0, -np.sign(start)], (len(xy), 1)),
            multiple_hits=False,
        )
        met[rays], found[rays] = hits[:, 2], True
        return met, found

    def by_rays(
        mesh: trimesh.Trimesh, xy: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (low, above), (high, below) = heights(True, xy), heights(False, xy)
        return low, high, above & below

    monkeypatch.setattr(columns, "_convex_heights", by_rays)
    slow = columns.measure_columns(mesh, canvas, _PITCH, origin)
    assert len(cast) == 2
    assert fast.top == pytest.approx(slow.top, abs=1e-7)
    assert len(fast.groups) == len(slow.groups)
    for ours, theirs in zip(fast.groups, slow.groups, strict=True):
        assert ours.low == pytest.approx(theirs.low, abs=1e-7)
        assert ours.high == pytest.approx(theirs.high, abs=1e-7)
        assert ours.top == pytest.approx(theirs.top, abs=1e-7)
    # Where a column is between two levels, rounding decides.
    assert np.mean(fast.labels != slow.labels) < 1e-3


def test_a_box_is_one_group_and_a_rod_has_flanks() -> None:
    found = {}
    for kind in ("box", "rod"):
        mesh = _lying(_CONVEX[kind]())
        found[kind] = columns.measure_columns(
            mesh, _canvas(mesh), _PITCH, np.full(2, _SIDE // 2)
        ).groups
    (box,) = found["box"]
    assert (box.low, box.high, box.top) == pytest.approx((0, 0.005, 0.005))
    # The outline of a rod is halfway up, a strip in its middle at the top.
    assert len(found["rod"]) > 1
    heights = [group.high for group in found["rod"]]
    assert max(heights) > 0.018 > 0.016 > min(heights)


def test_a_mesh_that_is_not_convex_is_measured_by_rays() -> None:
    """A bridge, of which the opening shows from below."""
    sides = [
        trimesh.creation.box(
            [0.01, 0.02, 0.02],
            trimesh.transformations.translation_matrix([x, 0, 0.01]),
        )
        for x in (-0.025, 0.025)
    ]
    deck = trimesh.creation.box(
        [0.06, 0.02, 0.005],
        trimesh.transformations.translation_matrix([0, 0, 0.0225]),
    )
    mesh = trimesh.boolean.union([*sides, deck], engine="manifold")
    assert not mesh.is_convex
    groups = columns.measure_columns(
        mesh, _canvas(mesh), _PITCH, np.full(2, _SIDE // 2)
    ).groups
    assert min(group.low for group in groups) == pytest.approx(0, abs=1e-6)
    assert max(group.low for group in groups) == pytest.approx(0.02, abs=1e-6)
    assert {round(group.top, 6) for group in groups} == {0.025}
