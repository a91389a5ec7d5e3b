from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Meshcat

from tests.meshcat_probe import prop
from xray_drake.drawing.colors import heat
from xray_drake.inspector.layers import (
    LAYERS,
    Layer,
    SnapshotLayers,
    mask_colors,
    score_colors,
    seen_points,
)
from xray_drake.inspector.replay import Replay
from xray_drake.inspector.snapshot import Snapshot
from xray_drake.messages import (
    Grasp,
    InstanceMasks,
    OccupancyDistribution,
    RankedCandidate,
    SearchAction,
)

NAMES = [layer.name for layer in LAYERS]
SHOWN = {layer.name for layer in LAYERS if layer.opacity > 0}


def drawn(meshcat: Meshcat, step: int) -> set[str]:
    return {
        name
        for name in NAMES
        if meshcat.HasPath(f"/inspect/{name}/step_{step:02d}")
    }


def seen(meshcat: Meshcat, step: int) -> set[str]:
    """Returns the layers of a step that a browser shows."""
    return {
        name
        for name in drawn(meshcat, step)
        if prop(meshcat, f"/inspect/{name}", "visible")
        and prop(meshcat, f"/inspect/{name}/step_{step:02d}", "visible")
    }


def test_layers_are_drawn_when_they_are_first_seen(
    meshcat: Meshcat, replay: Replay
) -> None:
    layers = SnapshotLayers(meshcat, replay.snapshots)
    assert not drawn(meshcat, 1)
    layers.show(1)
    assert seen(meshcat, 1) == drawn(meshcat, 1) == SHOWN
    assert not drawn(meshcat, 2)

    layers.show(2)
    assert layers.step == 2
    assert seen(meshcat, 2) == SHOWN
    assert not seen(meshcat, 1)

    layers.set_opacity("instances", 0.5)
    assert seen(meshcat, 2) == SHOWN | {"instances"}
    assert drawn(meshcat, 1) == SHOWN
    layers.set_opacity("occupancy", 0.0)
    assert seen(meshcat, 2) == SHOWN - {"occupancy"} | {"instances"}
    layers.show(1)
    assert seen(meshcat, 1) == SHOWN - {"occupancy"} | {"instances"}
    # The end of a search has no decision.
    layers.show(3)
    assert not seen(meshcat, 1) | seen(meshcat, 2) | drawn(meshcat, 3)
    with pytest.raises(ValueError, match=r"no layer 'mask'.*occupancy"):
        layers.set_opacity("mask", 1.0)


def test_going_back_draws_nothing(meshcat: Meshcat, replay: Replay) -> None:
    calls: list[tuple[str, int]] = []

    def counted(layer: Layer) -> Layer:
        def draw(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
            calls.append((layer.name, shot.step))
            layer.draw(meshcat, path, shot)

        return replace(layer, draw=draw)

    counting = [counted(layer) for layer in LAYERS]
    layers = SnapshotLayers(meshcat, replay.snapshots, counting)
    for step in (1, 2, 1, 2):
        layers.show(step)
    layers.set_opacity("occupancy", 0.25)
    assert sorted(calls) == sorted((n, s) for n in SHOWN for s in (1, 2))
    layers.draw_all()
    layers.draw_all()
    assert sorted(calls) == sorted((n, s) for n in NAMES for s in (1, 2))
    assert seen(meshcat, 2) == SHOWN
    assert not seen(meshcat, 1)
    # The next search deletes them.
    SnapshotLayers(meshcat, replay.snapshots[:1])
    assert not drawn(meshcat, 1) | drawn(meshcat, 2)


def test_opacity_follows_to_every_step(
    meshcat: Meshcat, replay: Replay
) -> None:
    layers = SnapshotLayers(meshcat, replay.snapshots)
    for step, opacity in ((1, 0.75), (1, 0.25), (2, 0.5), (1, 1.0)):
        layers.set_opacity("occupancy", opacity)
        layers.show(step)
        path = f"/inspect/occupancy/step_{step:02d}/<object>"
        assert prop(meshcat, path, "modulated_opacity") == opacity
        assert layers.opacity("occupancy") == opacity


def test_masks_keep_their_colours(replay: Replay) -> None:
    colors = [
        dict(zip(shot.instances.names, mask_colors(shot).tolist(), strict=True))
        for shot in replay.snapshots
    ]
    both = set(colors[0]) & set(colors[1])
    assert len(both) > 2
    for name in both:
        assert colors[0][name] == colors[1][name]
    assert len({tuple(c) for c in colors[0].values()}) == len(colors[0])
    red, green, blue = colors[0]["box_2to1"]
    assert red > 3 * max(green, blue)
    # Segments have colours, too.
    shot = replay.snapshots[0]
    names = tuple(f"segment_{k}" for k in range(len(colors[0])))
    segments = InstanceMasks(shot.instances.labels, names)
    painted = mask_colors(replace(shot, instances=segments, target="segment_2"))
    assert len(np.unique(painted, axis=0)) == len(names)
    assert painted[2, 0] > 3 * max(painted[2, 1:])


def test_scores_as_heat(replay: Replay) -> None:
    shot = replay.snapshots[0]
    names = shot.instances.names
    ranking = (
        RankedCandidate(names[0], 4.0, False),
        RankedCandidate(names[1], 1.0, False),
    )
    scored = SearchAction(1, ranking=ranking)
    colors = score_colors(replace(shot, action=scored))
    np.testing.assert_allclose(colors[0], heat(np.array(1.0)))
    np.testing.assert_allclose(colors[1], heat(np.array(0.0)))
    assert np.isnan(colors[2:]).all()


def test_the_points_lie_on_what_is_seen(replay: Replay) -> None:
    shot = replay.snapshots[0]
    points = seen_points(shot)
    reading = np.isfinite(shot.depth[::2, ::2])
    assert 0 < len(points.positions) == reading.sum() < reading.size
    depth = shot.camera.project(points.positions)[:, 2]
    np.testing.assert_allclose(depth, shot.depth[::2, ::2][reading], rtol=1e-6)
    np.testing.assert_array_equal(
        points.colors, shot.color[::2, ::2][reading] / 255
    )
    blind = replace(shot, seen_depth=np.zeros_like(shot.depth))
    assert len(seen_points(blind).positions) == 0


def test_a_blank_decision_draws_no_more_than_it_can(
    meshcat: Meshcat, replay: Replay
) -> None:
    shot = replay.snapshots[0]
    blank: Snapshot = replace(
        shot,
        action=SearchAction(1, Grasp()),
        instances=InstanceMasks(np.full(shot.camera.shape, -1), ()),
        occupancy=OccupancyDistribution(np.zeros(shot.camera.shape)),
        target="",
        target_amodal=np.zeros(shot.camera.shape, bool),
        seen_depth=np.zeros(shot.camera.shape),
        grasps={},
    )
    layers = SnapshotLayers(meshcat, [blank])
    layers.show(1)
    layers.draw_all()
    for name in set(NAMES) - {"camera"}:
        path = f"/inspect/{name}/step_01"
        assert not meshcat._GetPackedObject(path), name
